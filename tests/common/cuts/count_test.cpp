// Counts against a judge that looks at one particle after another, and against the sums of the service's ranks.
#include "common/cuts/count.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/exact_scale.hpp"
#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/partition.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::cuts {
namespace {

using testing::Shape;
using testing::Weights;

// A scene, its cuts, and the parts that its particles had before.
class CountTrial {
 public:
  explicit CountTrial(std::uint64_t seed) : random_(seed) {
    const int dims = 1 + static_cast<int>(random_.below(3));
    const std::array<std::uint64_t, 4> sizes{30, 700, 3000, 60000};
    const std::size_t n = random_.below(sizes[random_.below(random_.below(8) == 0 ? 4 : 3)]);
    shape_ = static_cast<Shape>(random_.below(testing::kShapes));
    const auto weights = static_cast<Weights>(random_.below(testing::kWeights));
    testing::Scene scene = testing::make_scene(shape_, weights, dims, n, random_.below(2) == 0, seed);
    if (weights == Weights::zeros && n > 0) scene.weight[random_.below(n)] = -0.0;
    // With bits in every place of the scale, and below it; or hardly above 0.
    const int binades = random_.below(3) != 0 ? 50 : -1020;
    const std::uint64_t range = std::array{20U, 54U, 57U, 66U, 190U}[random_.below(5)];
    for (std::size_t i = 0; !scene.weight.empty() && i < n && seed % 2 == 0; ++i)
      scene.weight[i] = std::ldexp(random_.uniform(), binades - static_cast<int>(random_.below(range)));
    partition::PartitionOptions options;
    options.parts = 1 + static_cast<int>(random_.below(random_.below(2) == 0 ? 6 : 40));
    if (random_.below(4) == 0) options.method = Method::bands_x;
    std::vector<std::size_t> rows(n);
    std::iota(rows.begin(), rows.end(), std::size_t{0});
    const testing::Share all = testing::take(scene, rows);
    tree_ = partition::partition(comm_, all.particles.view(), options).value().tree;
    before_.resize(n);
    for (std::size_t i = 0; i < n; ++i) before_[i] = tree_.part_of(point_of(scene, i), scene.id[i]);
    if (random_.below(3) != 0)  // as a solver that was told the parts holds them
      std::sort(rows.begin(), rows.end(), [&](std::size_t a, std::size_t b) { return before_[a] < before_[b]; });
    share_ = testing::take(scene, rows);
    std::vector<std::int32_t> in_order(n);
    for (std::size_t i = 0; i < n; ++i) in_order[i] = before_[rows[i]];
    before_ = in_order;
    move_some();
  }

  void run() {
    const std::vector<double> xyz = rows_of<double>();
    const std::vector<float> xyz_f4 =
        shape_ != Shape::huge && random_.below(4) == 0 ? rows_of<float>() : std::vector<float>();
    if (!xyz_f4.empty())  // what the others are, too
      for (std::size_t i = 0; i < n(); ++i)
        for (std::size_t a = 0; a < dims(); ++a)
          share_.particles.position[a][i] = static_cast<double>(xyz_f4[i * dims() + a]);
    const particles::ParticleView view = share_.particles.view();
    const std::span<const double* const> axes(view.position.data(), dims());
    const Positions positions = !xyz_f4.empty()         ? Positions::rows(xyz_f4.data(), n(), tree_.dims)
                                : random_.below(2) == 0 ? Positions::rows(xyz.data(), n(), tree_.dims)
                                                        : Positions::axes(axes, n());
    CountOptions options;
    if (random_.below(2) == 0) options.ids = share_.particles.id.span();
    if (random_.below(2) == 0) options.id_key = random_.below(2) * random_.next();
    if (share_.particles.has_weights) options.weights = share_.particles.weight.span();
    options.threads = 1 + static_cast<int>(random_.below(3));
    judge(options);
    options.scale = scale_;
    const Cuts cuts(tree_, 3);
    const std::uint64_t hint = random_.below(4);  // none, parts of other cuts, this array, another array
    if (random_.below(3) == 0) mix_hints();
    if (hint == 1)
      for (std::int32_t& part : before_) part = static_cast<std::int32_t>(random_.below(100)) - 50;
    std::vector<std::int32_t> part = hint == 2 ? before_ : std::vector<std::int32_t>(n(), -7);
    if (hint > 0) options.last_part = hint == 2 ? std::span<const std::int32_t>(part) : before_;
    const auto found = count(cuts, positions, options, part);
    ASSERT_TRUE(found.ok()) << found.status().message();
    EXPECT_EQ(part, part_);
    EXPECT_EQ(found->n, n());
    EXPECT_EQ(found->counts, expected_.counts);
    EXPECT_EQ(found->loads, expected_.loads);
    EXPECT_EQ(found->least, expected_.least);
    EXPECT_EQ(found->greatest, expected_.greatest);
    EXPECT_EQ(found->weights_as_zero, expected_.weights_as_zero);
    EXPECT_EQ(found->id_sum, options.id_key && !options.ids.empty() ? expected_.id_sum : 0);
    std::uint64_t drifted = 0;
    for (std::size_t i = 0; i < n() && hint > 0; ++i) drifted += before_[i] != part_[i] ? 1U : 0U;
    EXPECT_EQ(found->drifted, drifted);
    compare_with_the_service();
    if (n() > 0) refuse_a_fault(cuts, positions, options, part);
  }

 private:
  std::size_t n() const { return share_.particles.count(); }
  std::size_t dims() const { return at(tree_.dims); }
  static Point point_of(const testing::Scene& scene, std::size_t i) {
    Point x{};
    for (std::size_t a = 0; a < at(scene.dims); ++a) x[a] = scene.x[a][i];
    return x;
  }

  // Some particles go to others' places, or onto a cut.
  void move_some() {
    const std::size_t moves = n() == 0 ? 0 : random_.below(2) * random_.below(1 + n() / 10);
    for (std::size_t k = 0; k < moves; ++k) {
      const std::size_t to = random_.below(n());
      for (std::size_t a = 0; a < dims(); ++a)
        share_.particles.position[a][random_.below(n())] = share_.particles.position[a][to];
      if (tree_.cuts.empty()) continue;
      const Cut& cut = tree_.cuts[random_.below(tree_.cuts.size())];
      const std::size_t moved = random_.below(n());
      for (std::size_t a = 0; a < dims() && !cut.right_empty; ++a)
        share_.particles.position[at(cut.axes[a])][moved] = cut.key.at[a];
    }
  }

  // As where rows come in another order from some row on.
  void mix_hints() {
    const std::size_t same = random_.below(n() + 1);
    for (std::size_t i = same; i < n(); ++i) std::swap(before_[i], before_[same + random_.below(n() - same)]);
    if (random_.below(2) == 0) std::reverse(before_.begin(), before_.end());
  }

  template <typename T>
  std::vector<T> rows_of() const {
    std::vector<T> rows;
    for (std::size_t i = 0; i < n(); ++i)
      for (std::size_t a = 0; a < dims(); ++a) rows.push_back(static_cast<T>(share_.particles.position[a][i]));
    return rows;
  }

  void judge(const CountOptions& options) {
    const particles::ParticleView view = share_.particles.view();
    expected_.counts.assign(at(tree_.parts), 0);
    if (!options.weights.empty()) {
      expected_.loads.assign(at(tree_.parts), 0);
      expected_.least = *std::min_element(options.weights.begin(), options.weights.end());
      expected_.greatest = *std::max_element(options.weights.begin(), options.weights.end());
    }
    const ExactScale scale = expected_.greatest > 0 ? ExactScale(expected_.greatest, n()) : ExactScale(0);
    scale_ = scale.exponent();
    for (std::size_t i = 0; i < n(); ++i) {
      const Id id = options.ids.empty() ? static_cast<Id>(i) : view.id[i];
      part_.push_back(tree_.part_of(view.point(i), id));
      ++expected_.counts[at(part_[i])];
      expected_.id_sum += mix64(static_cast<std::uint64_t>(view.id[i]) + options.id_key.value_or(0));
      if (options.weights.empty()) continue;
      const u128 load = scale(options.weights[i]);
      expected_.loads[at(part_[i])] += load;
      expected_.weights_as_zero += load == 0 && options.weights[i] > 0 ? 1U : 0U;
    }
  }

  void compare_with_the_service() {
    const auto loads = partition::summarise_loads(comm_, share_.particles.view(), part_, {}, tree_.parts);
    EXPECT_EQ(loads.counts, expected_.counts);
    if (!loads.weighted) return;
    EXPECT_EQ(loads.scale_exponent, scale_);
    EXPECT_EQ(loads.loads, expected_.loads);
    EXPECT_EQ(loads.weights_as_zero, expected_.weights_as_zero);
  }

  // Wherever wrong values are, the first one is named.
  void refuse_a_fault(const Cuts& cuts, const Positions& positions, CountOptions options,
                      std::span<std::int32_t> part) {
    const double infinite = std::numeric_limits<double>::infinity();
    const std::array<double, 4> wrong{std::numeric_limits<double>::quiet_NaN(), infinite, -infinite, -1.5};
    std::vector<double> xyz = rows_of<double>();
    std::vector<double> weights(options.weights.begin(), options.weights.end());
    std::vector<Id> ids(share_.particles.id.span().begin(), share_.particles.id.span().end());
    std::size_t first = n();
    std::string what;
    for (std::size_t k = 1 + random_.below(3); k > 0; --k) {
      const std::size_t i = random_.below(n());
      if (i >= first) continue;
      first = i;
      const std::uint64_t kind = random_.below(3);
      if (kind == 1 && !weights.empty()) {
        weights[i] = wrong[random_.below(4)];
        what = fmt::format("weight is {}", weights[i]);
      } else if (kind == 2 && !options.ids.empty() && options.id_key) {
        ids[i] = -static_cast<Id>(1 + random_.below(9));
        what = fmt::format("id is {}", ids[i]);
      } else {
        const std::size_t a = random_.below(dims());
        xyz[i * dims() + a] = wrong[random_.below(3)];
        what = fmt::format("{} is {}", "xyz"[a], xyz[i * dims() + a]);
      }
    }
    options.weights = weights;
    if (!options.ids.empty()) options.ids = ids;
    const auto found = count(cuts, Positions::rows(xyz.data(), positions.count, positions.dims), options, part);
    ASSERT_FALSE(found.ok()) << what;
    EXPECT_EQ(found.status().message(), options.ids.empty()
                                            ? fmt::format("particle {} (index, from 0): {}", first, what)
                                            : fmt::format("particle {}: {}", ids[first], what));
    const bool finite = what.find("nan") == std::string::npos && what.find("inf") == std::string::npos;
    EXPECT_EQ(found.status().code(), finite ? Code::invalid_argument : Code::not_finite);
  }

  Random random_;
  Shape shape_;
  testing::SelfComm comm_;
  CutTree tree_;
  testing::Share share_;
  std::vector<std::int32_t> before_;  // by row
  std::vector<std::int32_t> part_;    // what the judge says
  Count expected_;
  int scale_ = 0;
};

TEST(Count, IsWhatTheDefinitionSays) {
  constexpr std::uint64_t kSeed = 31400;
  for (std::uint64_t k = 0; k < 1200 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", kSeed + k));
    CountTrial(kSeed + k).run();
  }
}

TEST(Count, AWeightBeyondTheScaleIsTold) {
  const std::vector<double> x{1, 2, 3, 4, 5};
  const std::vector<double> weights{1, 1e300, 2, 2, 2};
  std::vector<std::int32_t> part(5);
  CutTree tree;
  tree.dims = 1;
  CountOptions options;
  options.weights = weights;
  options.scale = ExactScale(2, 5).exponent();
  const auto found = count(Cuts(tree, 1), Positions::rows(x.data(), 5, 1), options, part);
  ASSERT_TRUE(found.ok());
  EXPECT_EQ(found->greatest, 1e300);
  EXPECT_NE(ExactScale(found->greatest, 5).exponent(), options.scale);
}

TEST(Count, WrongCallsAreRefused) {
  const std::vector<double> x{1, 2};
  std::vector<std::int32_t> part(2);
  CutTree tree;
  tree.dims = 1;
  const Cuts cuts(tree, 1);
  const auto code = [&](const Positions& positions, const CountOptions& options) {
    return count(cuts, positions, options, part).status().code();
  };
  CountOptions options;
  options.weights = std::span(x).first(1);
  EXPECT_EQ(code(Positions::rows(x.data(), 2, 1), options), Code::invalid_argument);
  EXPECT_EQ(code(Positions::rows(x.data(), 1, 2), {}), Code::invalid_argument);
  EXPECT_EQ(code(Positions::rows(x.data(), 1, 1), {}), Code::invalid_argument);
  EXPECT_EQ(code(Positions::rows(x.data(), 2, 1), {}), Code::ok);
}

}  // namespace
}  // namespace rcb::cuts
