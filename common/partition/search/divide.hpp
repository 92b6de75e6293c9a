// A list of particles, divided in two.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace rcb::partition {

// Those for which left(particle) holds come first; either side keeps its order. Returns how many they are. Without
// branches, which would often be mispredicted.
//   others  room for one side, made longer where it is too short
template <typename Left>
std::size_t divide(std::span<std::uint32_t> own, std::vector<std::uint32_t>& others, const Left& left) {
  if (others.size() < own.size()) others.resize(own.size());
  std::size_t lefts = 0;
  for (std::size_t i = 0; i < own.size(); ++i) {
    const std::uint32_t k = own[i];
    own[lefts] = k;
    others[i - lefts] = k;
    lefts += left(k) ? 1U : 0U;
  }
  std::copy_n(others.begin(), own.size() - lefts, own.begin() + static_cast<std::ptrdiff_t>(lefts));
  return lefts;
}

}  // namespace rcb::partition
