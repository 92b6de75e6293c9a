#include "common/partition/incremental/classify_guessed.hpp"

#include <algorithm>
#include <bit>

#include "common/base/index.hpp"
#include "common/partition/incremental/find_leaves.hpp"

namespace rcb::partition {

using particles::kBlock;

OwnInterior classify_guessed(const particles::ParticleView& particles, const Guess& guess,
                             std::span<const NodeRange> roots, std::span<std::int32_t> part, std::size_t boundary_max) {
  OwnInterior out;
  BoundaryList boundary(particles, part.data(), particles.count / 8, out);
  GuessTables tables(guess, roots, particles.dims);
  LeafCounts sums{};
  std::size_t begin = 0;
  for (; begin < particles.count && boundary.size() <= boundary_max; begin += kBlock) {
    const std::size_t count = std::min(kBlock, particles.count - begin);
    const Axes x = particles.all_axes(begin);
    FoundLeaves found = find_leaves(tables, x, &part[begin], count);
    std::uint64_t beyond =
        found.unsure == 0 ? 0 : find_leaves_by_key(tables, x, particles.id + begin, &part[begin], found);
    for (; beyond != 0; beyond &= beyond - 1) {
      const auto k = at(std::countr_zero(beyond));
      tables.extend(found.leaf(k), {x[0][k], x[1][k], x[2][k]});
    }
    add_leaves(found, count, sums);
    if (found.boundary != 0) boundary.append(begin, found.boundary);
  }
  // If it stopped early, the result will not be used, but the rest of `part` must be valid parts all the same. With
  // several roots they are.
  if (!tables.below_root) std::ranges::fill(part.subspan(std::min(begin, part.size())), 0);
  boundary.finish(boundary_max);
  out.boxes.resize(at(guess.parts));
  out.counts.resize(at(guess.parts));
  const LeafCounts counts = counts_of(sums);
  for (std::size_t leaf = 0; leaf < tables.leaves; ++leaf) {
    out.boxes[at(tables.part[leaf])] = tables.box(leaf);
    out.counts[at(tables.part[leaf])] = counts[leaf];
  }
  return out;
}

}  // namespace rcb::partition
