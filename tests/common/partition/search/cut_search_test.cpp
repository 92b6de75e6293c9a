// CutSearch alone, against full sorts: random points and wholes, ties, weights, and intervals where the key isn't.
#include "common/partition/search/cut_search.hpp"

#include <numeric>

#include <boost/multiprecision/cpp_int.hpp>
#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::partition {
namespace {

using Exact = boost::multiprecision::cpp_int;
using Where = CutFound::Where;
constexpr std::uint64_t kCutSeed = 20261129;

// All ranks' particles of all nodes, the same on every rank.
struct SearchScene {
  particles::ParticleSet set;
  AxisMaps maps;
  std::optional<ExactScale> scale;
  std::vector<std::size_t> node;   // of each particle
  std::vector<std::size_t> owner;  // rank
  std::vector<char> opened;        // it is given as a point, else it is in a whole

  u128 weight(std::size_t i) const { return scale ? (*scale)(set.weight[i]) : 0; }
};

// One of many kinds of coordinates, from all different to all equal.
double coordinate(Random& random, std::uint64_t kind) {
  switch (kind) {
    case 0:
      return random.uniform(-1, 1);
    case 1:
      return static_cast<double>(random.below(5)) - 2;  // a lattice
    case 2:
      return 1 + static_cast<double>(random.below(40)) * 0x1p-50;
    case 3:
      return random.below(3) == 0 ? random.uniform() : 0.25;
    case 4:
      return (random.below(2) == 0 ? 1 : -1) * std::ldexp(1 + random.uniform(), -static_cast<int>(random.below(300)));
    default:
      return random.below(2) == 0 ? 0.0 : -0.0;
  }
}

AxisMap map_of(std::span<const double> x, bool by_order_bits) {
  const auto [lo, hi] = std::ranges::minmax(x);
  AxisMap map = by_order_bits || lo == hi ? AxisMap::by_order_bits(lo, hi) : AxisMap::by_value(lo, hi);
  std::uint32_t bits = std::uint32_t{1} << 30U;
  bool lossless = map.linear();
  for (const double value : x) {
    lossless = lossless && map.value(map(value)) == value;
    bits |= static_cast<std::uint32_t>(map(value));
  }
  if (lossless) map.set_lossless(static_cast<unsigned>(std::countr_zero(bits)));
  return map;
}

SearchScene random_scene(Random& random, int ranks, std::size_t nodes, bool weighted) {
  SearchScene scene;
  scene.set.dims = static_cast<int>(1 + random.below(3));
  scene.set.has_weights = weighted;
  scene.set.resize(nodes + random.below(random.below(2) == 0 ? 40 : 1500));
  const std::size_t count = scene.set.count();
  for (std::size_t a = 0; a < at(scene.set.dims); ++a) {
    const std::uint64_t kind = random.below(6);
    for (double& x : scene.set.position[a]) x = coordinate(random, kind);
    scene.maps[a] = map_of(scene.set.position[a].span(), random.below(3) == 0);
  }
  const std::uint64_t stride = random.below(2) == 0 ? 1 : std::uint64_t{1} << 50U;
  const std::uint64_t heaviest = random.below(4);
  if (weighted) scene.scale.emplace(4.0, count);
  for (std::size_t i = 0; i < count; ++i) {
    scene.set.id[i] = static_cast<Id>((i * 7919 % count + 5) * stride);
    if (weighted) scene.set.weight[i] = random.below(2) == 0 ? 0 : static_cast<double>(random.below(heaviest + 1));
    scene.node.push_back(i < nodes ? i : random.below(nodes));  // none is empty
    scene.owner.push_back(random.below(static_cast<std::uint64_t>(ranks)));
    scene.opened.push_back(1);
  }
  return scene;
}

// A node's particles in the order of their keys, and what a full sort tells of the cut.
struct Judge {
  struct Own {
    KeyWords key;
    std::size_t particle;
    std::int32_t q;
  };
  const SearchScene& scene;
  const CutRequest& wanted;
  std::vector<Own> sorted;
  std::size_t crossing = 0;  // the wanted key (with weights: where the prefix reaches the threshold)
  std::size_t first_right = 0;
  Exact left = 0;

  Judge(const SearchScene& all, const CutRequest& request, std::size_t node) : scene(all), wanted(request) {
    for (std::size_t i = 0; i < scene.node.size(); ++i)
      if (scene.node[i] == node) sorted.push_back({key(i), i, integer(i)});
    std::ranges::sort(sorted, {}, &Own::key);
  }
  KeyWords key(std::size_t i) const {
    const particles::ParticleView view = scene.set.view();
    const cuts::Key key = cuts::key_of(view.point(i), view.id[i], wanted.axes, view.dims);
    KeyWords words{};
    for (std::size_t w = 0; w < at(view.dims); ++w) words[w] = geometry::order_bits(key.at[w]);
    words[at(view.dims)] = static_cast<std::uint64_t>(key.id);
    return words;
  }
  std::int32_t integer(std::size_t i) const {
    const auto axis = at(wanted.axes[0]);
    return scene.maps[axis](scene.set.position[axis][i]);
  }
  bool point(std::size_t k) const { return scene.opened[sorted[k].particle] != 0; }
  Exact weight(std::size_t k) const { return Exact(scene.weight(sorted[k].particle)); }
  Load load(std::int64_t lo, std::int64_t hi) const {  // of the points with these integers
    Load load;
    for (const Own& own : sorted)
      if (scene.opened[own.particle] != 0 && own.q >= lo && own.q <= hi) load += {1, scene.weight(own.particle)};
    return load;
  }
  void cut() {
    if (!scene.scale) {
      crossing = first_right = wanted.rank;
      left = wanted.rank;
      return;
    }
    // Every prefix, nearest first; the shortest of the best.
    Exact best = -1;
    Exact sum = 0;
    const Exact target = Exact(wanted.all.weight) * Exact(wanted.left_size);
    for (std::size_t k = 0; k <= sorted.size(); ++k) {
      const Exact off = abs(Exact(sum * Exact(wanted.size) - target));
      if (best < 0 || off < best) {
        best = off;
        first_right = k;
        left = sum;
      }
      if (k < sorted.size()) sum += weight(k);
      if (sum * Exact(wanted.size) < target) crossing = k + 1;
    }
  }
  Where where() const {
    if (scene.scale && wanted.all.weight == 0) return Where::within;
    const std::int32_t q = sorted[crossing].q;
    return q < wanted.within.lo ? Where::below : q > wanted.within.hi ? Where::above : Where::within;
  }
  bool relied_on_meets_whole(const CutFound& found) const {
    for (std::size_t k = 0; k < sorted.size(); ++k)
      if (!point(k) && found.relied_on.meets({sorted[k].q, sorted[k].q})) return true;
    return false;
  }
  // The interval that a cut depends on, from the points alone.
  void expect_relied_on(const CutFound& found) const {
    const auto next_point = [&](std::size_t k) {
      while (k < sorted.size() && !point(k)) ++k;
      return k < sorted.size() ? sorted[k].q : AxisMap::kTop;
    };
    if (!scene.scale) {
      EXPECT_EQ(found.relied_on.lo, sorted[crossing].q);
      EXPECT_EQ(found.relied_on.hi, sorted[crossing].q);
    } else if (wanted.all.weight == 0) {
      EXPECT_EQ(found.relied_on.lo, 0);
      EXPECT_EQ(found.relied_on.hi, next_point(0));
    } else if (first_right > crossing) {
      EXPECT_EQ(found.relied_on.lo, sorted[crossing].q);
      EXPECT_EQ(found.relied_on.hi, next_point(crossing + 1));
    } else {
      std::size_t k = crossing;
      while (k > 0 && (!point(k - 1) || weight(k - 1) == 0)) --k;
      if (k > 0)
        EXPECT_EQ(found.relied_on.lo, sorted[k - 1].q);
      else
        EXPECT_TRUE(found.relied_on.lo == 0 || (wanted.before.count == 0 && found.relied_on.lo == next_point(0)));
      EXPECT_EQ(found.relied_on.hi, sorted[crossing].q);
    }
  }
};

// This rank's points of a node, in a few segments.
struct OwnPoints {
  std::vector<QuantisedPoint> points;
  std::vector<Segment> segments;

  OwnPoints(const SearchScene& scene, std::size_t node, int rank) {
    for (std::size_t i = 0; i < scene.node.size(); ++i) {
      if (scene.node[i] != node || scene.owner[i] != at(rank) || scene.opened[i] == 0) continue;
      QuantisedPoint& point = points.emplace_back();
      for (std::size_t a = 0; a < at(scene.set.dims); ++a) point.q[a] = scene.maps[a](scene.set.position[a][i]);
      point.index = static_cast<std::uint32_t>(i);
    }
    const std::size_t pieces = 1 + points.size() % 3;
    for (std::size_t p = 0; p < pieces; ++p) {
      Segment& own = segments.emplace_back();
      own.first = points.data() + points.size() * p / pieces;
      own.last = points.data() + points.size() * (p + 1) / pieces;
      own.base = p == 0 || own.size() == 0 ? 0 : std::ranges::min(own.all(), {}, &QuantisedPoint::index).index;
      for (QuantisedPoint& point : own.all()) {
        point.index -= static_cast<std::uint32_t>(own.base);
        own.bounds.extend({point.q, point.q});
      }
    }
  }
  // The integers are those of the particles again, whatever the search has done; if all lie in one place, but for those
  // on axis 0.
  void expect_as_before(const SearchScene& scene, bool one_place, const std::vector<QuantisedPoint>& before) const {
    std::vector<std::size_t> own;
    for (const Segment& segment : segments)
      for (const QuantisedPoint& point : segment.all()) {
        own.push_back(segment.base + point.index);
        for (std::size_t a = one_place ? 1 : 0; a < at(scene.set.dims); ++a)
          EXPECT_EQ(point.q[a], scene.maps[a](scene.set.position[a][own.back()]));
      }
    EXPECT_EQ(own.size(), before.size());
    std::ranges::sort(own);
    EXPECT_EQ(std::ranges::adjacent_find(own), own.end());
  }
};

QBounds bounds_of(const SearchScene& scene, std::size_t node) {
  QBounds bounds;
  for (std::size_t i = 0; i < scene.node.size(); ++i) {
    if (scene.node[i] != node || scene.opened[i] == 0) continue;
    Integers q{};
    for (std::size_t a = 0; a < at(scene.set.dims); ++a) q[a] = scene.maps[a](scene.set.position[a][i]);
    bounds.extend({q, q});
  }
  return bounds;
}

AxisOrder random_axes(Random& random, int dims) {
  return geometry::with_first(AxisOrder{0, 1, 2}, static_cast<int>(random.below(static_cast<std::uint64_t>(dims))),
                              dims);
}

// An interval, often narrow, and with it the particles that lie in wholes.
CutRequest random_request(Random& random, SearchScene& scene, std::size_t node) {
  CutRequest wanted;
  wanted.axes = random_axes(random, scene.set.dims);
  const auto members = [&] {
    const Judge judge(scene, wanted, node);
    return judge.sorted;
  }();
  for (const auto& own : members) wanted.all += {1, scene.weight(own.particle)};
  const std::uint64_t closed = random.below(4);  // of four particles outside of `within`, so many lie in wholes
  if (random.below(4) != 0) {
    const auto any = [&] { return members[random.below(members.size())].q; };
    wanted.within = {any(), any()};
    if (wanted.within.lo > wanted.within.hi) std::swap(wanted.within.lo, wanted.within.hi);
    if (random.below(4) == 0 && wanted.within.lo < AxisMap::kTop) wanted.within.hi = ++wanted.within.lo;
  }
  for (const auto& own : members) {
    if (wanted.within.meets({own.q, own.q}) || random.below(4) >= closed) continue;
    scene.opened[own.particle] = 0;
    if (own.q < wanted.within.lo) wanted.before += {1, scene.weight(own.particle)};
  }
  wanted.rank = random.below(wanted.all.count);
  wanted.size = 1 + random.below(9);
  wanted.left_size = 1 + random.below(static_cast<std::uint64_t>(wanted.size));
  return wanted;
}

void expect_cut(const Judge& judge, const CutFound& found, const OwnPoints& own) {
  const bool weighted = judge.scene.scale.has_value();
  const Interval within = judge.wanted.within;
  EXPECT_EQ(found.where, judge.where());
  if (found.where != judge.where()) return;
  if (found.where != Where::within) {
    const Load below = judge.load(0, std::int64_t{within.lo} - 1);
    const Load inside = judge.load(within.lo, within.hi);
    if (weighted) {
      EXPECT_TRUE(found.points_below.weight == below.weight && found.points_within.weight == inside.weight);
    } else {
      EXPECT_EQ(found.points_below.count, below.count);
      EXPECT_EQ(found.points_within.count, inside.count);
    }
    return;
  }
  judge.expect_relied_on(found);
  if (!judge.relied_on_meets_whole(found)) {
    EXPECT_EQ(found.right_empty, judge.first_right == judge.sorted.size());
    if (!found.right_empty) {
      EXPECT_EQ(found.key, judge.sorted[judge.first_right].key);
    }
    EXPECT_EQ(weighted ? Exact(found.left.weight) : Exact(found.left.count), judge.left);
  }
  for (const Segment& segment : own.segments) {
    EXPECT_EQ(segment.middle, segment.upper);
    for (const QuantisedPoint& point : segment.all()) {
      const KeyWords key = judge.key(segment.base + point.index);
      EXPECT_EQ(&point < segment.middle, found.right_empty || key < found.key);
    }
  }
}

void try_random(comm::Comm& comm, std::uint64_t seed, bool weighted) {
  SCOPED_TRACE(::testing::Message() << "seed " << seed << (weighted ? ", weights, " : ", ") << comm.size() << " ranks");
  Random random(seed);
  const std::size_t nodes = 1 + random.below(4);
  SearchScene scene = random_scene(random, comm.size(), nodes, weighted);
  Tuning tuning;
  if (random.below(3) != 0) {
    tuning.bins_max = std::uint64_t{2} << random.below(8);
    tuning.gather_max = 1 + random.below(8);
  }
  std::vector<CutRequest> wanted;
  for (std::size_t n = 0; n < nodes; ++n) wanted.push_back(random_request(random, scene, n));
  std::vector<OwnPoints> own;
  for (std::size_t n = 0; n < nodes; ++n) own.emplace_back(scene, n, comm.rank());
  for (std::size_t n = 0; n < nodes; ++n) {
    wanted[n].points = {own[n].segments, Judge(scene, wanted[n], n).load(0, AxisMap::kTop), bounds_of(scene, n)};
    const QBounds& bounds = wanted[n].points.bounds;
    bool one_place = wanted[n].within.lo == 0 && wanted[n].within.hi == AxisMap::kTop;
    for (std::size_t a = 0; a < at(scene.set.dims); ++a)
      one_place = one_place && bounds.lo[a] == bounds.hi[a] && scene.maps[a].lossless();
    wanted[n].points.one_place = one_place;
  }
  std::vector<std::vector<QuantisedPoint>> before;
  for (const OwnPoints& points : own) before.push_back(points.points);
  const particles::ParticleView view = scene.set.view();
  SearchCost cost;
  CutSearch search({comm, view, scene.maps, scene.scale, tuning, cost});
  const std::vector<CutFound> found = search.find(wanted);
  for (std::size_t n = 0; n < nodes; ++n) {
    SCOPED_TRACE(::testing::Message() << "node " << n);
    own[n].expect_as_before(scene, wanted[n].points.one_place, before[n]);
    Judge judge(scene, wanted[n], n);
    judge.cut();
    expect_cut(judge, found[n], own[n]);
  }
}

// Halves a node in one place until each part has one particle, as a tree would: ids are kept in the integers.
TEST(CutSearch, IdsAreKeptWhereAllLieInOnePlace) {
  testing::on_ranks([](comm::Comm& comm) {
    constexpr std::size_t kCount = 500;
    Random random(kCutSeed);
    SearchScene scene;
    scene.set.dims = 2;
    scene.set.resize(kCount);
    for (std::size_t a = 0; a < 2; ++a) {
      std::ranges::fill(scene.set.position[a], 0.5);
      scene.maps[a] = AxisMap::by_value(-1, 1);
    }
    for (std::size_t i = 0; i < kCount; ++i) scene.set.id[i] = static_cast<Id>(1000 + i * 7 % kCount * 3);
    for (std::size_t i = 0; i < kCount; ++i) scene.owner.push_back(random.below(at(comm.size())));
    scene.node.assign(kCount, 0);
    scene.opened.assign(kCount, 1);
    OwnPoints own(scene, 0, comm.rank());
    Tuning tuning;
    tuning.gather_max = 1;
    tuning.bins_max = 16;
    SearchCost cost;
    const particles::ParticleView view = scene.set.view();
    CutSearch search({comm, view, scene.maps, scene.scale, tuning, cost});
    CutRequest wanted{.points = {own.segments, {kCount, 0}, bounds_of(scene, 0)}, .axes = {1, 0, 2}};
    wanted.points.one_place = true;
    std::uint64_t first = 0;
    for (std::uint64_t count = kCount; count > 1; count -= wanted.rank) {  // the right half
      wanted.rank = count / 2;
      wanted.points.load.count = count;
      const CutFound found = search.find({&wanted, 1})[0];
      first += wanted.rank;
      EXPECT_EQ(found.key[2], 1000 + 3 * first);
      EXPECT_EQ(found.left.count, wanted.rank);
      EXPECT_TRUE(found.by_id);
      wanted.points.by_id = true;
      wanted.points.bounds.lo[0] = static_cast<std::int32_t>(3 * first);
      wanted.points.bounds.hi[0] = static_cast<std::int32_t>(3 * (kCount - 1));
      for (Segment& segment : own.segments) {
        for (const QuantisedPoint& point : segment.all()) {
          const Id id = view.id[segment.base + point.index];
          EXPECT_EQ(&point < segment.middle, static_cast<std::uint64_t>(id) < found.key[2]);
          EXPECT_EQ(point.q[0], id - 1000);
          EXPECT_EQ(point.q[1], scene.maps[1](0.5));
        }
        segment.first = segment.middle;
      }
    }
  });
}

// With slack a cut may lie between two bins: it misses its target by no more than that.
TEST(CutSearch, SlackIsNotExceeded) {
  testing::on_ranks([](comm::Comm& comm) {
    for (std::uint64_t seed = kCutSeed; seed < kCutSeed + 100; ++seed) {
      SCOPED_TRACE("seed " + std::to_string(seed));
      Random random(seed);
      SearchScene scene = random_scene(random, comm.size(), 1, false);
      OwnPoints own(scene, 0, comm.rank());
      const std::uint64_t count = scene.node.size();
      CutRequest wanted{.points = {own.segments, {count, 0}, bounds_of(scene, 0)}};
      wanted.rank = random.below(count);
      wanted.slack = 1 + random.below(1 + count / 10);
      const Tuning tuning{.gather_max = 2, .bins_max = std::uint64_t{2} << random.below(8)};
      SearchCost cost;
      const particles::ParticleView view = scene.set.view();
      const CutFound found = CutSearch({comm, view, scene.maps, scene.scale, tuning, cost}).find({&wanted, 1})[0];
      const Judge judge(scene, wanted, 0);
      const auto left = std::ranges::count_if(judge.sorted, [&](const auto& one) { return one.key < found.key; });
      EXPECT_EQ(found.left.count, static_cast<std::uint64_t>(left));
      EXPECT_LE(std::abs(left - static_cast<std::int64_t>(wanted.rank)), static_cast<std::int64_t>(wanted.slack));
      for (const Segment& segment : own.segments)
        for (const QuantisedPoint& point : segment.all())
          EXPECT_EQ(&point < segment.middle, judge.key(segment.base + point.index) < found.key);
    }
  });
}

TEST(CutSearch, FindsWhatAFullSortFinds) {
  testing::on_ranks([](comm::Comm& comm) {
    for (std::uint64_t seed = kCutSeed; seed < kCutSeed + 300; ++seed) try_random(comm, seed, false);
  });
}

TEST(CutSearch, FindsWhatAFullSortFindsWithWeights) {
  testing::on_ranks([](comm::Comm& comm) {
    for (std::uint64_t seed = kCutSeed; seed < kCutSeed + 300; ++seed) try_random(comm, seed, true);
  });
}

}  // namespace
}  // namespace rcb::partition
