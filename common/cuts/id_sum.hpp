// sum_ids(): what tells ids from others without keeping them.
#pragma once

#include <cstdint>
#include <span>

#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

// All sums are mod 2^64, of mix64(id + key).
struct IdSums {
  std::uint64_t any_order = 0;
  std::uint64_t in_order = 0;  // each times its place, from 1
  bool negative = false;       // there is an id below 0

  bool operator==(const IdSums&) const = default;
};

IdSums sum_ids(std::span<const particles::Id> ids, std::uint64_t key);

}  // namespace rcb::cuts
