// The independent judge: the partition by full sorts and exact integers, written from the definition and sharing no
// code with the engine. Slow; for small scenes.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "tests/support/scenes.hpp"

namespace rcb::testing {

struct JudgeCut {
  std::vector<int> axes;
  bool right_empty = false;
  std::vector<double> at;  // in axis order
  std::int64_t id = 0;
};

struct Judgement {
  std::vector<std::int32_t> part;   // by row of the scene
  std::vector<JudgeCut> cuts;       // in preorder
  std::vector<std::int64_t> quota;  // of each part; empty with weights that count
};

struct JudgeOptions {
  int parts = 1;
  std::vector<double> part_sizes;
  int band_axis = -1;  // -1: rcb
  double hysteresis = 1;
  std::vector<int> old_axis;  // by preorder node; -1: no old node with the same parts; empty: none
};

Judgement judge(const Scene& scene, const JudgeOptions& options);

}  // namespace rcb::testing
