// A scene whose solver counts has the history of one that sends every step, over a real service: whatever the values,
// their form, the options, and the way that positions take where they must.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "client/launch/launch.hpp"
#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "common/wire/message.hpp"
#include "tests/client/launch/rows.hpp"

namespace rcb::client {
namespace {

constexpr std::uint64_t kCountSeed = 4242;
constexpr int kSteps = 25;

// Particles that wander, slower or faster, in the arrays of a solver.
struct Wanderers {
  Random& random;
  std::size_t n;
  int dims;
  bool single;
  bool by_axes;
  std::vector<std::int64_t> ids;  // empty: rows
  std::vector<double> weights;    // empty: none
  std::vector<double> x;          // [n][dims], or by axes
  std::vector<float> x_f4;
  std::vector<std::int32_t> part, part_when_needed;  // told last

  Wanderers(Random& with, std::size_t count)
      : random(with),
        n(count),
        dims(1 + static_cast<int>(with.below(3))),
        single(with.below(3) == 0),
        by_axes(with.below(2) == 0),
        x(count * static_cast<std::size_t>(dims)) {
    for (double& value : x) value = random.uniform();
    if (random.below(2) == 0) {
      for (std::size_t i = 0; i < n; ++i) ids.push_back(static_cast<std::int64_t>(7 * i + random.below(7)));
      for (std::size_t i = n; i > 1; --i) std::swap(ids[i - 1], ids[random.below(i)]);
    }
    if (random.below(2) == 0) new_weights();
    part.assign(n, -1);
    part_when_needed.assign(n, -1);
  }

  void new_weights() {
    const int kind = static_cast<int>(random.below(4));
    weights.resize(n);
    for (double& w : weights)
      w = kind == 0   ? 2.5
          : kind == 1 ? random.uniform()
          : kind == 2 ? std::ldexp(random.uniform(), -static_cast<int>(random.below(160)))
                      : 1e30 * random.uniform();
  }

  void move(std::size_t i, double speed) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      at(i, a) += speed * (random.uniform() - (a == 0 ? 0.3 : 0.5));
    }
  }

  // Other rows have the same particles.
  void permute() {
    for (std::size_t i = n; i > 1; --i) {
      const std::size_t j = random.below(i);
      std::swap(ids[i - 1], ids[j]);
      if (!weights.empty()) std::swap(weights[i - 1], weights[j]);
      for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) std::swap(at(i - 1, a), at(j, a));
    }
  }

  double& at(std::size_t i, std::size_t a) { return x[by_axes ? a * n + i : i * static_cast<std::size_t>(dims) + a]; }

  Positions positions() {
    x_f4.assign(x.begin(), x.end());
    std::vector<const double*> axes;
    std::vector<const float*> axes_f4;
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
      axes.push_back(x.data() + a * n);
      axes_f4.push_back(x_f4.data() + a * n);
    }
    if (by_axes) return single ? Positions::axes(axes_f4, n) : Positions::axes(axes, n);
    return single ? Positions::rows(x_f4.data(), n, dims) : Positions::rows(x.data(), n, dims);
  }
};

void expect_one_history(const StepReport& a, const StepReport& b) {
  EXPECT_EQ(a.step, b.step);
  EXPECT_EQ(a.n, b.n);
  EXPECT_EQ(a.error_before, b.error_before);
  EXPECT_EQ(a.error, b.error);
  EXPECT_EQ(a.imbalance, b.imbalance);
  EXPECT_EQ(a.repartitioned, b.repartitioned);
  EXPECT_EQ(a.reason, b.reason);
  EXPECT_EQ(a.epoch, b.epoch);
  EXPECT_EQ(a.moved, b.moved);
  EXPECT_EQ(a.axes_flipped, b.axes_flipped);
  EXPECT_EQ(a.weights_as_zero, b.weights_as_zero);
}

void expect_told(const StepResult& result, const StepOptions& options, std::vector<std::int32_t>& told) {
  for (const PartChange& change : result.changes) told[change.row] = change.part;
  if (options.want_parts && options.want_changes) {
    EXPECT_EQ(result.parts, told);
  } else if (options.want_parts) {
    told = result.parts;
  }
}

struct Counted {
  int counts = 0, sends = 0, repartitions = 0, drifts = 0;
};

class CountTrial {
 public:
  CountTrial(Client& client, std::uint64_t seed)
      : client_(client), random_(seed), them_(random_, random_.below(3000)) {}

  void run(Counted& seen) {
    SceneOptions options{.parts = 1 + static_cast<int>(random_.below(random_.below(2) == 0 ? 9 : 40)),
                         .dims = them_.dims,
                         .tolerance = std::array{0.0, 0.05, 0.3, 2.0}[random_.below(4)],
                         .replace = true};
    if (random_.below(4) == 0) options.cut_tolerance = 0.02;
    if (random_.below(4) == 0) options.policy = "cost";
    for (int p = 0; random_.below(4) == 0 && p < options.parts; ++p)
      options.part_sizes.assign(static_cast<std::size_t>(options.parts), 1 + random_.uniform());
    ASSERT_TRUE(client_.create_scene("every", options).ok());
    options.positions = "when-needed";
    options.threads = 2;
    ASSERT_TRUE(client_.create_scene("needed", options).ok());
    auto every = client_.open_scene("every");
    auto needed = client_.open_scene("needed");
    ASSERT_TRUE(every.ok() && needed.ok());
    for (int step = 0; step < kSteps && !::testing::Test::HasFailure(); ++step) {
      SCOPED_TRACE(fmt::format("step {}", step));
      one_step(*every, *needed, step, seen);
    }
  }

 private:
  void one_step(Scene& every, Scene& needed, int step, Counted& seen) {
    StepOptions options;
    options.want_parts = random_.below(3) == 0;
    options.want_changes = random_.below(3) == 0;
    if (current_ && random_.below(4) == 0) {  // somebody else changes the cuts
      const bool forced = random_.below(2) == 0;
      for (const char* name : {"every", "needed"}) {
        const auto done = client_.call("rebalance", fmt::format(R"({{"scene":"{}","force":{}}})", name, forced));
        ASSERT_TRUE(done.ok()) << done.status().message();
      }
    }
    const std::uint64_t kind = step == 0 ? 0 : random_.below(5);
    const double speed = std::array{0.0, 1e-3, 0.05, 0.5}[random_.below(4)];
    for (std::size_t i = 0; i < them_.n; ++i)
      if (kind != 1 || random_.below(10) == 0) them_.move(i, speed);
    const bool permuted = kind == 2 && !them_.ids.empty();
    if (permuted) them_.permute();
    if (kind == 3 && !them_.weights.empty()) them_.new_weights();
    options.ids = them_.ids;
    if (step == 0 || permuted || kind == 3) options.weights = them_.weights;
    const auto a = every.step(them_.positions(), options);
    const auto b = needed.step(them_.positions(), options);
    ASSERT_TRUE(a.ok()) << a.status().message();
    ASSERT_TRUE(b.ok()) << b.status().message();
    expect_one_history(a->report, b->report);
    EXPECT_EQ(every.cuts()->hash(), needed.cuts()->hash());
    expect_told(*a, options, them_.part);
    expect_told(*b, options, them_.part_when_needed);
    if (options.want_changes || options.want_parts) {
      EXPECT_EQ(them_.part, them_.part_when_needed);
    }
    EXPECT_TRUE(a->report.sent);
    if (a->report.drifted && b->report.drifted) {
      EXPECT_EQ(a->report.drifted, b->report.drifted);
      ++seen.drifts;
    }
    EXPECT_EQ(b->report.way == "count", !b->report.sent);
    current_ = b->report.sent;
    if (b->report.sent) {
      EXPECT_EQ(b->report.positions_step, b->report.step);
    }
    seen.counts += b->report.sent ? 0 : 1;
    seen.sends += b->report.sent ? 1 : 0;
    seen.repartitions += b->report.repartitioned ? 1 : 0;
  }

  Client& client_;
  Random random_;
  Wanderers them_;
  bool current_ = false;  // the ranks hold the last step
};

TEST(Count, LeavesTheHistoryOfEveryStep) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok()) << service.status().message();
  Counted seen;
  for (std::uint64_t k = 0; k < 60 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", kCountSeed + k));
    const Path path = std::array{Path::shared, Path::direct, Path::gateway}[k % 3];
    auto client = Client::connect({.endpoint = service->endpoint(), .path = path});
    ASSERT_TRUE(client.ok());
    CountTrial(*client, kCountSeed + k).run(seen);
  }
  EXPECT_GT(seen.counts, 200);
  EXPECT_GT(seen.sends, 200);
  EXPECT_GT(seen.repartitions, 100);
  EXPECT_GT(seen.drifts, 200);
}

// Steps in which particles come or go bring positions and weights; then counts go on.
TEST(Count, GoesOnWhereParticlesComeAndGo) {
  auto service = launch::Embedded::start(3, [](double) {});
  ASSERT_TRUE(service.ok());
  auto client = Client::connect({.endpoint = service->endpoint()});
  ASSERT_TRUE(client->create_scene("s", {.parts = 6, .tolerance = INFINITY, .positions = "when-needed"}).ok());
  auto scene = client->open_scene("s");
  Random random(kCountSeed);
  Rows rows;
  rows.add(2000, random, true);
  std::vector<std::int32_t> owners;
  for (int step = 0; step < 6; ++step) {
    StepOptions options{.want_parts = true};
    rows.move(random, 0.1);
    if (step % 3 == 2) rows.change(random, 10, options);
    options.ids = rows.ids;
    if (step % 3 != 1) options.weights = rows.weights;
    const auto done = scene->step(rows.positions(), options);
    ASSERT_TRUE(done.ok()) << done.status().message();
    EXPECT_EQ(done->report.sent, step == 0) << step;
    EXPECT_EQ(done->report.n, rows.ids.size());
    owners.resize(rows.ids.size());
    ASSERT_TRUE(scene->cuts()->owner(rows.positions(), {.ids = rows.ids}, owners).ok());
    EXPECT_EQ(done->parts, owners);
    std::vector<double> loads(6);
    for (std::size_t i = 0; i < owners.size(); ++i) loads[static_cast<std::size_t>(owners[i])] += rows.weights[i];
    const auto told = wire::parse_json(client->call("counts", R"({"scene":"s"})")->json)->at("loads");
    for (std::size_t p = 0; p < loads.size(); ++p) EXPECT_NEAR(told.at(p).get<double>(), loads[p], 1e-9);
  }
}

TEST(Count, AWrongValueIsTheSameErrorAsInAPush) {
  auto service = launch::Embedded::start(2, [](double) {});
  ASSERT_TRUE(service.ok());
  auto client = Client::connect({.endpoint = service->endpoint()});
  std::vector<Status> told;
  for (const char* positions : {"every-step", "when-needed"}) {
    ASSERT_TRUE(client->create_scene(positions, {.parts = 4, .dims = 1, .positions = positions}).ok());
    auto scene = client->open_scene(positions);
    std::vector<double> x(300), weights(300, 1.0);
    std::iota(x.begin(), x.end(), 0);
    ASSERT_TRUE(scene->step(Positions::rows(x.data(), 300, 1), {.weights = weights}).ok());
    x[77] = -INFINITY;
    told.push_back(scene->step(Positions::rows(x.data(), 300, 1)).status());
    x[77] = 77;
    weights[78] = -2;
    told.push_back(scene->step(Positions::rows(x.data(), 300, 1), {.weights = weights}).status());
    EXPECT_TRUE(scene->step(Positions::rows(x.data(), 300, 1)).ok());
  }
  for (const std::size_t k : {0U, 1U}) {
    EXPECT_EQ(told[k].code(), told[k + 2].code());
    EXPECT_EQ(told[k].message(), told[k + 2].message());
    EXPECT_EQ(told[k].hint(), told[k + 2].hint());
  }
}

}  // namespace
}  // namespace rcb::client
