// Gathers of typed values, built on Comm's gathers of bytes.
#pragma once

#include <cstddef>
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

// Every rank's values, on every rank. Collective.
template <typename T>
Gathered<T> all_gather_values(Comm& comm, std::span<const T> mine) {
  static_assert(std::is_trivially_copyable_v<T>);
  Buffer<std::byte> bytes;
  Gathered<T> gathered;
  comm.all_gather(std::as_bytes(mine), bytes, gathered.counts);
  for (std::size_t& count : gathered.counts) count /= sizeof(T);
  gathered.values = bytes.release_as<T>();
  return gathered;
}

// The same where all values together are few. Collective.
template <typename T>
Buffer<T> all_gather_few_values(Comm& comm, std::span<const T> mine) {
  Buffer<std::byte> bytes;
  comm.all_gather_few(std::as_bytes(mine), bytes);
  return bytes.release_as<T>();
}

// Rank 0's values, which are few, on every rank. Collective.
template <typename T>
Buffer<T> values_of_first(Comm& comm, std::span<const T> mine) {
  return all_gather_few_values(comm, comm.rank() == 0 ? mine : std::span<const T>());
}

// Every rank's values on rank 0; nothing elsewhere. Collective.
template <typename T>
Buffer<T> gather_values(Comm& comm, std::span<const T> mine) {
  Buffer<std::byte> bytes;
  std::vector<std::size_t> sizes;
  comm.gather(std::as_bytes(mine), 0, bytes, sizes);
  return bytes.release_as<T>();
}

}  // namespace rcb::comm
