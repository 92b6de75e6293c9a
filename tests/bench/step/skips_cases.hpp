// The cases of rcb_bench skips: what is skipped, and the two sides that differ in nothing else.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "client/lib/client.hpp"

namespace rcb::bench {

// One side of a case: its points, and how they are pushed.
struct Side {
  const char* words;
  const char* no_skip = "";      // of its service
  const char* points = "slope";  // scenes.hpp
  bool still = false;            // else all points move, there and back
  bool jitter = false;           // the points shaken by a tenth of their distance
  bool as_solid = false;         // two dimensions as three with z = 0
  bool rounded = false;          // values that float32 has, too
  bool single = false;           // and they are sent so
  bool ids = false;              // 0..n-1, sent with every push
  double weight = 0;             // of each particle, sent with every push; 0: none are
  bool weights_differ = false;   // particle i's is 1 + i mod 7
  const char* asks = "";         // a command whose answer is waited for after each step
};

struct Case {
  const char* skip;  // as the step report names it
  const char* work;  // step, or first push: a scene made anew each time
  Side on;
  Side off;
  bool same_hash = true;     // else the cuts are written down otherwise, but mean the same
  bool same_answers = true;  // else the two sides partition different points or loads
  double tolerance = -1;     // < 0: infinity
  std::size_t fewer = 1;     // so many times fewer points, where the saving doesn't grow with them
};

std::span<const Case> skip_cases();

// A side's positions.
class SidePoints {
 public:
  SidePoints(const Side& side, std::size_t count);
  int dims() const { return dims_; }
  std::size_t count() const { return count_; }
  client::Positions at(int phase) const;
  client::StepOptions options() const { return {.ids = ids_, .weights = weights_}; }

 private:
  Side side_;
  int dims_;
  std::size_t count_;
  std::array<std::vector<double>, 3> axes_[2];
  std::array<std::vector<float>, 3> singles_[2];
  std::vector<std::int64_t> ids_;
  std::vector<double> weights_;
};

}  // namespace rcb::bench
