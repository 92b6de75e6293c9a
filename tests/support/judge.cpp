#include "tests/support/judge.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <boost/multiprecision/cpp_int.hpp>

namespace rcb::testing {
namespace {

// Wide enough for the product of two sums of doubles, each a whole number of the least double.
using Integer = boost::multiprecision::number<boost::multiprecision::cpp_int_backend<
    4608, 4608, boost::multiprecision::signed_magnitude, boost::multiprecision::unchecked, void>>;

Integer exact(double value) {
  int exponent = 0;
  const auto digits = static_cast<std::int64_t>(std::ldexp(std::frexp(value, &exponent), 53));
  const int shift = exponent - 53 + 1074;
  return shift >= 0 ? Integer(digits) << shift : Integer(digits >> -shift);
}

class Judge {
 public:
  Judge(const Scene& scene, const JudgeOptions& options) : scene_(scene), options_(options) {
    const auto& w = scene.weight;
    weighted_ = !w.empty() && !std::all_of(w.begin(), w.end(), [&](double v) { return v == w[0]; });
    size_upto_.emplace_back(0);
    for (int p = 0; p < options.parts; ++p)
      size_upto_.push_back(size_upto_.back() +
                           exact(options.part_sizes.empty() ? 1.0 : options.part_sizes[static_cast<std::size_t>(p)]));
    answer_.part.assign(scene.count(), -1);
  }

  Judgement run() {
    std::vector<std::size_t> all(scene_.count());
    std::iota(all.begin(), all.end(), std::size_t{0});
    whole_ = axes_by_extent(all);
    node(all, 0, options_.parts);
    if (!weighted_)
      for (int p = 0; p < options_.parts; ++p) answer_.quota.push_back(share_upto(p + 1) - share_upto(p));
    return std::move(answer_);
  }

 private:
  std::vector<double> extents(const std::vector<std::size_t>& rows) const {
    std::vector<double> result;
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene_.dims); ++a) {
      double lo = 0;
      double hi = 0;
      for (std::size_t k = 0; k < rows.size(); ++k) {
        const double v = scene_.x[a][rows[k]];
        if (k == 0) lo = hi = v;
        if (v < lo) lo = v;
        if (v > hi) hi = v;
      }
      result.push_back(hi / 2 - lo / 2);
    }
    return result;
  }
  std::vector<int> axes_by_extent(const std::vector<std::size_t>& rows) const {
    const std::vector<double> e = extents(rows);
    std::vector<int> axes(e.size());
    std::iota(axes.begin(), axes.end(), 0);
    std::stable_sort(axes.begin(), axes.end(),
                     [&](int a, int b) { return e[static_cast<std::size_t>(a)] > e[static_cast<std::size_t>(b)]; });
    return axes;
  }
  static void to_front(std::vector<int>& axes, int axis) {
    axes.erase(std::find(axes.begin(), axes.end(), axis));
    axes.insert(axes.begin(), axis);
  }
  std::vector<int> axes_of(const std::vector<std::size_t>& rows, std::size_t index) const {
    if (options_.band_axis >= 0) {
      std::vector<int> axes = whole_;
      to_front(axes, options_.band_axis);
      return axes;
    }
    std::vector<int> axes = axes_by_extent(rows);
    if (options_.hysteresis > 1 && !options_.old_axis.empty()) {
      const std::vector<double> e = extents(rows);
      const int old = options_.old_axis[index];
      if (old >= 0 && e[static_cast<std::size_t>(old)] * options_.hysteresis >= e[static_cast<std::size_t>(axes[0])])
        to_front(axes, old);
    }
    return axes;
  }
  Integer sizes(int first, int last) const {
    return size_upto_[static_cast<std::size_t>(last)] - size_upto_[static_cast<std::size_t>(first)];
  }
  std::int64_t share_upto(int part) const {
    return static_cast<std::int64_t>(Integer(scene_.count() * sizes(0, part) / sizes(0, options_.parts)));
  }
  std::size_t left_count(const std::vector<std::size_t>& sorted, int first, int middle, int last) const {
    if (!weighted_) return static_cast<std::size_t>(share_upto(middle) - share_upto(first));
    Integer total = 0;
    for (const std::size_t row : sorted) total += exact(scene_.weight[row]);
    const Integer all = sizes(first, last);
    const Integer wanted = total * sizes(first, middle);  // of the prefix times `all`
    std::size_t best = 0;
    Integer best_off = wanted;
    Integer prefix = 0;
    for (std::size_t k = 0; k < sorted.size(); ++k) {
      prefix += exact(scene_.weight[sorted[k]]);
      const Integer off = abs(prefix * all - wanted);
      if (off < best_off) {
        best_off = off;
        best = k + 1;
      }
    }
    return best;
  }

  void node(const std::vector<std::size_t>& rows, int first, int last) {
    if (last - first == 1) {
      for (const std::size_t row : rows) answer_.part[row] = first;
      return;
    }
    const std::size_t index = answer_.cuts.size();
    JudgeCut cut;
    cut.axes = axes_of(rows, index);
    std::vector<std::size_t> sorted = rows;
    std::sort(sorted.begin(), sorted.end(), [&](std::size_t a, std::size_t b) {
      for (const int axis : cut.axes) {
        const auto& x = scene_.x[static_cast<std::size_t>(axis)];
        if (x[a] != x[b]) return x[a] < x[b];
      }
      return scene_.id[a] < scene_.id[b];
    });
    const int middle = first + (last - first + 1) / 2;
    const std::size_t left = left_count(sorted, first, middle, last);
    cut.right_empty = left == sorted.size();
    if (!cut.right_empty) {
      for (const int axis : cut.axes) cut.at.push_back(scene_.x[static_cast<std::size_t>(axis)][sorted[left]]);
      cut.id = scene_.id[sorted[left]];
    }
    answer_.cuts.push_back(cut);
    const auto middle_row = sorted.begin() + static_cast<std::ptrdiff_t>(left);
    node({sorted.begin(), middle_row}, first, middle);
    node({middle_row, sorted.end()}, middle, last);
  }

  const Scene& scene_;
  const JudgeOptions& options_;
  bool weighted_ = false;
  std::vector<Integer> size_upto_;
  std::vector<int> whole_;
  Judgement answer_;
};

}  // namespace

Judgement judge(const Scene& scene, const JudgeOptions& options) { return Judge(scene, options).run(); }

}  // namespace rcb::testing
