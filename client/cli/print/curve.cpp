#include "client/cli/print/curve.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>

namespace rcb::cli {

void Curve::add(const client::StepReport& report) {
  if (line_.empty()) first_step_ = report.step;
  last_step_ = report.step;
  const Point after{report.step, report.error};
  const Point before{report.step, report.error_before.value_or(report.error)};
  if (report.repartitioned && report.error_before) dots_.push_back(before);
  const Stretch own{before, after};
  const auto merged = [](const Stretch& a, const Stretch& b) {
    const std::array points{a.first, a.last, b.first, b.last};
    const auto less = [](const Point& p, const Point& q) { return p.error < q.error; };
    const auto [least, largest] = std::minmax_element(points.begin(), points.end(), less);
    return least < largest ? Stretch{*least, *largest} : Stretch{*largest, *least};
  };
  if (!line_.empty() && steps_in_last_ < steps_per_stretch_) {
    line_.back() = merged(line_.back(), own);
    ++steps_in_last_;
  } else {
    line_.push_back(own);
    steps_in_last_ = 1;
  }
  if (line_.size() == kPointsMax && steps_in_last_ == steps_per_stretch_) {
    for (std::size_t k = 0; k < kPointsMax / 2; ++k) line_[k] = merged(line_[2 * k], line_[2 * k + 1]);
    line_.resize(kPointsMax / 2);
    steps_per_stretch_ *= 2;
    steps_in_last_ = steps_per_stretch_;
  }
  if (dots_.size() == kPointsMax) {
    for (std::size_t k = 0; k < kPointsMax / 2; ++k)
      dots_[k] = dots_[2 * k].error < dots_[2 * k + 1].error ? dots_[2 * k + 1] : dots_[2 * k];
    dots_.resize(kPointsMax / 2);
  }
}

double Curve::largest() const {
  double most = 0;
  for (const Stretch& stretch : line_) most = std::max({most, stretch.first.error, stretch.last.error});
  return most;
}

std::string Curve::line_data() const {
  std::string data;
  for (const Stretch& stretch : line_) {
    if (stretch.first.error != stretch.last.error)
      data += fmt::format("{} {}\n", stretch.first.step, stretch.first.error);
    data += fmt::format("{} {}\n", stretch.last.step, stretch.last.error);
  }
  return data;
}

std::string Curve::dot_data() const {
  std::string data;
  for (const Point& dot : dots_) data += fmt::format("{} {}\n", dot.step, dot.error);
  return data;
}

}  // namespace rcb::cli
