// The structs of the interface, which begin with their size: the caller's may be of an older or a newer version.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>

#include <fmt/format.h>

#include "common/base/status.hpp"

namespace rcb::c {

inline constexpr std::size_t kStructBytesMax = 4096;  // more is no size: the struct was not begun by its macro

inline Status check_size(std::size_t size, const char* begin) {
  if (size >= 2 * sizeof(size_t) && size <= kStructBytesMax) return {};
  return {Code::invalid_argument, fmt::format("a struct that says its size is {}", size),
          fmt::format("begin it with {}", begin)};
}

// The caller's fields over the defaults, which `begin`, the name of the struct's macro, has set. Null: all defaults.
template <typename T>
Result<T> read_struct(const T* given, T fields, const char* begin) {
  if (given == nullptr) return fields;
  const std::size_t size = given->size;
  if (Status fits = check_size(size, begin); !fits) return fits;
  std::memcpy(static_cast<void*>(&fields), given, std::min(size, sizeof fields));
  const auto* const bytes = reinterpret_cast<const char*>(given);
  if (size > sizeof fields && std::any_of(bytes + sizeof fields, bytes + size, [](char byte) { return byte != 0; }))
    return Status(Code::unsupported, "an option that this version of librcbd does not know",
                  "use librcbd of the version of your rcbd.h, or a later one");
  return fields;
}

// Fills in the fields that the caller's version of the struct has.
template <typename T>
Status write_struct(const T& fields, T* to, const char* begin) {
  if (to == nullptr) return {Code::invalid_argument, "no struct to fill in: a null pointer"};
  const std::size_t size = to->size;
  if (Status fits = check_size(size, begin); !fits) return fits;
  std::memcpy(static_cast<void*>(to), &fields, std::min(size, sizeof fields));
  to->size = size;
  return {};
}

}  // namespace rcb::c
