#include "tests/support/agreement.hpp"

#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rcb::testing {
namespace {

using cuts::Cut;
using cuts::CutTree;
using cuts::Method;

std::string wrong_cut(const CutTree& tree, const Judgement& judged) {
  if (tree.cuts.size() != judged.cuts.size()) return fmt::format("{} cuts", tree.cuts.size());
  for (std::size_t n = 0; n < tree.cuts.size(); ++n) {
    const Cut& cut = tree.cuts[n];
    const JudgeCut& right = judged.cuts[n];
    for (std::size_t i = 0; i < right.axes.size(); ++i)
      if (cut.axes[i] != right.axes[i])
        return fmt::format("node {}: axis {} is {}, not {}", n, i, int{cut.axes[i]}, right.axes[i]);
    if (cut.right_empty != right.right_empty)
      return fmt::format("node {}: the right side is {}empty", n, cut.right_empty ? "" : "not ");
    if (cut.right_empty) continue;
    for (std::size_t i = 0; i < right.at.size(); ++i) {
      if (cut.key.at[i] != right.at[i])
        return fmt::format("node {}: word {} of the cut is {:a}, not {:a}", n, i, cut.key.at[i], right.at[i]);
      if (cut.key.at[i] == 0 && std::signbit(cut.key.at[i])) return fmt::format("node {}: a cut at -0.0", n);
    }
    if (cut.key.id != right.id) return fmt::format("node {}: id {} at the cut, not {}", n, cut.key.id, right.id);
  }
  return {};
}

}  // namespace

partition::PartitionOptions options_of(const JudgeOptions& asked) {
  partition::PartitionOptions options;
  options.parts = asked.parts;
  options.part_sizes = asked.part_sizes;
  options.axis_hysteresis = asked.hysteresis;
  if (asked.band_axis >= 0) options.method = static_cast<Method>(static_cast<int>(Method::bands_x) + asked.band_axis);
  return options;
}

std::string disagreement(const partition::PartitionResult& got, const Share& share, const Judgement& judged) {
  if (std::string wrong = wrong_cut(got.tree, judged); !wrong.empty()) return wrong;
  std::vector<std::uint64_t> counts(got.counts.size(), 0);
  for (const std::int32_t part : judged.part)
    if (!counts.empty()) ++counts[static_cast<std::size_t>(part)];
  if (counts != got.counts) return fmt::format("counts {}, not {}", got.counts, counts);
  const particles::ParticleView view = share.particles.view();
  if (got.part.size() != view.count) return fmt::format("{} parts for {} particles", got.part.size(), view.count);
  std::vector<std::int32_t> classified(view.count);
  got.tree.classify(view, classified);
  for (std::size_t i = 0; i < view.count; ++i) {
    const std::size_t row = share.row[i];
    if (got.part[i] != judged.part[row])
      return fmt::format("row {} is in part {}, not {}", row, got.part[i], judged.part[row]);
    const int owner = got.tree.part_of(view.point(i), view.id[i]);
    if (owner != got.part[i]) return fmt::format("row {} is in part {}, its owner is {}", row, got.part[i], owner);
    if (classified[i] != owner) return fmt::format("row {}: classify() says {}", row, classified[i]);
  }
  return {};
}

}  // namespace rcb::testing
