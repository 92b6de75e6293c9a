// Particles in the order of their parts, by a counting sort.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace rcb::particles {

struct ByPart {
  std::vector<std::size_t> start;     // index in `particle` where each part begins, and the end
  std::vector<std::size_t> particle;  // part after part, ascending in each

  std::span<const std::size_t> of(std::size_t index) const {
    return std::span(particle).subspan(start[index], start[index + 1] - start[index]);
  }
};

// part: [particles], all of them in [first, last). Index 0 of the result is part `first`.
inline ByPart by_part(std::span<const std::int32_t> part, int first, int last) {
  ByPart by;
  by.start.assign(static_cast<std::size_t>(last - first) + 1, 0);
  for (const std::int32_t p : part) ++by.start[static_cast<std::size_t>(p - first) + 1];
  for (std::size_t k = 1; k < by.start.size(); ++k) by.start[k] += by.start[k - 1];
  by.particle.resize(part.size());
  std::vector<std::size_t> next(by.start.begin(), by.start.end() - 1);
  for (std::size_t i = 0; i < part.size(); ++i) by.particle[next[static_cast<std::size_t>(part[i] - first)]++] = i;
  return by;
}

}  // namespace rcb::particles
