// Curve: an error history for a figure, in memory that doesn't grow with its length. Up to kPointsMax steps are kept
// one by one; beyond that, neighbouring steps are merged, repeatedly, and the smallest and the largest error of each
// stretch are kept, so that the drawn line covers the same area.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/lib/client.hpp"

namespace rcb::cli {

class Curve {
 public:
  static constexpr std::size_t kPointsMax = 8192;

  std::string name;
  std::optional<double> tolerance;  // none: inf

  // In the order of the steps.
  void add(const client::StepReport& report);
  bool empty() const { return line_.empty(); }
  bool one_step() const { return line_.size() == 1 && steps_in_last_ == 1; }
  std::int64_t first_step() const { return first_step_; }
  std::int64_t last_step() const { return last_step_; }
  double largest() const;  // error; 0 if there is none
  bool repartitioned() const { return !dots_.empty(); }
  // Data for gnuplot, one point a line. line_data: for each step the error before and after its repartition, which
  // draws a sawtooth; dot_data: the errors that caused repartitions.
  std::string line_data() const;
  std::string dot_data() const;

 private:
  struct Point {
    std::int64_t step = 0;
    double error = 0;
  };
  // One or several steps, of whose points only the smallest and the largest error are kept, in order of time.
  struct Stretch {
    Point first;
    Point last;
  };

  std::vector<Stretch> line_;
  std::vector<Point> dots_;
  std::uint64_t steps_per_stretch_ = 1;  // steps in a full stretch
  std::uint64_t steps_in_last_ = 0;      // steps in the last stretch so far
  std::int64_t first_step_ = 0;
  std::int64_t last_step_ = 0;
};

}  // namespace rcb::cli
