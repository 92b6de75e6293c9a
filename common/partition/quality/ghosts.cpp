#include "common/partition/quality/ghosts.hpp"

#include <algorithm>
#include <utility>

#include "common/base/check.hpp"
#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/geometry/axes.hpp"
#include "common/particles/by_part.hpp"
#include "common/partition/balance/bounding_box.hpp"
#include "common/cuts/box_tree.hpp"

namespace rcb::partition {
namespace {

using cuts::NodeRange;
using geometry::Box;
using geometry::Point;

// The bounding box of each part's particles, on all ranks; empty for a part without any. Collective.
std::vector<Box> part_boxes(comm::Comm& comm, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, int parts) {
  std::vector<Box> boxes(at(parts));
  for (std::size_t i = 0; i < particles.count; ++i) boxes[at(part[i])].extend(particles.point(i), particles.dims);
  extend_by_all(comm, boxes, particles.dims);
  return boxes;
}

// The owner whose turn is number `owner_index` (see owner_of()) has particles near all parts of [first, last).
struct NearRange {
  std::int32_t owner_index;
  std::int32_t first;
  std::int32_t last;
};

// Merges ranges of the same owner that overlap or touch.
template <typename Reaches>
void join(Reaches& reaches) {
  std::sort(reaches.begin(), reaches.end(), [](const NearRange& a, const NearRange& b) {
    return std::pair(a.owner_index, a.first) < std::pair(b.owner_index, b.first);
  });
  std::size_t kept = 0;
  for (const NearRange& reach : reaches) {
    NearRange* const last = kept == 0 ? nullptr : &reaches[kept - 1];
    if (last != nullptr && last->owner_index == reach.owner_index && last->last >= reach.first)
      last->last = std::max(last->last, reach.last);
    else
      reaches[kept++] = reach;
  }
  reaches.resize(kept);
}

class GhostSearch {
 public:
  GhostSearch(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part, int parts,
              double width, const GhostLimits& limits)
      : comm_(comm),
        particles_(particles),
        limits_(limits),
        parts_(parts),
        boxes_(part_boxes(comm, particles, part, parts), particles.dims),
        within_(cuts::Norm::max, width),
        by_(particles::by_part(part, 0, parts)),
        ghost_differences_(at(parts) + 1, 0),
        neighbour_differences_(at(parts) + 1, 0) {}

  std::optional<GhostCounts> run(const comm::GoOn& go_on) {
    std::uint64_t done = 0;
    while (done < static_cast<std::uint64_t>(parts_)) {
      if (!go_on()) return std::nullopt;
      advance();
      done = static_cast<std::uint64_t>(turn_);
      comm_.all_min({&done, 1});
      count_finished_owners(static_cast<std::int32_t>(done));
    }
    return finish();
  }

 private:
  static constexpr std::size_t kJoinAt = 1024;  // ranges of one owner, merged once there are so many

  // The order of owners takes one part of each rank in turn: where every rank has the particles of its own parts, none
  // waits for others.
  int owner_of(int owner_index) const {
    const int ranks = comm_.size();
    const int each = parts_ / ranks;
    const int dealt = each * ranks;
    return owner_index < dealt ? owner_index % ranks * each + owner_index / ranks : owner_index;
  }

  // Looks at more particles, until the round is over.
  void advance() {
    std::uint64_t visits = 0;
    for (; turn_ < parts_; ++turn_, next_ = 0) {
      const std::size_t owner = at(owner_of(turn_));
      const std::size_t before = own_.size();
      for (std::size_t k = by_.start[owner] + next_; k < by_.start[owner + 1]; ++k, ++next_) {
        if (visits >= limits_.round_visits || (pending_.size() > limits_.pending_max && before == 0)) return;
        const Point point = particles_.point(by_.particle[k]);
        visits += boxes_.near({point, point}, within_, [this](int first, int last) {
          ++ghost_differences_[at(first)];
          --ghost_differences_[at(last)];
          own_.push_back({turn_, first, last});
        });
        if (own_.size() >= join_at_) {
          join(own_);
          join_at_ = std::max(kJoinAt, 2 * own_.size());
        }
      }
      join(own_);
      pending_.insert(pending_.end(), own_.begin(), own_.end());
      own_.clear();
      join_at_ = kJoinAt;
    }
  }

  // All ranks are done with owners below `done`: rank 0 counts them as neighbours of the parts they are near.
  // Collective.
  void count_finished_owners(std::int32_t done) {
    const auto end = std::partition_point(pending_.begin(), pending_.end(),
                                          [done](const NearRange& reach) { return reach.owner_index < done; });
    const auto count = static_cast<std::size_t>(end - pending_.begin());
    Buffer<NearRange> all = comm::gather_values<NearRange>(comm_, std::span(pending_).first(count));
    pending_.erase(pending_.begin(), end);
    join(all);
    for (const NearRange& reach : all) {
      ++neighbour_differences_[at(reach.first)];
      --neighbour_differences_[at(reach.last)];
    }
  }

  // Prefix sums give counts. A part is near its own particles, too: these are no ghosts, and it is not its own
  // neighbour.
  GhostCounts finish() {
    GhostCounts counts;
    counts.ghosts.resize(at(parts_));
    std::vector<std::uint64_t> neighbours(at(parts_));
    std::uint64_t ghosts = 0;
    std::uint64_t owners = 0;
    std::vector<std::uint64_t> own(at(parts_));
    for (std::size_t p = 0; p < at(parts_); ++p) own[p] = by_.start[p + 1] - by_.start[p];
    for (std::size_t p = 0; p < at(parts_); ++p) {
      counts.ghosts[p] = (ghosts += ghost_differences_[p]) - own[p];
      neighbours[p] = owners += neighbour_differences_[p];
    }
    comm_.all_sum(counts.ghosts);
    comm_.all_sum(own);
    comm_.broadcast(std::as_writable_bytes(std::span(neighbours)), 0);
    for (std::size_t p = 0; p < at(parts_); ++p)
      counts.neighbours.push_back(static_cast<std::int32_t>(neighbours[p] - (own[p] > 0 ? 1 : 0)));
    return counts;
  }

  comm::Comm& comm_;
  const particles::ParticleView& particles_;
  const GhostLimits& limits_;
  int parts_;
  cuts::BoxTree boxes_;
  cuts::Within within_;
  particles::ByPart by_;  // the local particles
  // By part, the difference of its count from that of the part before.
  std::vector<std::uint64_t> ghost_differences_;
  std::vector<std::uint64_t> neighbour_differences_;
  // Where advance() goes on: the owner's turn, and how many of its particles have been looked at.
  std::int32_t turn_ = 0;
  std::size_t next_ = 0;
  std::vector<NearRange> own_;  // ranges of that owner
  std::size_t join_at_ = kJoinAt;
  std::vector<NearRange> pending_;  // ranges of earlier owners, ascending by turn
};

}  // namespace

std::optional<GhostCounts> count_ghosts(comm::Comm& comm, const particles::ParticleView& particles,
                                        std::span<const std::int32_t> part, int parts, double width,
                                        const comm::GoOn& go_on, const GhostLimits& limits) {
  RCB_CHECK(part.size() == particles.count && parts >= 1, "a part for each particle");
  return GhostSearch(comm, particles, part, parts, width, limits).run(go_on);
}

}  // namespace rcb::partition
