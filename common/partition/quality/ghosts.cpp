#include "common/partition/quality/ghosts.hpp"

#include <algorithm>
#include <utility>

#include "common/base/check.hpp"
#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/cuts/box_tree.hpp"
#include "common/particles/by_part.hpp"
#include "common/partition/balance/bounds.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;
using geometry::Point;

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

// Looks which boxes this rank's particles are near, one owner of particles after another.
class GhostWalk {
 public:
  GhostWalk(const particles::ParticleView& particles, std::span<const std::int32_t> part, std::vector<Box> boxes,
            double width, int ranks, const GhostLimits& limits)
      : particles_(particles),
        limits_(limits),
        ranks_(ranks),
        by_(particles::by_part(part, 0, static_cast<int>(boxes.size()))),
        boxes_(std::move(boxes), particles.dims),
        within_(cuts::Norm::max, width),
        differences_(by_.start.size(), 0) {}

  std::size_t particles_of(std::size_t part) const { return by_.of(part).size(); }
  // By part, the difference of its number of particles nearby from that of the part before.
  std::span<const std::uint64_t> differences() const { return differences_; }
  // All owners before this turn are done.
  std::int32_t turn() const { return turn_; }
  // The ranges that owners before this turn are near, which are done; they are forgotten.
  std::vector<NearRange> take_before(std::int32_t done) {
    const auto end =
        std::ranges::partition_point(pending_, [done](const NearRange& r) { return r.owner_index < done; });
    std::vector<NearRange> taken(pending_.begin(), end);
    pending_.erase(pending_.begin(), end);
    return taken;
  }

  // Looks at more particles, until the round is over.
  void advance() {
    std::uint64_t visits = 0;
    for (const auto parts = static_cast<std::int32_t>(by_.start.size()) - 1; turn_ < parts; ++turn_, next_ = 0) {
      const std::span<const std::size_t> particles = by_.of(at(owner_of(turn_)));
      const std::size_t before = own_.size();
      for (; next_ < particles.size(); ++next_) {
        if (visits >= limits_.round_visits || (pending_.size() > limits_.pending_max && before == 0)) return;
        const Point point = particles_.point(particles[next_]);
        visits += boxes_.near({point, point}, within_, [this](int first, int last) {
          ++differences_[at(first)];
          --differences_[at(last)];
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

 private:
  static constexpr std::size_t kJoinAt = 1024;  // ranges of one owner, merged once there are so many

  // The order of owners takes one part of each rank in turn: where every rank has the particles of its own parts, none
  // waits for others.
  int owner_of(int owner_index) const {
    const int each = (static_cast<int>(by_.start.size()) - 1) / ranks_;
    return owner_index < each * ranks_ ? owner_index % ranks_ * each + owner_index / ranks_ : owner_index;
  }

  const particles::ParticleView& particles_;
  const GhostLimits& limits_;
  int ranks_;
  particles::ByPart by_;  // the local particles
  cuts::BoxTree boxes_;
  cuts::Within within_;
  std::vector<std::uint64_t> differences_;
  // Where advance() goes on: the owner's turn, and how many of its particles have been looked at.
  std::int32_t turn_ = 0;
  std::size_t next_ = 0;
  std::vector<NearRange> own_;  // ranges of that owner
  std::size_t join_at_ = kJoinAt;
  std::vector<NearRange> pending_;  // ranges of earlier owners, ascending by turn
};

// Prefix sums of differences give counts. A part is near its own particles, too: these are no ghosts, and it is not its
// own neighbour. neighbours: differences, on rank 0. Collective.
GhostCounts sum_up(comm::Comm& comm, const GhostWalk& walk, std::vector<std::uint64_t> neighbours) {
  const std::size_t parts = neighbours.size() - 1;
  GhostCounts counts;
  std::vector<std::uint64_t> own(parts);
  std::uint64_t ghosts = 0;
  for (std::size_t p = 0; p < parts; ++p) {
    own[p] = walk.particles_of(p);
    counts.ghosts.push_back((ghosts += walk.differences()[p]) - own[p]);
    if (p > 0) neighbours[p] += neighbours[p - 1];
  }
  comm.all_sum(counts.ghosts);
  comm.all_sum(own);
  comm.broadcast(std::as_writable_bytes(std::span(neighbours)), 0);
  for (std::size_t p = 0; p < parts; ++p)
    counts.neighbours.push_back(static_cast<std::int32_t>(neighbours[p] - (own[p] > 0 ? 1 : 0)));
  return counts;
}

}  // namespace

std::vector<Box> part_boxes(comm::Comm& comm, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, int parts) {
  std::vector<Box> boxes(at(parts));
  for (std::size_t i = 0; i < particles.count; ++i) boxes[at(part[i])].extend(particles.point(i), particles.dims);
  AllMinMax all;
  for (const Box& box : boxes) all.add(box, particles.dims);
  all.reduce(comm);
  for (Box& box : boxes) all.take(box, particles.dims);
  return boxes;
}

std::optional<GhostCounts> count_ghosts(comm::Comm& comm, const particles::ParticleView& particles,
                                        std::span<const std::int32_t> part, std::vector<Box> boxes, double width,
                                        const comm::GoOn& go_on, const GhostLimits& limits) {
  RCB_CHECK(part.size() == particles.count && !boxes.empty(), "a part for each particle");
  const std::size_t parts = boxes.size();
  GhostWalk walk(particles, part, std::move(boxes), width, comm.size(), limits);
  std::vector<std::uint64_t> neighbours(parts + 1, 0);
  for (std::uint64_t done = 0; done < parts;) {
    if (!go_on()) return std::nullopt;
    walk.advance();
    done = static_cast<std::uint64_t>(walk.turn());
    comm.all_min({&done, 1});
    // All ranks are done with these owners: rank 0 counts them as neighbours of the parts they are near.
    const std::vector<NearRange> here = walk.take_before(static_cast<std::int32_t>(done));
    Buffer<NearRange> all = comm::gather_values<NearRange>(comm, here);
    join(all);
    for (const NearRange& reach : all) {
      ++neighbours[at(reach.first)];
      --neighbours[at(reach.last)];
    }
  }
  return sum_up(comm, walk, std::move(neighbours));
}

}  // namespace rcb::partition
