// What the tests of members' pushes share: ids and arrays of some particles.
#pragma once

#include <cstring>
#include <span>
#include <vector>

#include "tests/server/service/driver.hpp"

namespace rcb::testing {

inline std::int64_t id_of(const Particles& particles, std::size_t row) {
  return particles.ids.empty() ? static_cast<std::int64_t>(row) : particles.ids[row];
}

template <typename T>
wire::Array array_of(const char* name, const char* dtype, const std::vector<T>& values) {
  wire::Array array{name, dtype, {values.size()}, {}};
  array.bytes.assign(std::as_bytes(std::span(values)));
  return array;
}

template <typename T>
std::vector<T> values(const wire::Array& array) {
  std::vector<T> out(array.bytes.size() / sizeof(T));
  if (!out.empty()) std::memcpy(out.data(), array.bytes.data(), array.bytes.size());
  return out;
}

// x, y (z), and w where there are weights, of these rows.
inline PushSlice slice_of_rows(const Particles& particles, int rank, int member, const std::vector<std::size_t>& rows) {
  PushSlice slice{.rank = rank, .count = rows.size(), .member = member};
  constexpr const char* kNames[] = {"x", "y", "z"};
  const auto column = [&](const std::vector<double>& of) {
    std::vector<double> own;
    for (const std::size_t row : rows) own.push_back(of[row]);
    return own;
  };
  for (std::size_t a = 0; a < particles.position.size(); ++a)
    slice.arrays.push_back(array_of(kNames[a], "<f8", column(particles.position[a])));
  if (!particles.weights.empty()) slice.arrays.push_back(array_of("w", "<f8", column(particles.weights)));
  return slice;
}

}  // namespace rcb::testing
