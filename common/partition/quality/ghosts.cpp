#include "common/partition/quality/ghosts.hpp"

#include <algorithm>
#include <array>
#include <functional>
#include <numeric>
#include <utility>

#include <boost/icl/interval_set.hpp>

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

// What parts the owners of particles are near, as ranges that neither overlap nor touch. Part p is number p from
// turn * (parts + 1) on, where `turn` is that of the owner (see GhostWalk::owner()); between two owners one is left
// out.
using Near = boost::icl::interval_set<std::uint64_t, std::less, boost::icl::right_open_interval<std::uint64_t>>;
using Range = std::array<std::uint64_t, 2>;  // as it is sent

// Looks which boxes this rank's particles are near, one owner of particles after another.
class GhostWalk {
 public:
  GhostWalk(const particles::ParticleView& particles, std::span<const std::int32_t> part, std::vector<Box> boxes,
            double width, int ranks, const GhostLimits& limits)
      : particles_(particles),
        limits_(limits),
        ranks_(at(ranks)),
        parts_(boxes.size()),
        by_(particles::by_part(part, 0, static_cast<int>(parts_))),
        boxes_(std::move(boxes), particles.dims),
        within_(cuts::Norm::max, width),
        differences_(parts_ + 1, 0) {}

  std::uint64_t particles_of(std::size_t part) const { return by_.of(part).size(); }
  // By part, the difference of its number of particles nearby from that of the part before.
  std::span<const std::uint64_t> differences() const { return differences_; }
  // All owners before this turn are done.
  std::uint64_t turn() const { return turn_; }

  // Looks at more particles, until the round is over.
  void advance() {
    std::uint64_t visits = 0;
    for (; turn_ < parts_; ++turn_, next_ = 0) {
      if (near_.iterative_size() > limits_.pending_max && next_ == 0) return;  // others are behind
      for (const std::span<const std::size_t> own = by_.of(owner()); next_ < own.size(); ++next_) {
        if (visits >= limits_.round_visits) return;
        const Point point = particles_.point(own[next_]);
        visits += boxes_.near({point, point}, within_, [this](int first, int last) {
          ++differences_[at(first)];
          --differences_[at(last)];
          const std::uint64_t begin = turn_ * (parts_ + 1);
          near_.add({begin + at(first), begin + at(last)});
        });
      }
    }
  }
  // The ranges that owners before this turn are near, which are done; they are forgotten.
  std::vector<Range> take_before(std::uint64_t done) {
    std::vector<Range> taken;
    for (; !near_.empty() && near_.begin()->lower() < done * (parts_ + 1); near_.erase(near_.begin()))
      taken.push_back({near_.begin()->lower(), near_.begin()->upper()});
    return taken;
  }

 private:
  // The order of owners takes one part of each rank in turn: where every rank has the particles of its own parts, none
  // waits for others.
  std::size_t owner() const {
    const std::size_t each = parts_ / ranks_;
    return turn_ < each * ranks_ ? turn_ % ranks_ * each + turn_ / ranks_ : turn_;
  }

  const particles::ParticleView& particles_;
  const GhostLimits& limits_;
  std::size_t ranks_;
  std::size_t parts_;
  particles::ByPart by_;  // the local particles
  cuts::BoxTree boxes_;
  cuts::Within within_;
  std::vector<std::uint64_t> differences_;
  // Where advance() goes on: the owner's turn, and how many of its particles have been looked at.
  std::size_t turn_ = 0;
  std::size_t next_ = 0;
  Near near_;  // of the owners that not all ranks are done with
};

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
  // By part: those of walk.differences(), the likewise differences of its number of neighbours, its own particles.
  std::vector<std::uint64_t> sums(3 * (parts + 1), 0);
  const auto ghosts = std::span(sums).first(parts + 1);
  const auto neighbours = std::span(sums).subspan(parts + 1, parts + 1);
  const auto own = std::span(sums).last(parts + 1);
  for (std::uint64_t done = 0; done < parts;) {
    if (!go_on()) return std::nullopt;
    walk.advance();
    done = walk.turn();
    comm.all_min({&done, 1});
    // All ranks are done with these owners: rank 0 counts them as neighbours of the parts they are near.
    const std::vector<Range> here = walk.take_before(done);
    Near all;
    for (const auto& [first, end] : comm::gather_values<Range>(comm, here)) all.add({first, end});
    for (const auto& range : all) {
      ++neighbours[range.lower() % (parts + 1)];
      --neighbours[range.upper() % (parts + 1)];
    }
  }
  std::ranges::copy(walk.differences(), ghosts.begin());
  for (std::size_t p = 0; p < parts; ++p) own[p] = walk.particles_of(p);
  comm.all_sum(sums);
  std::partial_sum(ghosts.begin(), ghosts.end(), ghosts.begin());
  std::partial_sum(neighbours.begin(), neighbours.end(), neighbours.begin());
  // A part is near its own particles, too: these are no ghosts, and it is not its own neighbour.
  GhostCounts counts;
  for (std::size_t p = 0; p < parts; ++p) {
    counts.ghosts.push_back(ghosts[p] - own[p]);
    counts.neighbours.push_back(static_cast<std::int32_t>(neighbours[p] - (own[p] > 0 ? 1 : 0)));
  }
  return counts;
}

}  // namespace rcb::partition
