// More than twenty thousand random scenes, small and nasty, against the judge. rapidcheck makes them from small codes,
// and shrinks a scene that fails: rows fall away, codes fall to 0, and what is left is printed with the seed.
// RC_PARAMS="seed=N max_success=M" runs other scenes, or more.
//
// Invariants
// 1. A coordinate and a weight follow from a code alone; code 0 is the plainest value of its family.
// 2. Without RC_PARAMS every run makes the same scenes.
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <limits>
#include <mutex>
#include <sstream>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include "common/partition/balance/load.hpp"
#include "tests/support/agreement.hpp"
#include "tests/support/judge.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"
#include "tests/support/thread_comm.hpp"

namespace rcb::partition {
namespace {

using namespace testing;
using Limits = std::numeric_limits<double>;

constexpr std::uint64_t kSeed = 20250321;
constexpr int kCodes = 1 << 16;
constexpr int kFullSize = 100;  // rapidcheck's size at which a number may be any of its range

struct Row {
  std::array<int, 3> at;  // codes
  int weight;
  int rank;
};

struct RandomScene {
  int dims = 1;
  std::array<int, 3> family{};  // of each axis' coordinates
  int weights = 0;              // family of weights; 0: none
  int ids = 0;                  // 0: by row, 1: backwards, 2: scattered up to 2^63 - 1
  int copies = 1;               // how often all rows stand there, with other ids
  std::vector<Row> rows;
  int parts = 1;
  std::vector<int> part_sizes;  // codes; empty: equal
  int band_axis = -1;
  int hysteresis = 0;  // code; 0: the pure rule
  int old_parts = 1;   // of the previous tree
  int ranks = 1;
  // Limits of the search, so small that few particles take many rounds.
  int chunk = 1;
  int gather = 1;
  int bins = 1;     // 2 to this
  int buckets = 0;  // code of the sample that tells them; 0: none
};

double decade(int code, double from, double to) {
  return std::pow(10.0, from + (to - from) * static_cast<double>(code) / kCodes);
}

constexpr int kFamilies = 13;

double coordinate(int family, int code) {
  const double sign = code % 2 == 0 ? 1 : -1;
  const auto of = [code](std::initializer_list<double> values) {
    return values.begin()[static_cast<std::size_t>(code) % values.size()];
  };
  constexpr double kTiny = Limits::denorm_min();
  constexpr double kMax = Limits::max();
  switch (family) {
    case 0:
      return code % 3;
    case 1:
      return code % 7 - 3;
    case 2:
      return of({0.0, -0.0, kTiny, -kTiny, 1});
    case 3:
      return (code % 19 - 9) * kTiny;
    case 4:
      return of({0, kMax, -kMax, std::nextafter(kMax, 0), -std::nextafter(kMax, 0), kMax / 2, -kMax / 2});
    case 5:
      return sign * decade(code, -6, 6);
    case 6:
      return 1e12 + 1e-3 * code / kCodes;
    case 7:
      return static_cast<double>(code) / kCodes;
    case 8:  // neighbours
      return 1 + (code % 5 - 2) * Limits::epsilon();
    case 9:  // any finite double at all
      return code == 0 ? 0.0
                       : std::bit_cast<double>((mix64(static_cast<std::uint64_t>(code)) & 0x800FFFFFFFFFFFFFU) |
                                               (mix64(static_cast<std::uint64_t>(code) + 1) % 0x7FFU) << 52U);
    case 10:
      return of({0, 1, 1e-300, 1e300, -1e300, Limits::min(), -Limits::min(), Limits::min() - kTiny, kMax, -0.0});
    case 11:  // whole numbers of the least step, over a range that 64 bins don't resolve
      return (1000 + 613.0 * code) * kTiny;
    default:
      return -2.5;
  }
}

constexpr int kWeightFamilies = 12;

double weight_of(int family, int code, bool first) {
  const double fraction = static_cast<double>(code) / kCodes;
  switch (family) {
    case 1:
      return 2.5;
    case 2:
      return 0;
    case 3:  // one giant
      return first ? 1e9 : fraction;
    case 4:  // one that weighs anything
      return first ? 3 : 0;
    case 5:
      return decade(code, -300, 300);
    case 6:
      return code % 3 == 0 ? 0 : decade(code, -300, 300);
    case 7:
      return code % 2 == 0 ? 1e-300 : 1e300;
    case 8:
      return code % 4;
    case 9:
      return code % 5 * Limits::denorm_min();
    case 10:
      return code % 2 == 0 ? Limits::max() : Limits::max() / 3;
    default:
      return 0.5 + fraction;
  }
}

double size_of(int code) { return 0.001 + 1000.0 * code / kCodes; }

std::int64_t id_of(const RandomScene& from, std::size_t row, std::size_t all) {
  const std::size_t place = from.ids == 0 ? row : all - 1 - row;
  if (from.ids < 2) return static_cast<std::int64_t>(place);
  return row == 0 ? std::numeric_limits<std::int64_t>::max() : static_cast<std::int64_t>(mix64(place) >> 1U);
}

Scene scene_of(const RandomScene& from) {
  Scene scene;
  scene.dims = from.dims;
  const std::size_t all = from.rows.size() * static_cast<std::size_t>(from.copies);
  for (std::size_t i = 0; i < all; ++i) {
    const Row& row = from.rows[i % from.rows.size()];
    for (std::size_t a = 0; a < static_cast<std::size_t>(from.dims); ++a)
      scene.x[a].push_back(coordinate(from.family[a], row.at[a]));
    scene.id.push_back(id_of(from, i, all));
    if (from.weights > 0) scene.weight.push_back(weight_of(from.weights, row.weight, i == 0));
  }
  return scene;
}

// Copies of a row lie on different ranks.
std::vector<std::size_t> rows_of(const RandomScene& from, std::size_t all, int rank) {
  std::vector<std::size_t> rows;
  for (std::size_t i = 0; i < all; ++i)
    if ((static_cast<std::size_t>(from.rows[i % from.rows.size()].rank) + i / from.rows.size()) %
            static_cast<std::size_t>(from.ranks) ==
        static_cast<std::size_t>(rank))
      rows.push_back(i);
  return rows;
}

void showValue(const RandomScene& from, std::ostream& out) {
  const Scene scene = scene_of(from);
  out << fmt::format(
      "{} x {} rows, dims {}, parts {}, sizes {}, band axis {}, hysteresis {} after {} parts, ranks {}, chunks of {}, "
      "gather {}, "
      "bins 2^{}, buckets {}; families {}, weights {}\n",
      from.copies, from.rows.size(), from.dims, from.parts, from.part_sizes, from.band_axis, from.hysteresis,
      from.old_parts, from.ranks, from.chunk, from.gather, from.bins, from.buckets, from.family, from.weights);
  for (std::size_t i = 0; i < from.rows.size(); ++i) {
    out << "  id " << scene.id[i] << " on rank " << from.rows[i].rank % from.ranks << ":";
    for (std::size_t a = 0; a < static_cast<std::size_t>(from.dims); ++a) out << fmt::format(" {:a}", scene.x[a][i]);
    if (from.weights > 0) out << fmt::format(" weight {:a}", scene.weight[i]);
    out << "\n";
  }
}

// Weights are turned into whole numbers of 2^-exponent before they are summed; the judge weighs those. What is lost is
// as little as load.hpp says.
std::string round_weights(Scene& scene) {
  double largest = 0;
  for (const double weight : scene.weight) largest = std::max(largest, weight);
  if (largest == 0) return {};
  const ExactScale scale(largest, scene.count());
  const int lost_below = static_cast<int>(std::ceil(std::log2(static_cast<double>(scene.count())))) - 125;
  for (double& weight : scene.weight) {
    const u128 whole = scale(weight);
    const double kept = std::ldexp(static_cast<double>(whole), -scale.exponent());
    if (static_cast<u128>(static_cast<double>(whole)) != whole || kept > weight ||
        weight - kept > std::ldexp(largest, lost_below))
      return fmt::format("weight {:a} counts as {:a}", weight, kept);
    weight = kept;
  }
  return {};
}

// The tree of the same rows with the axes' coordinates exchanged, as the tree in force.
CutTree previous_tree(const RandomScene& now) {
  RandomScene before = now;
  std::swap(before.family[0], before.family[static_cast<std::size_t>(now.dims) - 1]);
  JudgeOptions asked;
  asked.parts = now.old_parts;
  before.weights = 0;
  const Judgement judged = testing::judge(scene_of(before), asked);
  CutTree tree;
  tree.dims = now.dims;
  tree.parts = now.old_parts;
  for (const testing::JudgeCut& from : judged.cuts) {
    Cut cut;
    for (std::size_t i = 0; i < from.axes.size(); ++i) cut.axes[i] = static_cast<std::int8_t>(from.axes[i]);
    cut.right_empty = from.right_empty;
    std::ranges::copy(from.at, cut.key.at.begin());
    cut.key.id = from.id;
    tree.cuts.push_back(cut);
  }
  return tree;
}

void old_axes(const CutTree& old_tree, const NodeRange& range, std::vector<int>& out) {
  if (range.leaf()) return;
  const Cut* cut = old_tree.cut_of(range.first, range.last);
  out.push_back(cut == nullptr ? -1 : cut->axes[0]);
  old_axes(old_tree, range.left(), out);
  old_axes(old_tree, range.right(), out);
}

// A failed RCB_CHECK ends the program before rapidcheck can shrink or tell: the scene itself is better than nothing.
const RandomScene* g_running = nullptr;
void tell_scene(int) {
  if (g_running != nullptr) showValue(*g_running, std::cerr);
}

// Runs the scene on its ranks; empty: nothing wrong.
std::string wrong_with(const RandomScene& from) {
  Scene scene = scene_of(from);
  JudgeOptions asked;
  asked.parts = from.parts;
  for (const int code : from.part_sizes) asked.part_sizes.push_back(size_of(code));
  asked.band_axis = from.band_axis;
  CutTree previous;
  if (from.hysteresis > 0) {
    previous = previous_tree(from);
    asked.hysteresis = 1 + 0.1 * from.hysteresis;
    old_axes(previous, {0, 0, from.parts}, asked.old_axis);
  }
  PartitionOptions options = testing::options_of(asked);
  if (from.hysteresis > 0) options.previous = &previous;
  options.limits.chunk_max = static_cast<std::uint64_t>(from.chunk);
  options.limits.gather_max = static_cast<std::uint64_t>(from.gather);
  options.limits.bins_max = std::uint64_t{1} << static_cast<unsigned>(from.bins);
  if (from.buckets > 0) {
    // Of any set; the brackets may be as bad as can be.
    const auto code = static_cast<std::uint64_t>(from.buckets);
    options.limits.buckets = {.count_min = 0,
                              .parts_min = 2,
                              .per_part_min = 0,
                              .stride = 1 + code % 5,
                              .sample_min = 1 + code % 3,
                              .sample_max = ~std::uint64_t{0},
                              .overhang = 0};
    options.limits.bracket_sigmas = code % 8 == 0 ? 1 : 0;
    options.limits.bracket_margin = code % 7 == 0 ? 1 : 0;
  }

  Scene weighed = scene;
  if (std::string wrong = round_weights(weighed); !wrong.empty()) return wrong;
  const Judgement judged = testing::judge(weighed, asked);
  std::mutex mutex;
  std::string wrong;
  const auto body = [&](comm::Comm& comm) {
    const Share share = testing::take(scene, rows_of(from, scene.count(), comm.rank()));
    const Result<PartitionResult> got = partition(comm, share.particles.view(), options);
    const std::string here =
        got.ok() ? testing::disagreement(*got, share, judged) : "refused: " + got.status().message();
    const std::lock_guard lock(mutex);
    if (!here.empty()) wrong += fmt::format("rank {}: {}\n", comm.rank(), here);
  };
  if (from.ranks == 1) {
    testing::SelfComm self;
    body(self);
  } else {
    testing::ThreadWorld world(from.ranks);
    testing::run_threads(from.ranks, [&](int rank) {
      testing::ThreadComm comm(world, rank);
      body(comm);
    });
  }
  return wrong;
}

rc::Gen<int> any_of(int count) { return rc::gen::resize(kFullSize, rc::gen::inRange(0, count)); }

// What all scenes have in common; the tests add what they are about.
rc::Gen<RandomScene> plain_scenes(int rows_max) {
  const auto row =
      rc::gen::map(rc::gen::tuple(any_of(kCodes), any_of(kCodes), any_of(kCodes), any_of(kCodes), any_of(7)),
                   [](const std::tuple<int, int, int, int, int>& codes) {
                     const auto [x, y, z, weight, rank] = codes;
                     return Row{{x, y, z}, weight, rank};
                   });
  return rc::gen::mapcat(any_of(1 + rows_max), [row](int size) {
    return rc::gen::build<RandomScene>(
        rc::gen::set(&RandomScene::dims, rc::gen::resize(kFullSize, rc::gen::inRange(1, 4))),
        rc::gen::set(&RandomScene::family, rc::gen::container<std::array<int, 3>>(any_of(kFamilies))),
        rc::gen::set(&RandomScene::ids, any_of(3)),
        rc::gen::set(&RandomScene::rows, rc::gen::resize(size, rc::gen::container<std::vector<Row>>(row))),
        rc::gen::set(&RandomScene::parts, rc::gen::resize(kFullSize, rc::gen::inRange(1, 41))),
        rc::gen::set(&RandomScene::ranks, rc::gen::weightedElement<int>({{50, 1}, {8, 2}, {5, 3}, {3, 4}, {2, 7}})),
        rc::gen::set(&RandomScene::chunk, rc::gen::resize(kFullSize, rc::gen::inRange(1, 80))),
        rc::gen::set(&RandomScene::gather, rc::gen::element(1, 2, 5, 20, 512)),
        rc::gen::set(&RandomScene::bins, rc::gen::element(1, 2, 4, 8, 11)));
  });
}

// Judges `count` scenes; `add` gives a plain one what the test is about, from three codes.
template <typename Add>
void judge_scenes(int count, int rows_max, const Add& add) {
  rc::detail::TestParams parameters = rc::detail::configuration().testParams;
  if (std::getenv("RC_PARAMS") == nullptr) {
    parameters.seed = kSeed;
    parameters.maxSuccess = count;
  }
  std::cout << "seed " << parameters.seed << ", " << parameters.maxSuccess << " scenes" << std::endl;
  const auto scenes =
      rc::gen::map(rc::gen::tuple(plain_scenes(rows_max), any_of(kCodes), any_of(kCodes), any_of(kCodes)),
                   [add](std::tuple<RandomScene, int, int, int> made) {
                     auto [scene, a, b, c] = std::move(made);
                     add(scene, std::array{a, b, c});
                     return scene;
                   });
  rc::detail::TestMetadata metadata;
  metadata.id = ::testing::UnitTest::GetInstance()->current_test_info()->name();
  std::signal(SIGABRT, tell_scene);
  const auto result = rc::detail::checkTestable(
      [&] {
        const RandomScene scene = *scenes;
        g_running = &scene;
        const std::string wrong = wrong_with(scene);
        g_running = nullptr;
        if (!wrong.empty()) RC_FAIL(wrong);
      },
      metadata, parameters);
  std::signal(SIGABRT, SIG_DFL);
  std::ostringstream words;
  rc::detail::printResultMessage(result, words);
  ASSERT_TRUE(result.template is<rc::detail::SuccessResult>()) << "seed " << parameters.seed << "\n" << words.str();
}

using Codes = std::array<int, 3>;

void give_sizes(RandomScene& scene, int code) {
  for (int p = 0; p < scene.parts; ++p)
    scene.part_sizes.push_back(code == 0 ? 0 : static_cast<int>(mix64(static_cast<std::uint64_t>(code + p)) % kCodes));
}

TEST(RandomScenes, Counted) {
  judge_scenes(8000, 120, [](RandomScene&, const Codes&) {});
}

TEST(RandomScenes, Weighted) {
  judge_scenes(5000, 90,
               [](RandomScene& scene, const Codes& codes) { scene.weights = 1 + codes[0] % kWeightFamilies; });
}

TEST(RandomScenes, PartSizes) {
  judge_scenes(3500, 80, [](RandomScene& scene, const Codes& codes) {
    scene.weights = codes[0] % (1 + kWeightFamilies);
    give_sizes(scene, codes[1]);
  });
}

TEST(RandomScenes, Bands) {
  judge_scenes(2500, 100, [](RandomScene& scene, const Codes& codes) {
    scene.band_axis = codes[0] % scene.dims;
    if (codes[1] % 3 == 0) scene.weights = 1 + codes[1] % kWeightFamilies;
    if (codes[2] % 4 == 0) give_sizes(scene, codes[2]);
  });
}

TEST(RandomScenes, Hysteresis) {
  judge_scenes(3500, 80, [](RandomScene& scene, const Codes& codes) {
    scene.hysteresis = 1 + codes[0] % 20;
    scene.old_parts = codes[1] % 2 == 0 ? scene.parts : 1 + codes[1] % 40;
    if (codes[2] % 4 == 0) scene.weights = 1 + codes[2] % kWeightFamilies;
  });
}

// Thousands of particles in few places: too many to gather at once, so that histograms find every cut.
TEST(RandomScenes, ManyCopies) {
  judge_scenes(1000, 40, [](RandomScene& scene, const Codes& codes) {
    scene.copies = 1 + codes[0] % 100;
    if (codes[1] % 4 == 0) scene.weights = 1 + codes[1] % kWeightFamilies;
  });
}

TEST(RandomScenes, Buckets) {
  judge_scenes(2500, 600, [](RandomScene& scene, const Codes& codes) {
    scene.buckets = 1 + codes[0];
    scene.parts = 2 + codes[2] % 90;
    if (codes[1] % 5 == 0) scene.band_axis = codes[1] % scene.dims;
    if (codes[2] % 4 == 0) give_sizes(scene, codes[2]);
    if (codes[1] % 7 == 0) {
      scene.hysteresis = 1 + codes[0] % 30;
      scene.old_parts = scene.parts;
    }
  });
}

}  // namespace
}  // namespace rcb::partition
