// Owners, halos, neighbours and boxes against a judge that looks at every position, part and image by the definitions.
#include "common/cuts/cuts.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <tuple>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/partition/partition.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::cuts {
namespace {

using geometry::Box;
using testing::make_scene;
using testing::Scene;
using testing::Shape;
using testing::Weights;

constexpr double kInfinite = std::numeric_limits<double>::infinity();

// (target, row, shift)
using Entries = std::set<std::tuple<std::int64_t, std::uint64_t, Shift>>;

struct Probes {
  int dims = 3;
  std::vector<Point> x;
  std::vector<Id> id;
  std::vector<double> rows;  // [count][dims]

  void add(const Point& point, Id number) {
    x.push_back(point);
    id.push_back(number);
  }
  void make_rows() {
    rows.clear();
    for (const Point& point : x) rows.insert(rows.end(), point.begin(), point.begin() + dims);
  }
  // As if they had been given as floats.
  std::vector<float> round_to_floats() {
    std::vector<float> floats;
    for (Point& point : x)
      for (std::size_t a = 0; a < at(dims); ++a) {
        floats.push_back(static_cast<float>(point[a]));
        point[a] = static_cast<double>(floats.back());
      }
    return floats;
  }
};

struct Judge {
  const CutTree& tree;
  std::vector<Box> region;
  Near near;
  int farthest;  // the images it looks at, to both sides

  // Walks down by the rule: right if the key isn't less than the cut's.
  int owner(const Point& x, Id id) const {
    NodeRange range = tree.root();
    while (!range.leaf()) {
      const Cut& cut = tree.cuts[at(range.node)];
      bool right = !cut.right_empty;
      bool decided = cut.right_empty;
      for (std::size_t i = 0; i < at(tree.dims) && !decided; ++i) {
        const double own = x[at(cut.axes[i])];
        decided = own != cut.key.at[i];
        right = decided ? own > cut.key.at[i] : right;
      }
      if (!decided) right = id >= cut.key.id;
      range = right ? range.right() : range.left();
    }
    return range.first;
  }

  bool is_near(const Box& box, const Point& y, double width) const {
    double most = 0;
    double squares = 0;
    for (std::size_t a = 0; a < at(tree.dims); ++a) {
      double lo = box.lo[a];
      double hi = box.hi[a];
      if (near.box.periodic(a) && lo == -kInfinite) lo = near.box.lo[a];
      if (near.box.periodic(a) && hi == kInfinite) hi = near.box.hi[a];
      const double gap = std::max(std::max(lo - y[a], y[a] - hi), 0.0);
      most = std::max(most, gap);
      squares += gap * gap;
    }
    return near.norm == Norm::max ? most <= width : squares <= width * width;
  }

  template <typename Visit>
  void for_each_image(const Point& x, const Visit& visit) const {
    std::array<int, 3> reach{};
    for (std::size_t a = 0; a < at(tree.dims); ++a) reach[a] = near.box.periodic(a) ? farthest : 0;
    for (int i = -reach[0]; i <= reach[0]; ++i)
      for (int j = -reach[1]; j <= reach[1]; ++j)
        for (int k = -reach[2]; k <= reach[2]; ++k) {
          const Shift shift{i, j, k};
          Point y = x;
          for (std::size_t a = 0; a < at(tree.dims); ++a)
            if (near.box.periodic(a)) {
              const double moved = shift[a] * (near.box.hi[a] - near.box.lo[a]);
              y[a] = x[a] + moved;
            }
          visit(shift, y);
        }
  }

  void halos_of(const Point& x, Id id, double width, std::uint64_t row, int seats, Entries& out) const {
    const auto target_of = [&](int part) {
      int seat = 0;
      while (seats > 0 && (static_cast<std::int64_t>(seat) + 1) * tree.parts / seats <= part) ++seat;
      return seats == 0 ? part : seat;
    };
    const int own = target_of(owner(x, id));
    for_each_image(x, [&](const Shift& shift, const Point& y) {
      for (int q = 0; q < tree.parts; ++q)
        if (!region[at(q)].empty(tree.dims) && is_near(region[at(q)], y, width) &&
            (target_of(q) != own || shift != Shift{}))
          out.emplace(target_of(q), row, shift);
    });
  }
};

Entries entries_of(const Halo& halo) {
  Entries out;
  for (std::size_t t = 0; t < halo.targets(); ++t)
    for (std::size_t e = halo.offset[t]; e < halo.offset[t + 1]; ++e)
      out.emplace(static_cast<std::int64_t>(t), halo.row[e], halo.shift_of(e));
  return out;
}

// That lists are in order, which also shows that no entry stands twice.
bool ordered(const Halo& halo) {
  for (std::size_t t = 0; t < halo.targets(); ++t)
    for (std::size_t e = halo.offset[t] + 1; e < halo.offset[t + 1]; ++e)
      if (std::pair(halo.row[e - 1], halo.shift_of(e - 1)) >= std::pair(halo.row[e], halo.shift_of(e))) return false;
  return true;
}

class Trial {
 public:
  explicit Trial(std::uint64_t seed) : random_(seed) {
    const int dims = 1 + static_cast<int>(random_.below(3));
    shape_ = static_cast<Shape>(random_.below(testing::kShapes));
    scene_ = make_scene(shape_, Weights::none, dims, random_.below(90), random_.below(2) == 0, seed);
    partition::PartitionOptions options;
    options.parts = 1 + static_cast<int>(random_.below(random_.below(2) == 0 ? 6 : 24));
    if (random_.below(4) == 0) options.method = Method::bands_x;
    testing::SelfComm comm;
    std::vector<std::size_t> all(scene_.count());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
    const testing::Share share = testing::take(scene_, all);
    tree_ = partition::partition(comm, share.particles.view(), options).value().tree;
    make_probes();
    make_near();
  }

  void run() {
    const Cuts cuts(tree_, 7);
    const bool floats = shape_ != Shape::huge && random_.below(4) == 0;
    const std::vector<float> rows_f4 = floats ? probes_.round_to_floats() : std::vector<float>();
    probes_.make_rows();
    const std::size_t count = probes_.x.size();
    const Positions positions = floats ? Positions::rows(rows_f4.data(), count, tree_.dims)
                                       : Positions::rows(probes_.rows.data(), count, tree_.dims);
    const Judge judge{tree_, tree_.regions(0, tree_.parts), near_, tree_.dims == 3 ? 4 : 7};
    HaloOptions options;
    options.near = near_;
    if (random_.below(2) == 0) options.ids = probes_.id;
    options.threads = 1 + static_cast<int>(random_.below(3));
    const auto id = [&](std::size_t i) { return options.ids.empty() ? static_cast<Id>(i) : probes_.id[i]; };

    std::vector<std::int32_t> part(count), expected(count), hint(count);
    for (std::size_t i = 0; i < count; ++i) {
      expected[i] = judge.owner(probes_.x[i], id(i));
      hint[i] = random_.below(3) == 0 ? static_cast<std::int32_t>(random_.below(64)) - 9 : expected[i];
    }
    ASSERT_TRUE(cuts.owner(positions, options, part).ok());
    EXPECT_EQ(part, expected);
    for (std::int32_t& p : hint)
      if (random_.below(2) == 0) p = std::clamp(p, 0, tree_.parts - 1);
    if (random_.below(2) == 0) options.last_part = hint;
    ASSERT_TRUE(cuts.owner(positions, options, part).ok());
    EXPECT_EQ(part, expected);

    std::vector<double> widths;
    if (random_.below(3) == 0) {
      for (std::size_t i = 0; i < count; ++i)
        widths.push_back(random_.below(5) == 0
                             ? 0.0
                             : near_.width * std::ldexp(random_.uniform(), -static_cast<int>(random_.below(30))));
      options.widths = widths;
    }
    options.seats = static_cast<int>(random_.below(2) == 0 ? 0 : 1 + random_.below(at(tree_.parts) + 2));
    const auto halo = cuts.halo(positions, options);
    ASSERT_TRUE(halo.ok()) << halo.status().message();
    Entries wanted;
    for (std::size_t i = 0; i < count; ++i)
      judge.halos_of(probes_.x[i], id(i), widths.empty() ? near_.width : widths[i], i, options.seats, wanted);
    EXPECT_EQ(entries_of(*halo), wanted);
    EXPECT_TRUE(ordered(*halo));
    cases += count * at(tree_.parts);
    if (options.seats == 0 && widths.empty()) check_neighbours(cuts, expected, wanted);
  }

  std::uint64_t cases = 0;

 private:
  void make_probes() {
    probes_.dims = tree_.dims;
    const auto add = [this](Point x) {
      for (std::size_t a = at(tree_.dims); a < 3; ++a) x[a] = 0;
      for (const double value : x)
        if (!std::isfinite(value)) return;
      probes_.add(x,
                  static_cast<Id>(random_.below(3) == 0 ? random_.below(100) : random_.below(std::uint64_t{1} << 62U)));
    };
    Box bounds;
    for (std::size_t i = 0; i < scene_.count(); ++i) {
      Point x{};
      for (std::size_t a = 0; a < at(tree_.dims); ++a) x[a] = scene_.x[a][i];
      bounds.extend(x, tree_.dims);
      add(x);
      probes_.id.back() = scene_.id[i];
    }
    if (bounds.empty(tree_.dims)) bounds = {{-1, -1, -1}, {1, 1, 1}};
    bounds_ = bounds;
    for (int i = 0; i < 40; ++i) {
      Point x{};
      for (std::size_t a = 0; a < at(tree_.dims); ++a)
        x[a] = bounds.lo[a] + (bounds.hi[a] - bounds.lo[a]) * random_.uniform();
      add(x);
      if (tree_.cuts.empty()) continue;
      const Cut& cut = tree_.cuts[random_.below(tree_.cuts.size())];
      if (cut.right_empty) continue;
      const auto axis = at(cut.axes[0]);
      const double value = cut.key.at[0];
      x[axis] = value == 0 && random_.below(2) == 0 ? -0.0 : value;
      add(x);
      x[axis] = std::nextafter(value, random_.below(2) == 0 ? kInfinite : -kInfinite);
      add(x);
      for (std::size_t k = 0; k < at(tree_.dims); ++k) x[at(cut.axes[k])] = cut.key.at[k];
      add(x);
      if (!probes_.id.empty()) probes_.id.back() = cut.key.id - static_cast<Id>(cut.key.id > 0 ? random_.below(2) : 0);
    }
  }

  // A width and a box such that the judge's images are enough: positions lie at most a period outside.
  void make_near() {
    double longest = 0;
    double shortest_period = kInfinite;
    for (std::size_t a = 0; a < at(tree_.dims); ++a) {
      const double length = bounds_.hi[a] - bounds_.lo[a];
      if (!std::isfinite(length)) continue;
      longest = std::max(longest, length);
      if (random_.below(2) == 0 || !(length > std::abs(bounds_.lo[a]) * 1e-9) || length < 1e-300) continue;
      const double shrink = random_.below(3) == 0 ? 0.1 * length : 0.0;
      near_.box.lo[a] = bounds_.lo[a] + shrink;
      near_.box.hi[a] = random_.below(2) == 0 ? bounds_.hi[a] : bounds_.hi[a] + 0.3 * length;
      shortest_period = std::min(shortest_period, near_.box.length(a));
    }
    near_.norm = random_.below(2) == 0 ? Norm::max : Norm::euclid;
    const double most = std::min({tree_.dims == 3 ? 1.6 * shortest_period : 3 * shortest_period, longest, 1e150});
    const std::array<double, 6> fractions{0, 1e-16, 0.01, 0.1, 0.5, 1};
    near_.width = most * fractions[random_.below(fractions.size())];
  }

  void check_neighbours(const Cuts& cuts, const std::vector<std::int32_t>& owner, const Entries& entries) {
    for (int p = 0; p < tree_.parts; ++p) {
      const auto found = cuts.neighbours(p, near_);
      ASSERT_TRUE(found.ok()) << found.status().message();
      for (const auto& [target, row, shift] : entries) {
        bool inside = owner[row] == p;
        for (std::size_t a = 0; a < at(tree_.dims); ++a)
          inside = inside && (!near_.box.periodic(a) ||
                              (probes_.x[row][a] >= near_.box.lo[a] && probes_.x[row][a] <= near_.box.hi[a]));
        const Neighbour neighbour{static_cast<std::int32_t>(target), shift};
        EXPECT_TRUE(!inside || std::find(found->begin(), found->end(), neighbour) != found->end());
      }
    }
  }

  Random random_;
  Shape shape_ = Shape::uniform;
  Scene scene_;
  Box bounds_;
  CutTree tree_;
  Probes probes_;
  Near near_;
};

TEST(Cuts, OwnersAndHalosAreThoseOfTheDefinition) {
  constexpr std::uint64_t kSeed = 20260;
  std::uint64_t cases = 0;
  for (std::uint64_t k = 0; k < 1500 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", kSeed + k));
    Trial trial(kSeed + k);
    trial.run();
    cases += trial.cases;
  }
  RecordProperty("cases", static_cast<int>(cases));
}

// A cut at x = 0 between two particles.
CutTree halves() {
  CutTree tree;
  tree.dims = 1;
  tree.parts = 2;
  tree.cuts.resize(1);
  return tree;
}

TEST(Cuts, TheWidestWidthReachesEverything) {
  const double most = std::numeric_limits<double>::max();
  const std::vector<double> x{-3, 5, -most / 2};
  const Cuts cuts(halves(), 1);
  HaloOptions options;
  options.near.width = most;
  const auto halo = cuts.halo(Positions::rows(x.data(), x.size(), 1), options);
  ASSERT_TRUE(halo.ok()) << halo.status().message();
  EXPECT_EQ(entries_of(*halo), (Entries{{1, 0, {}}, {0, 1, {}}, {1, 2, {}}}));
  const std::vector<double> widths{most, most, most};
  options.near.width = 0;
  options.widths = widths;
  EXPECT_EQ(entries_of(cuts.halo(Positions::rows(x.data(), x.size(), 1), options).value()), entries_of(*halo));
}

TEST(Cuts, EntriesMaxIsExact) {
  std::vector<double> x(5000, 1.0);
  x.resize(5003, 0.25);
  const Cuts cuts(halves(), 1);
  HaloOptions options;
  options.near.width = 0.5;
  options.entries_max = 3;
  const auto positions = Positions::rows(x.data(), x.size(), 1);
  EXPECT_EQ(cuts.halo(positions, options).value().entries(), 3);
  options.entries_max = 2;
  EXPECT_EQ(cuts.halo(positions, options).status().code(), Code::too_large);
}

TEST(Cuts, NothingHasNoHalo) {
  const Cuts cuts(halves(), 1);
  HaloOptions options;
  options.seats = 5;
  const auto halo = cuts.halo(Positions::rows(static_cast<const double*>(nullptr), 0, 1), options);
  ASSERT_TRUE(halo.ok()) << halo.status().message();
  EXPECT_EQ(halo->targets(), 5);
  EXPECT_EQ(halo->entries(), 0);
}

TEST(Cuts, WrongCallsAreRefused) {
  const Cuts cuts(halves(), 1);
  const std::vector<double> x{1, std::numeric_limits<double>::quiet_NaN()};
  const auto code = [&](const Positions& positions, const HaloOptions& options) {
    return cuts.halo(positions, options).status().code();
  };
  const auto one = Positions::rows(x.data(), 1, 1);
  const std::vector<double> widths{-1};
  const std::vector<Id> ids{1, 2};
  EXPECT_EQ(code(Positions::rows(x.data(), 2, 1), {}), Code::not_finite);
  EXPECT_EQ(code(Positions::rows(x.data(), 1, 2), {}), Code::invalid_argument);
  HaloOptions wrong;
  wrong.near.width = -1;
  EXPECT_EQ(code(one, wrong), Code::invalid_argument);
  wrong = {};
  wrong.widths = widths;
  EXPECT_EQ(code(one, wrong), Code::invalid_argument);
  wrong = {};
  wrong.ids = ids;
  EXPECT_EQ(code(one, wrong), Code::invalid_argument);
  wrong = {};
  wrong.near.box = PeriodicBox({1, 0, 0}, {1, 0, 0});
  EXPECT_EQ(code(one, wrong), Code::invalid_argument);
  wrong.near.box = PeriodicBox({0, 0, 0}, {1e-9, 0, 0});
  wrong.near.width = 1;
  EXPECT_EQ(code(one, wrong), Code::invalid_argument);  // more images than anybody wants
}

}  // namespace
}  // namespace rcb::cuts
