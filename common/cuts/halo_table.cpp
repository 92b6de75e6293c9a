#include "common/cuts/halo_table.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include <fmt/format.h>

namespace rcb::cuts {

using geometry::Box;

std::int32_t Images::index_of(const Image& image) {
  const auto [found, fresh] = index_.try_emplace(image.k, static_cast<std::int32_t>(all_.size()));
  if (fresh) all_.push_back(image);
  return found->second;
}

Status reached_by(const Reach& reach, const Targets& targets, const Box& box, std::int32_t part, double width,
                  Images& images, std::vector<Candidate>& found, std::size_t most) {
  found.clear();
  std::vector<Image> near;
  if (Status status = reach.images_of(box, width, near); !status) return status;
  const Within within(reach.near().norm, width);
  const int own = targets.of(part);
  for (const Image& image : near) {
    reach.near(image.of(box), within, [&](int other) {
      const int target = targets.of(other);
      if (found.size() <= most && (target != own || image.k != Shift{}))
        found.push_back({other, target, images.index_of(image)});
    });
    if (found.size() > most)
      return {Code::too_large, fmt::format("more than {} regions and images are within {}", most, width),
              "give a smaller width"};
  }
  std::sort(found.begin(), found.end(), [&images](const Candidate& a, const Candidate& b) {
    return std::tie(a.target, images[a.image].k, a.part) < std::tie(b.target, images[b.image].k, b.part);
  });
  return {};
}

HaloTable::HaloTable(const Reach& reach, const Targets& targets, double width, Images& images)
    : reach_(reach),
      targets_(targets),
      width_(width),
      within_(reach.near().norm, width),
      images_(images),
      index_of_(at(targets.parts), kNotMade),
      lists_(kSpare) {}

bool HaloTable::near(const Candidate& candidate, const Box& box) const {
  const Box moved = Reach::finite(images_[candidate.image].of(box));
  Point gaps{};
  for (std::size_t a = 0; a < at(reach_.dims()); ++a)
    gaps[a] = gap_of(reach_.region(candidate.part), a, moved.lo[a], moved.hi[a]);
  return within_(gaps);
}

// Sets fence.inner. The margin only makes it likely that no candidate is near; whether none is, is then looked at.
void HaloTable::shrink(Fence& fence, std::span<const Candidate> all) const {
  fence.inner = fence.outer;
  const PeriodicBox& box = reach_.near().box;
  for (std::size_t a = 0; a < at(reach_.dims()); ++a) {
    double largest = width_;
    for (const double bound : {fence.outer.lo[a], fence.outer.hi[a], box.lo[a], box.hi[a]})
      if (std::isfinite(bound)) largest = std::max(largest, std::abs(bound));
    const double margin = largest * 16 * std::numeric_limits<double>::epsilon();
    const double by = std::min(width_ + margin, std::numeric_limits<double>::max());
    fence.inner.lo[a] += by;
    fence.inner.hi[a] -= by;
  }
  if (!fence.inner.empty(reach_.dims()) &&
      std::any_of(all.begin(), all.end(), [&](const Candidate& one) { return near(one, fence.inner); }))
    fence.inner = Box{};
}

const Fence* HaloTable::make(std::int32_t part) {
  index_of_[at(part)] = kNone;
  std::vector<Candidate> all;
  const std::size_t bytes = fences_.size() * (sizeof(Fence) + sizeof(Lists)) + lists_.size() * sizeof(Candidate);
  if (bytes > kBytesMost ||
      !reached_by(reach_, targets_, reach_.region(part), part, width_, images_, all, kBytesMost / 64))
    return nullptr;
  Fence fence;
  fence.outer = reach_.region(part);
  shrink(fence, all);
  index_of_[at(part)] = static_cast<std::int32_t>(fences_.size());
  fences_.push_back(fence);
  lists_of_.emplace_back();
  lists_of_.back().all = add_list(all);
  return &fences_.back();
}

HaloTable::List HaloTable::add_list(const std::vector<Candidate>& candidates) {
  const std::size_t begin = lists_.size() - kSpare;
  lists_.insert(lists_.end() - kSpare, candidates.begin(), candidates.end());
  return {static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(candidates.size())};
}

std::span<const Candidate> HaloTable::make_list(std::int32_t part, std::uint32_t faces) {
  const auto index = at(index_of_[at(part)]);
  const List all = lists_of_[index].all;
  if (lists_.size() * sizeof(Candidate) > kBytesMost) return std::span(lists_).subspan(all.begin, all.count);
  const Fence& fence = fences_[index];
  Box box = fence.outer;  // where the particles near these faces are
  for (std::size_t a = 0; a < at(reach_.dims()); ++a) {
    const std::uint32_t bits = faces >> (2 * a) & 3U;
    if ((bits & 1) != 0) box.hi[a] = std::min(box.hi[a], fence.inner.lo[a]);
    if ((bits & 2) != 0) box.lo[a] = std::max(box.lo[a], fence.inner.hi[a]);
    if (bits == 0) box.lo[a] = fence.inner.lo[a], box.hi[a] = fence.inner.hi[a];
  }
  std::vector<Candidate> near_box;
  for (std::size_t k = all.begin; k < at(all.begin) + all.count; ++k)
    if (const Candidate one = lists_[k]; near(one, box)) near_box.push_back(one);
  const List list = add_list(near_box);
  lists_of_[index].near_faces[at(faces)] = list;
  return std::span(lists_).subspan(list.begin, list.count);
}

}  // namespace rcb::cuts
