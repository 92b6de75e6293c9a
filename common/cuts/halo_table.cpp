#include "common/cuts/halo_table.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace rcb::cuts {

using geometry::Box;

std::int32_t Images::index_of(const Image& image) {
  const auto [found, fresh] = index_.try_emplace(image.k, static_cast<std::int32_t>(all_.size()));
  if (fresh) all_.push_back(image);
  return found->second;
}

Status reached_by(const Reach& reach, const Targets& targets, const Box& box, std::int32_t part, double width,
                  Images& images, std::vector<Candidate>& found) {
  found.clear();
  std::vector<Image> near;
  if (Status status = reach.images_of(box, width, near); !status) return status;
  const Within within(reach.near().norm, width);
  const int own = targets.of(part);
  for (const Image& image : near)
    reach.near(image.of(box), within, [&](int other) {
      const int target = targets.of(other);
      if (target != own || image.k != Shift{}) found.push_back({other, target, images.index_of(image)});
    });
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
      entry_of_(at(targets.parts), kNotMade) {}

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
    fence.inner.lo[a] += width_ + margin;
    fence.inner.hi[a] -= width_ + margin;
  }
  if (!fence.inner.empty(reach_.dims()) &&
      std::any_of(all.begin(), all.end(), [&](const Candidate& one) { return near(one, fence.inner); }))
    fence.inner = Box{};
}

const Fence* HaloTable::make(std::int32_t part) {
  entry_of_[at(part)] = kNone;
  std::vector<Candidate> all;
  const std::size_t bytes = entries_.size() * sizeof(Entry) + lists_.size() * sizeof(Candidate);
  if (bytes > kBytesMost || !reached_by(reach_, targets_, reach_.region(part), part, width_, images_, all) ||
      all.size() > kBytesMost / 64)
    return nullptr;
  Entry entry;
  entry.fence.outer = reach_.region(part);
  shrink(entry.fence, all);
  entry.all = {static_cast<std::uint32_t>(lists_.size()), static_cast<std::uint32_t>(all.size())};
  lists_.insert(lists_.end(), all.begin(), all.end());
  entry_of_[at(part)] = static_cast<std::int32_t>(entries_.size());
  entries_.push_back(entry);
  return &entries_.back().fence;
}

std::span<const Candidate> HaloTable::candidates(std::int32_t part, int faces) {
  Entry& entry = entries_[at(entry_of_[at(part)])];
  List& list = entry.near_faces[at(faces)];
  if (list.begin == List::kNotMade) {
    Box box = entry.fence.outer;  // where the particles near these faces are
    for (std::size_t a = 0; a < at(reach_.dims()); ++a) {
      const int bits = faces >> (2 * a) & 3;
      if ((bits & 1) != 0) box.hi[a] = std::min(box.hi[a], entry.fence.inner.lo[a]);
      if ((bits & 2) != 0) box.lo[a] = std::max(box.lo[a], entry.fence.inner.hi[a]);
      if (bits == 0) box.lo[a] = entry.fence.inner.lo[a], box.hi[a] = entry.fence.inner.hi[a];
    }
    list.begin = static_cast<std::uint32_t>(lists_.size());
    for (std::size_t k = 0; k < entry.all.count; ++k)
      if (const Candidate one = lists_[entry.all.begin + k]; near(one, box)) lists_.push_back(one);
    list.count = static_cast<std::uint32_t>(lists_.size()) - list.begin;
  }
  return std::span(lists_).subspan(list.begin, list.count);
}

}  // namespace rcb::cuts
