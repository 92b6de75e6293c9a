#include "server/service/member_slices.hpp"

#include <fmt/format.h>

#include "common/plan/plan.hpp"

namespace rcb::service {
namespace {

// Particles of each member's parts on this rank.
std::vector<std::uint64_t> counts_by_member(const Scene& scene, std::int64_t part_begin, std::int64_t part_end,
                                            int members) {
  std::vector<std::uint64_t> counts(static_cast<std::size_t>(members), 0);
  for (std::int64_t p = part_begin; p < part_end; ++p) {
    const int member = plan::rank_of_part(static_cast<int>(p), scene.options.parts, members);
    counts[static_cast<std::size_t>(member)] += scene.loads.counts[static_cast<std::size_t>(p)];
  }
  return counts;
}

}  // namespace

Status join_member_slices(const partition::Comm& comm, const Scene& scene, const std::vector<bool>& unmoved,
                          std::span<const std::string> names, std::vector<PushSlice>& slices) {
  const int rank = comm.rank();
  const int members = static_cast<int>(unmoved.size());
  const std::int64_t first_part = plan::part_begin(rank, scene.options.parts, comm.size());
  const std::int64_t end_part = plan::part_begin(rank + 1, scene.options.parts, comm.size());
  std::vector<std::uint64_t> missing = counts_by_member(scene, first_part, end_part, members);
  std::vector<std::size_t> slice_of(static_cast<std::size_t>(members), slices.size());  // the last: the scene's own
  bool fits = true;
  for (std::size_t s = 0; s < slices.size() && fits; ++s) {
    const auto member = static_cast<std::size_t>(slices[s].rank);
    fits = member < missing.size() && slices[s].arrays.size() == names.size() && missing[member] == slices[s].count;
    for (const wire::Array& array : slices[s].arrays) fits = fits && array.bytes.size() == slices[s].count * 8;
    if (fits) missing[member] = 0;
    if (fits) slice_of[member] = s;
  }
  for (std::size_t k = 0; k < missing.size(); ++k) fits = fits && (missing[k] == 0 || unmoved[k]);
  if (!fits)
    return {Code::stale_plan, fmt::format("what the members bring to rank {} isn't what their parts have there", rank),
            "push this step in order \"id\""};
  PushSlice whole{rank, scene.part.size(), {}};
  if (slices.size() == 1 && slices.front().count == whole.count) {
    slices.front().rank = rank;
    return {};
  }
  std::vector<std::size_t> slice_of_part;
  for (std::int64_t p = first_part; p < end_part; ++p)
    slice_of_part.push_back(
        slice_of[static_cast<std::size_t>(plan::rank_of_part(static_cast<int>(p), scene.options.parts, members))]);
  for (std::size_t a = 0; a < names.size(); ++a) {
    Buffer<double> joined;
    if (!joined.try_reserve(whole.count))
      return {Code::too_large, fmt::format("rank {} has no memory for {} particles", rank, whole.count)};
    joined.resize(whole.count);
    std::vector<const double*> next;
    for (const PushSlice& slice : slices) next.push_back(reinterpret_cast<const double*>(slice.arrays[a].bytes.data()));
    const bool axis = a < static_cast<std::size_t>(scene.options.dims);  // who brings weights has moved
    const double* own = axis ? scene.particles.position[a].data() : nullptr;
    for (std::size_t i = 0; i < joined.size(); ++i) {
      const std::size_t slice = slice_of_part[static_cast<std::size_t>(scene.part[i] - first_part)];
      joined[i] = slice < slices.size() ? *next[slice]++ : own[i];
    }
    for (PushSlice& slice : slices) slice.arrays[a].bytes.release();
    whole.arrays.push_back({names[a], "<f8", {whole.count}, joined.release_as<std::byte>()});
  }
  slices.clear();
  slices.push_back(std::move(whole));
  return {};
}

}  // namespace rcb::service
