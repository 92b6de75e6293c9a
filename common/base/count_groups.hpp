// Counts items by group.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace rcb {

// How many of the first `count` items each of `groups` groups has. In several tables in turn: neighbours often are of
// one group, and a sum would wait for the one before.
//   group(i)  that of item i
template <typename Group>
std::vector<std::uint64_t> count_groups(const Group& group, std::size_t groups, std::size_t count) {
  constexpr std::size_t kTables = 4;
  const std::size_t tables = groups * kTables < count ? kTables : 1;
  std::array<std::vector<std::uint64_t>, kTables> sums;
  for (std::size_t t = 0; t < tables; ++t) sums[t].assign(groups, 0);
  std::size_t i = 0;
  for (; tables == kTables && i + kTables <= count; i += kTables)
    for (std::size_t t = 0; t < kTables; ++t) ++sums[t][static_cast<std::size_t>(group(i + t))];
  for (; i < count; ++i) ++sums[0][static_cast<std::size_t>(group(i))];
  for (std::size_t t = 1; t < tables; ++t)
    for (std::size_t g = 0; g < groups; ++g) sums[0][g] += sums[t][g];
  return std::move(sums[0]);
}

}  // namespace rcb
