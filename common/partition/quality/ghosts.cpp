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
#include "common/partition/quality/quality.hpp"

namespace rcb::partition {
namespace {

using geometry::Box;
using geometry::Point;

// What parts the owners of particles are near, as ranges that neither overlap nor touch. Part p is number p from
// turn * (parts + 1) on, where `turn` is that of the owner; between two owners one number is left out.
using Near = boost::icl::interval_set<std::uint64_t, std::less, boost::icl::right_open_interval<std::uint64_t>>;
using Range = std::array<std::uint64_t, 2>;  // as it is sent

// The order of owners takes one part of each rank in turn: where every rank has the particles of its own parts, none
// waits for others.
std::size_t owner_of(std::size_t turn, std::size_t parts, std::size_t ranks) {
  const std::size_t each = parts / ranks;
  return turn < each * ranks ? turn % ranks * each + turn / ranks : turn;
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
  const particles::ByPart by = particles::by_part(part, 0, static_cast<int>(parts));  // the local particles
  const cuts::BoxTree tree(std::move(boxes), particles.dims);
  const cuts::Within within(cuts::Norm::max, width);
  // By part: how many particles are near it, and how many parts own them, each less that of the part before; and how
  // many particles it has itself.
  std::vector<std::uint64_t> sums(3 * (parts + 1), 0);
  const auto ghosts = std::span(sums).first(parts + 1);
  const auto neighbours = std::span(sums).subspan(parts + 1, parts + 1);
  const auto own = std::span(sums).last(parts + 1);
  for (std::size_t p = 0; p < parts; ++p) own[p] = by.of(p).size();
  // Where a round goes on: the owner whose turn it is, and how many of its particles have been looked at.
  std::size_t turn = 0;
  std::size_t next = 0;
  Near near;  // of the owners that not all ranks are done with
  const auto look_at_some = [&] {
    std::uint64_t visits = 0;
    for (; turn < parts; ++turn, next = 0) {
      if (near.iterative_size() > limits.pending_max && next == 0) return;  // others are behind
      const std::span<const std::size_t> particles_of_owner = by.of(owner_of(turn, parts, at(comm.size())));
      for (; next < particles_of_owner.size(); ++next) {
        if (visits >= limits.round_visits) return;
        const Point point = particles.point(particles_of_owner[next]);
        visits += tree.near({point, point}, within, [&](int first, int end) {
          ++ghosts[at(first)];
          --ghosts[at(end)];
          const std::uint64_t begin = turn * (parts + 1);
          const Near::interval_type range(begin + at(first), begin + at(end));
          if (!boost::icl::contains(near, range)) near.add(range);  // adding takes longer
        });
      }
    }
  };
  for (std::uint64_t done = 0; done < parts;) {
    if (!go_on()) return std::nullopt;
    look_at_some();
    done = turn;
    comm.all_min({&done, 1});
    // All ranks are done with the owners before that: rank 0 counts them as neighbours of the parts they are near.
    std::vector<Range> here;
    for (; !near.empty() && near.begin()->lower() < done * (parts + 1); near.erase(near.begin()))
      here.push_back({near.begin()->lower(), near.begin()->upper()});
    Near all;
    for (const auto& [first, end] : comm::gather_values<Range>(comm, here)) all.add({first, end});
    for (const auto& range : all) {
      ++neighbours[range.lower() % (parts + 1)];
      --neighbours[range.upper() % (parts + 1)];
    }
  }
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
