// Messages: a frame's JSON and its arrays.
//
// Invariants
// 1. Everything a peer sends is checked here before it is used; nothing throws.
// 2. A parsed message is an object without duplicate keys, at most kJsonDepthMax deep, all of it valid UTF-8.
// 3. JSON that may hold any text, such as file names, is written by dump_json: nlohmann's own dump() throws on what
//    isn't UTF-8.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/wire/limits.hpp"

namespace rcb::wire {

using Json = nlohmann::json;

template <typename T>
Json or_null(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

// A raw array and its description; the bytes are little-endian, in C order.
struct Array {
  std::string name;
  std::string dtype;  // "<f8", "<f4", "<i8", "<i4", "<u8"
  std::vector<std::uint64_t> shape;
  Buffer<std::byte> bytes;
};

struct ArraySpec {
  std::string name;
  std::string dtype;
  std::vector<std::uint64_t> shape;
  std::uint64_t bytes = 0;
};

// That of elements of this type.
template <typename T>
constexpr const char* dtype_of() {
  if (std::is_floating_point_v<T>) return sizeof(T) == 8 ? "<f8" : "<f4";
  return sizeof(T) == 4 ? "<i4" : std::is_signed_v<T> ? "<i8" : "<u8";
}
// Bytes of one element; 0 for an unknown dtype.
std::size_t dtype_bytes(std::string_view dtype);

// Parses a frame's JSON: an object without duplicate keys; depth, size and number of values are limited. Errors:
// protocol_error.
Result<Json> parse_json(std::string_view text, std::size_t bytes_max = kJsonBytesMax,
                        std::size_t values_max = kJsonValuesMax);
// The same of MessagePack (msgpack.org), which may hold binary values, and strings that aren't UTF-8.
Result<Json> parse_msgpack(std::string_view bytes);
// Compact JSON; bytes that aren't UTF-8 become U+FFFD.
std::string dump_json(const Json& json);
// A frame's "arrays" entry, checked against the length of its bulk (the sizes may not overflow). Errors:
// protocol_error.
Result<std::vector<ArraySpec>> array_specs(const Json& json, std::uint64_t bulk_bytes);
// The "arrays" entry that describes `arrays`.
Json describe(std::span<const Array> arrays);

// The array of that name; nullptr if there is none.
const Array* find_array(std::span<const Array> arrays, std::string_view name);

// {"failure":{"code","message","hint","exit"}}. Control characters in message and hint, which may quote a peer, are
// escaped.
Json failure_json(const Status& status);
Status status_from_failure(const Json& json);

// Each reads one field and checks type and range, with errors such as "field 'parts': expected an integer of 1 to
// 1048576, got \"x\"". Errors: invalid_argument.
Result<std::int64_t> integer_field(const Json& json, const char* name, std::int64_t low, std::int64_t high);
Result<std::int64_t> integer_field_or(const Json& json, const char* name, std::int64_t low, std::int64_t high,
                                      std::int64_t otherwise);  // `otherwise` if absent or null
Result<double> number_field_or(const Json& json, const char* name, double low, double high, double otherwise,
                               bool infinity_allowed = false);  // accepts "inf" if infinity_allowed
// A string with a null character, which would truncate a path, is refused.
Result<std::string> string_field(const Json& json, const char* name, std::size_t length_max = 4096);
Result<bool> bool_field(const Json& json, const char* name);  // false if absent or null
bool is_true(const Json& json, const char* name);             // false, too, if it isn't a boolean
// A list of finite numbers; empty if the field is absent or null.
Result<std::vector<double>> numbers_field_or_empty(const Json& json, const char* name, std::size_t count_max);
Result<std::vector<std::string>> strings_field_or_empty(const Json& json, const char* name, std::size_t count_max);
// 1 to 64 characters of [A-Za-z0-9._-]. Errors: invalid_argument.
Status check_scene_name(const std::string& name);

// A 64-bit number as 16 hex digits, and back.
std::string hex64(std::uint64_t value);
Result<std::uint64_t> parse_hex64(std::string_view text);

// The number, or "inf" / "-inf", or null for NaN, which JSON numbers can't express.
Json number_json(double value);

}  // namespace rcb::wire
