// Gathers of typed values, built on Comm's gathers of bytes.
#pragma once

#include <cstddef>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/comm/comm.hpp"

namespace rcb::comm {

template <typename T>
struct Gathered {
  Buffer<T> values;                 // in rank order
  std::vector<std::size_t> counts;  // values of each rank
};

template <typename T>
Gathered<T> as_values(std::span<const std::byte> bytes, std::vector<std::size_t> sizes) {
  static_assert(std::is_trivially_copyable_v<T>);
  Gathered<T> gathered{Buffer<T>(bytes.size() / sizeof(T)), std::move(sizes)};
  if (!bytes.empty()) std::memcpy(gathered.values.data(), bytes.data(), bytes.size());
  for (std::size_t& count : gathered.counts) count /= sizeof(T);
  return gathered;
}

// Every rank's values, on every rank. Collective.
template <typename T>
Gathered<T> all_gather_values(Comm& comm, std::span<const T> mine) {
  std::vector<std::byte> bytes;
  std::vector<std::size_t> sizes;
  comm.all_gather(std::as_bytes(mine), bytes, sizes);
  return as_values<T>(bytes, std::move(sizes));
}

// The same where all values together are few. Collective.
template <typename T>
Buffer<T> all_gather_few_values(Comm& comm, std::span<const T> mine) {
  std::vector<std::byte> bytes;
  comm.all_gather_few(std::as_bytes(mine), bytes);
  return as_values<T>(bytes, {}).values;
}

// Every rank's values on rank 0; nothing elsewhere. Collective.
template <typename T>
Buffer<T> gather_values(Comm& comm, std::span<const T> mine) {
  std::vector<std::byte> bytes;
  std::vector<std::size_t> sizes;
  comm.gather(std::as_bytes(mine), 0, bytes, sizes);
  return as_values<T>(bytes, std::move(sizes)).values;
}

}  // namespace rcb::comm
