// Curve: an error history as a figure shows it, in memory that doesn't grow with its length. Up to kPointsMax steps
// each is there; of more, neighbours are merged, again and again, and the least and the largest of them stay, so that
// the drawn line covers the same area.
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
  // gnuplot's data, a point a line: the error as it arose, then as a repartition left it, a sawtooth; and the errors
  // that called for repartitions.
  std::string line_data() const;
  std::string dot_data() const;

 private:
  struct Point {
    std::int64_t step = 0;
    double error = 0;
  };
  // The points of one step, or of several: two of them, in their order.
  struct Stretch {
    Point first;
    Point last;
  };

  std::vector<Stretch> line_;
  std::vector<Point> dots_;
  std::uint64_t each_ = 1;     // steps of a stretch
  std::uint64_t in_last_ = 0;  // steps of the last one, so far
};

}  // namespace rcb::cli
