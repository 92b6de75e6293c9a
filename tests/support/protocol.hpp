// Frames, written from common/wire/PROTOCOL.md (its sections "Frames" and "Error codes") and sharing no code with
// client and service: by this fake services judge what a client sends, and answer it. Slow and plain. What breaks the
// rules is thrown.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/status.hpp"

namespace rcb::testing::protocol {

using Json = nlohmann::json;

enum class FrameType : std::uint16_t { welcome = 1, hello, request, reply, failure, notice, goodbye };

struct Array {
  std::string name;
  std::string dtype;
  std::vector<std::uint64_t> shape;
  std::string bytes;
};

template <typename T>
Array array_of(const char* name, const char* dtype, const std::vector<T>& values) {
  const auto bytes = std::as_bytes(std::span(values));
  return {name, dtype, {values.size()}, std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size())};
}

struct Frame {
  FrameType type;
  std::uint64_t request = 0;
  Json json;
  std::vector<Array> arrays;
  std::string record;  // the bulk of a count

  // The array of that name, which must be described as one of doubles or signed integers, as T is.
  template <typename T>
  std::vector<T> values(const std::string& name) const {
    static_assert(sizeof(T) == 8 && std::is_signed_v<T>);
    const char* dtype = std::is_floating_point_v<T> ? "<f8" : "<i8";
    for (const Array& array : arrays)
      if (array.name == name && array.dtype == dtype) {
        std::vector<T> out(array.bytes.size() / sizeof(T));
        array.bytes.copy(reinterpret_cast<char*>(out.data()), array.bytes.size());
        return out;
      }
    throw std::runtime_error("no array " + name + " of " + dtype + " in " + json.dump());
  }
};

// Header and JSON of a frame, before its bulk.
std::string head(FrameType type, std::uint64_t request, const std::string& json, std::uint64_t bulk_bytes = 0,
                 bool summed = false);
// A whole frame. summed: with the bulk's checksum behind it.
std::string frame(FrameType type, std::uint64_t request, Json json, const std::vector<Array>& arrays = {},
                  bool summed = false);
// The next frame of a client. read: gives as many bytes, or false at the end. None then.
std::optional<Frame> receive(const std::function<bool(char* to, std::size_t size)>& read);

Json failure_json(const Status& status);
std::string hex64(std::uint64_t value);
bool is_hex64(const Json& json);

}  // namespace rcb::testing::protocol
