#include "common/partition/ghosts.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "common/base/check.hpp"
#include "common/geometry/axes.hpp"
#include "common/partition/cut_tree.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;
using geometry::Point;

constexpr std::uint64_t kNone = ~std::uint64_t{0};

std::size_t at(int index) { return static_cast<std::size_t>(index); }

// The bounding box of each part's particles, on all ranks; empty for a part without any. Collective.
std::vector<Box> part_boxes(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part,
                            int parts) {
  std::vector<Box> boxes(at(parts));
  for (std::size_t i = 0; i < particles.count; ++i) boxes[at(part[i])].extend(particles.point(i), particles.dims);
  const auto dims = at(particles.dims);
  std::vector<std::uint64_t> least(boxes.size() * dims * 2, kNone);
  for (std::size_t p = 0; p < boxes.size(); ++p)
    for (std::size_t a = 0; a < dims && !boxes[p].empty(particles.dims); ++a) {
      least[(p * dims + a) * 2] = geometry::image(boxes[p].lo[a]);
      least[(p * dims + a) * 2 + 1] = ~geometry::image(boxes[p].hi[a]);
    }
  comm.all_min(least);
  for (std::size_t p = 0; p < boxes.size(); ++p)
    for (std::size_t a = 0; a < dims && least[p * dims * 2] != kNone; ++a) {
      boxes[p].lo[a] = geometry::value_of_image(least[(p * dims + a) * 2]);
      boxes[p].hi[a] = geometry::value_of_image(~least[(p * dims + a) * 2 + 1]);
    }
  return boxes;
}

// The parts' boxes below the nodes of the tree of parts (the numbering of NodeRange).
class BoxTree {
 public:
  BoxTree(std::vector<Box> leaves, int dims, double width)
      : leaves_(std::move(leaves)), inner_(leaves_.size()), dims_(at(dims)), width_(width) {
    build(root());
  }
  // Calls visit(first, last) for ranges that together are the parts whose boxes are within the width of the point, in
  // the maximum norm, ascending. Returns how many boxes were looked at.
  template <typename Visit>
  std::uint64_t near(const Point& point, const Visit& visit) const {
    return descend(root(), point, visit);
  }

 private:
  // Of the boxes of a subtree: the box around all, and what every one of them has in common: none begins above
  // `last_lo`, none ends below `first_hi`.
  struct Bounds {
    Box around;
    Point last_lo;
    Point first_hi;
  };

  NodeRange root() const { return {0, 0, static_cast<int>(leaves_.size())}; }
  Bounds of(const NodeRange& range) const {
    if (!range.leaf()) return inner_[at(range.node)];
    const Box& box = leaves_[at(range.first)];
    return {box, box.lo, box.hi};
  }
  void build(const NodeRange& range) {
    if (range.leaf()) return;
    build(range.left());
    build(range.right());
    Bounds bounds = of(range.left());
    const Bounds right = of(range.right());
    bounds.around.extend(right.around);
    for (std::size_t a = 0; a < dims_; ++a) {
      bounds.last_lo[a] = std::max(bounds.last_lo[a], right.last_lo[a]);
      bounds.first_hi[a] = std::min(bounds.first_hi[a], right.first_hi[a]);
    }
    inner_[at(range.node)] = bounds;
  }
  // An empty box begins at infinity and ends at minus infinity: it is far from everything.
  bool far(const Box& box, const Point& point) const {
    for (std::size_t a = 0; a < dims_; ++a)
      if (box.lo[a] > box.hi[a] || box.lo[a] - point[a] > width_ || point[a] - box.hi[a] > width_) return true;
    return false;
  }
  bool all_near(const Bounds& bounds, const Point& point) const {
    for (std::size_t a = 0; a < dims_; ++a)
      if (bounds.last_lo[a] - point[a] > width_ || point[a] - bounds.first_hi[a] > width_) return false;
    return true;
  }
  template <typename Visit>
  std::uint64_t descend(const NodeRange& range, const Point& point, const Visit& visit) const {
    if (range.leaf()) {
      if (!far(leaves_[at(range.first)], point)) visit(range.first, range.last);
      return 1;
    }
    const Bounds& bounds = inner_[at(range.node)];
    if (far(bounds.around, point)) return 1;
    if (all_near(bounds, point)) {
      visit(range.first, range.last);
      return 1;
    }
    return 1 + descend(range.left(), point, visit) + descend(range.right(), point, visit);
  }

  std::vector<Box> leaves_;
  std::vector<Bounds> inner_;
  std::size_t dims_;
  double width_;
};

// The local particles' rows by part.
struct ByPart {
  std::vector<std::size_t> start;  // of each part, and the end
  std::vector<std::size_t> row;
};

ByPart group(std::span<const std::int32_t> part, int parts) {
  ByPart by;
  by.start.assign(at(parts) + 1, 0);
  for (const std::int32_t p : part) ++by.start[at(p) + 1];
  for (std::size_t p = 0; p < at(parts); ++p) by.start[p + 1] += by.start[p];
  by.row.resize(part.size());
  std::vector<std::size_t> next(by.start.begin(), by.start.end() - 1);
  for (std::size_t i = 0; i < part.size(); ++i) by.row[next[at(part[i])]++] = i;
  return by;
}

// The owner of this turn has particles near all parts of [first, last).
struct Reach {
  std::int32_t turn;
  std::int32_t first;
  std::int32_t last;
};

// Puts ranges of the same turn that meet together.
void join(std::vector<Reach>& reaches) {
  std::sort(reaches.begin(), reaches.end(),
            [](const Reach& a, const Reach& b) { return std::pair(a.turn, a.first) < std::pair(b.turn, b.first); });
  std::size_t kept = 0;
  for (const Reach& reach : reaches) {
    Reach* const last = kept == 0 ? nullptr : &reaches[kept - 1];
    if (last != nullptr && last->turn == reach.turn && last->last >= reach.first)
      last->last = std::max(last->last, reach.last);
    else
      reaches[kept++] = reach;
  }
  reaches.resize(kept);
}

class GhostSearch {
 public:
  GhostSearch(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part, int parts,
              double width, const GhostLimits& limits)
      : comm_(comm),
        particles_(particles),
        limits_(limits),
        parts_(parts),
        boxes_(part_boxes(comm, particles, part, parts), particles.dims, width),
        by_(group(part, parts)),
        ghost_steps_(at(parts) + 1, 0),
        neighbour_steps_(at(parts) + 1, 0) {}

  bool run(const GoOn& go_on, GhostCounts& counts) {
    std::uint64_t done = 0;
    while (done < static_cast<std::uint64_t>(parts_)) {
      if (!go_on()) return false;
      advance();
      done = static_cast<std::uint64_t>(turn_);
      comm_.all_min({&done, 1});
      settle(static_cast<std::int32_t>(done));
    }
    finish(counts);
    return true;
  }

 private:
  static constexpr std::size_t kJoinAt = 1024;  // ranges of one owner

  // The owners' order: in turn one of each rank's, where every rank has the particles of its own parts, so that no rank
  // waits for others.
  int owner_of(int turn) const {
    const int ranks = comm_.size();
    const int each = parts_ / ranks;
    const int dealt = each * ranks;
    return turn < dealt ? turn % ranks * each + turn / ranks : turn;
  }

  // Looks at more particles, a round's worth.
  void advance() {
    std::uint64_t visits = 0;
    for (; turn_ < parts_; ++turn_, next_ = 0) {
      const std::size_t owner = at(owner_of(turn_));
      const std::size_t before = own_.size();
      for (std::size_t k = by_.start[owner] + next_; k < by_.start[owner + 1]; ++k, ++next_) {
        if (visits >= limits_.round_visits || (pending_.size() > limits_.pending_max && before == 0)) return;
        visits += boxes_.near(particles_.point(by_.row[k]), [this](int first, int last) {
          ++ghost_steps_[at(first)];
          --ghost_steps_[at(last)];
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

  // The owners of the turns below `done` have been looked at on all ranks. Rank 0 counts them. Collective.
  void settle(std::int32_t done) {
    const auto end = std::partition_point(pending_.begin(), pending_.end(),
                                          [done](const Reach& reach) { return reach.turn < done; });
    const auto count = static_cast<std::size_t>(end - pending_.begin());
    std::vector<std::byte> bytes;
    std::vector<std::size_t> sizes;
    comm_.gather(std::as_bytes(std::span(pending_).first(count)), 0, bytes, sizes);
    pending_.erase(pending_.begin(), end);
    std::vector<Reach> all(bytes.size() / sizeof(Reach));
    if (!bytes.empty()) std::memcpy(all.data(), bytes.data(), bytes.size());
    join(all);
    for (const Reach& reach : all) {
      ++neighbour_steps_[at(reach.first)];
      --neighbour_steps_[at(reach.last)];
    }
  }

  // The sums of the steps. A part is near its own particles, which count neither as ghosts nor as a neighbour's.
  void finish(GhostCounts& counts) {
    counts.ghosts.resize(at(parts_));
    std::vector<std::uint64_t> neighbours(at(parts_));
    std::uint64_t ghosts = 0;
    std::uint64_t owners = 0;
    std::vector<std::uint64_t> own(at(parts_));
    for (std::size_t p = 0; p < at(parts_); ++p) own[p] = by_.start[p + 1] - by_.start[p];
    for (std::size_t p = 0; p < at(parts_); ++p) {
      counts.ghosts[p] = (ghosts += ghost_steps_[p]) - own[p];
      neighbours[p] = owners += neighbour_steps_[p];
    }
    comm_.all_sum(counts.ghosts);
    comm_.all_sum(own);
    comm_.broadcast(std::as_writable_bytes(std::span(neighbours)), 0);
    for (std::size_t p = 0; p < at(parts_); ++p)
      counts.neighbours.push_back(static_cast<std::int32_t>(neighbours[p] - (own[p] > 0 ? 1 : 0)));
  }

  Comm& comm_;
  const particles::ParticleView& particles_;
  const GhostLimits& limits_;
  int parts_;
  BoxTree boxes_;
  ByPart by_;
  // By part, the difference from the part before it.
  std::vector<std::uint64_t> ghost_steps_;
  std::vector<std::uint64_t> neighbour_steps_;
  // Where advance() goes on: the owner's turn, and how many of its particles have been looked at.
  std::int32_t turn_ = 0;
  std::size_t next_ = 0;
  std::vector<Reach> own_;  // of that owner
  std::size_t join_at_ = kJoinAt;
  std::vector<Reach> pending_;  // of earlier ones, ascending
};

}  // namespace

bool count_ghosts(Comm& comm, const particles::ParticleView& particles, std::span<const std::int32_t> part, int parts,
                  double width, const GoOn& go_on, GhostCounts& counts, const GhostLimits& limits) {
  CHECK(part.size() == particles.count && parts >= 1, "a part for each particle");
  return GhostSearch(comm, particles, part, parts, width, limits).run(go_on, counts);
}

}  // namespace rcb::partition
