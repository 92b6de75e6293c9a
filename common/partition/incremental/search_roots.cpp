#include "common/partition/incremental/search_roots.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "common/base/index.hpp"
#include "common/partition/incremental/boundary_list.hpp"

namespace rcb::partition {
namespace {

using particles::kBlock;

// The roots' particles, copied as boundary particles are; nullopt if they are too many.
std::optional<OwnInterior> copy_of_roots(const particles::ParticleView& particles, const Start& start, int parts) {
  const std::size_t most = particles.count / 4;
  const std::vector<std::int32_t> root_of = roots_of_parts(start.roots, parts);
  OwnInterior all;
  BoundaryList list(particles, start.part.data(), 0, all);
  for (std::size_t begin = 0; begin < particles.count && list.size() <= most; begin += kBlock) {
    std::uint64_t which = 0;
    for (std::size_t i = 0; i < std::min(kBlock, particles.count - begin); ++i)
      which |= std::uint64_t{root_of[at(start.part[begin + i])] != Roots::kNone} << i;
    if (which != 0) list.append(begin, which);
  }
  list.finish(most);
  return all.too_many ? std::nullopt : std::optional(std::move(all));
}

}  // namespace

PartitionResult search_roots(comm::Comm& comm, const particles::ParticleView& particles,
                             const PartitionOptions& options, Start start) {
  auto own = copy_of_roots(particles, start, options.parts);
  if (!own) return TreeBuilder(comm, particles, options, std::move(start)).build().value();
  const std::span<std::int32_t> part = std::exchange(start.part, own->part.span());
  PartitionResult found = TreeBuilder(comm, own->view(particles), options, std::move(start)).build().value();
  for (std::size_t k = 0; k < own->part.size(); ++k) part[own->slot[k]] = own->part[k];
  return found;
}

}  // namespace rcb::partition
