// More than twenty thousand random scenes, small and nasty, against the judge.
#include "tests/support/random_scenes.hpp"

#include <mutex>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/agreement.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

// The tree of the same rows with the axes' coordinates exchanged, as the tree in force.
CutTree previous_tree(const RandomScene& now) {
  RandomScene before = now;
  std::swap(before.family[0], before.family[static_cast<std::size_t>(now.dims) - 1]);
  JudgeOptions asked;
  asked.parts = now.old_parts;
  before.weights = 0;
  return testing::tree_of(testing::judge(scene_of(before), asked), now.dims, now.old_parts);
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
  options.tuning = testing::tuning_of(from);

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
  testing::on_threads(from.ranks, body);
  return wrong;
}

// Judges `count` scenes; `add` gives a plain one what the test is about, from three codes.
template <typename Add>
void judge_scenes(int count, int rows_max, const Add& add) {
  const auto scenes =
      rc::gen::map(rc::gen::tuple(plain_scenes(rows_max), any_of(kCodes), any_of(kCodes), any_of(kCodes)),
                   [add](std::tuple<RandomScene, int, int, int> made) {
                     auto [scene, a, b, c] = std::move(made);
                     add(scene, std::array{a, b, c});
                     return scene;
                   });
  testing::judge_random(count, scenes, [](const RandomScene& scene) { return wrong_with(scene); });
}

using Codes = std::array<int, 3>;

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
