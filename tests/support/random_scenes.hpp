// Random scenes, small and nasty. rapidcheck makes them from small codes, and shrinks a scene that fails: rows fall
// away, codes fall to 0, and what is left is printed with the seed. RC_PARAMS="seed=N max_success=M" runs other scenes,
// or more.
//
// Invariants
// 1. A coordinate and a weight follow from a code alone; code 0 is the plainest value of its family.
// 2. Without RC_PARAMS every run makes the same scenes.
#pragma once

#include <array>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include "common/comm/comm.hpp"
#include "common/partition/rules/request.hpp"
#include "tests/support/judge.hpp"
#include "tests/support/scenes.hpp"

namespace rcb::testing {

inline constexpr std::uint64_t kRandomSeed = 20250321;
inline constexpr int kCodes = 1 << 16;
inline constexpr int kFullSize = 100;  // rapidcheck's size at which a number may be any of its range
inline constexpr int kFamilies = 13;   // of coordinates
inline constexpr int kWeightFamilies = 12;

struct Row {
  std::array<int, 3> at;  // codes
  int weight;
  int rank;
};

struct RandomScene {
  int dims = 1;
  std::array<int, 3> family{};  // of each axis' coordinates
  int weights = 0;              // family of weights; 0: none
  int ids = 0;                  // 0: by row, 1: backwards, 2: scattered up to 2^63 - 1, 3: dense, in three ranges
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

double size_of(int code);  // of a part
void give_sizes(RandomScene& scene, int code);
Scene scene_of(const RandomScene& from);
// The rows on a rank. Copies of a row lie on different ranks.
std::vector<std::size_t> rows_of(const RandomScene& from, std::size_t all, int rank);
void showValue(const RandomScene& from, std::ostream& out);

// The limits of the search, of any set; the brackets may be as bad as can be.
partition::Tuning tuning_of(const RandomScene& from);
// Rounds the weights as load.hpp says, so that the judge weighs what is summed. Empty: nothing is wrong with that.
std::string round_weights(Scene& scene);
// The axis of each node in preorder, for JudgeOptions::old_axis; -1 where the old tree lacks a node with these parts.
void old_axes(const cuts::CutTree& old_tree, const cuts::NodeRange& range, std::vector<int>& out);
// What was judged, as a tree.
cuts::CutTree tree_of(const Judgement& judged, int dims, int parts);

// Runs body(comm) on so many threads; a single rank needs none.
void on_threads(int ranks, const std::function<void(comm::Comm&)>& body);

rc::Gen<int> any_of(int count);
// What all scenes have in common; the tests add what they are about.
rc::Gen<RandomScene> plain_scenes(int rows_max);

// A failed RCB_CHECK ends the program before rapidcheck can shrink or tell: what is shown here is better than nothing.
inline std::function<void(std::ostream&)> g_show_running;

// Judges `count` of these scenes. wrong_with(scene): what is wrong with the answer; empty: nothing.
template <typename Made, typename WrongWith>
void judge_random(int count, const rc::Gen<Made>& scenes, const WrongWith& wrong_with) {
  rc::detail::TestParams parameters = rc::detail::configuration().testParams;
  if (std::getenv("RC_PARAMS") == nullptr) {
    parameters.seed = kRandomSeed;
    parameters.maxSuccess = count;
  }
  std::cout << "seed " << parameters.seed << ", " << parameters.maxSuccess << " scenes" << std::endl;
  rc::detail::TestMetadata metadata;
  metadata.id = ::testing::UnitTest::GetInstance()->current_test_info()->name();
  std::signal(SIGABRT, [](int) {
    if (g_show_running) g_show_running(std::cerr);
  });
  const auto result = rc::detail::checkTestable(
      [&] {
        const Made scene = *scenes;
        g_show_running = [&scene](std::ostream& out) { showValue(scene, out); };
        const std::string wrong = wrong_with(scene);
        g_show_running = nullptr;
        if (!wrong.empty()) RC_FAIL(wrong);
      },
      metadata, parameters);
  std::signal(SIGABRT, SIG_DFL);
  std::ostringstream words;
  rc::detail::printResultMessage(result, words);
  ASSERT_TRUE(result.template is<rc::detail::SuccessResult>()) << "seed " << parameters.seed << "\n" << words.str();
}

}  // namespace rcb::testing
