// CutSearch: exact distributed selection, for all nodes of a tree level together. For each node it finds the smallest
// key of the right side: the same bits on every rank, however the particles are distributed.
//
// Invariants
// 1. The wanted key is that of an undecided point. A round looks at the undecided points alone.
// 2. The first bracket is `within`. If the key isn't in it, the search ends and says on which side it is.
// 3. A round makes a histogram of the undecided points' integers on the cut axis; the bin that holds the wanted key
//    becomes the bracket, and the points outside of it are no longer undecided.
// 4. Where all undecided points have one integer, and are too many to be gathered, their integers are replaced until
//    the search ends by the first key word that not all of them share, less its least value: key words are the
//    coordinates in the node's axis order, then the id. Each round divides a bracket by at least 64: quantised integers
//    take at most 6 rounds, and a key word 11 on windows of 30 bits of it (5 + 5 + 1), whatever the distribution; one
//    that all undecided points share takes none.
// 5. In a node whose points all lie in one place, ids take the integers' place for good.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/base/exact_scale.hpp"
#include "common/base/index.hpp"
#include "common/comm/comm.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/points/axis_map.hpp"
#include "common/partition/points/segment.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

// A key as words: the coordinates' order-preserving bits in the node's axis order, then the id in [words - 1]; unused
// words are 0.
using KeyWords = std::array<std::uint64_t, geometry::kDimsMax + 1>;

// Values of a key word.
struct WordRange {
  std::uint64_t first = ~std::uint64_t{0};
  std::uint64_t last = 0;
};

// A node's points: the particles of it that were opened. All ranks' but for the segments.
struct PointSet {
  std::span<Segment> segments;  // this rank's
  Load load;                    // count: without weights; weight: with
  QBounds bounds;               // of their integers
  // They are known to lie in one place, so that only ids tell them apart. Then the node has no wholes, and `within` is
  // everything; a search may overwrite their integers on axis 0.
  bool one_place = false;
  bool by_id = false;             // these have been overwritten by ids, less the least id of all particles
  std::optional<Integers> crowd;  // this rank's points with these integers are known to lie in one place
};

// A cut that is wanted. Particles of the node that have no point lie in wholes, on either side of `within`.
struct CutRequest {
  PointSet points;
  AxisOrder axes{0, 1, 2};
  Load before;                               // of the wholes below `within`; with weights, count and weight
  Load all;                                  // with weights, the weight: of the node, points and wholes
  Interval within = Interval::everything();  // where the key's first integer is looked for; no whole meets it
  // Without weights: wanted is the key in this place (from 0) among the node's keys.
  std::uint64_t rank = 0;
  // With weights: the left side takes the prefix with the weight nearest to all.weight * left_size / size; on a tie,
  // and among prefixes of the same weight, the shortest.
  u128 left_size = 0;
  u128 size = 1;
  // The left side may have so many particles (so much weight) more or less than wanted. 0: exact, as it must be where
  // there are wholes.
  u128 slack = 0;
};

struct CutFound {
  // Where the wanted key is; with weights, that of the particle with which the prefix reaches threshold_of(). If not
  // `within`, only points_below and points_within are specified, and the points are as they were but for their order.
  enum class Where : std::uint8_t { within, below, above };
  Where where = Where::within;
  Load points_below;  // of the points below `within`, and in it: all ranks' (count: without weights; weight: with)
  Load points_within;
  bool right_empty = false;
  KeyWords key{};  // smallest key of the right side
  Load left;       // of the left side, wholes included (count: without weights; weight: with)
  // On the cut axis: the integers of the least and of the greatest key that the cut depends on. It is the cut of all
  // the node's particles unless a whole meets this. lo = 0 or hi = kTop: there is no point on that side, but a whole's
  // particle might be.
  Interval relied_on;
  bool by_id = false;             // as PointSet::by_id, for both sides
  std::optional<Integers> crowd;  // as PointSet::crowd, if the search has found one
};

// With weights: the left side's target, rounded up. The cut lies before or behind the particle whose prefix reaches it.
u128 threshold_of(const CutRequest& request);

struct SearchContext {
  comm::Comm& comm;
  const particles::ParticleView& particles;
  const AxisMaps& maps;
  const std::optional<ExactScale>& scale;  // of the weights, if they count
  const Tuning& tuning;
  SearchCost& cost;                    // what a search costs is added to it
  std::optional<WordRange> all_ids{};  // of all particles, once they have been needed
  std::uint64_t gather_limit = 0;      // up to so many candidates of a node are gathered instead of counted

  bool weighted() const { return scale.has_value(); }
  std::size_t axes() const { return at(particles.dims); }
  u128 weight(std::size_t particle) const { return weighted() ? (*scale)(particles.weight[particle]) : 0; }
};

class CutSearch {
 public:
  explicit CutSearch(const SearchContext& context) : context_(context) {}

  // The cuts of these nodes. Afterwards each segment of their points is divided by the node's key: `middle`, which
  // equals `upper`, is where the right side begins. Collective (a few reductions a round).
  std::vector<CutFound> find(std::span<const CutRequest> requests);

 private:
  SearchContext context_;
};

}  // namespace rcb::partition
