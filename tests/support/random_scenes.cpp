#include "tests/support/random_scenes.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/exact_scale.hpp"
#include "tests/support/self_comm.hpp"
#include "tests/support/thread_comm.hpp"

namespace rcb::testing {
namespace {

using Limits = std::numeric_limits<double>;

double decade(int code, double from, double to) {
  return std::pow(10.0, from + (to - from) * static_cast<double>(code) / kCodes);
}

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

std::int64_t id_of(const RandomScene& from, std::size_t row, std::size_t all) {
  const std::size_t place = from.ids == 0 ? row : all - 1 - row;
  if (from.ids < 2) return static_cast<std::int64_t>(place);
  if (from.ids == 3) return static_cast<std::int64_t>(place + ((mix64(place) % 3) << 40U));
  return row == 0 ? std::numeric_limits<std::int64_t>::max() : static_cast<std::int64_t>(mix64(place) >> 1U);
}

}  // namespace

double size_of(int code) { return 0.001 + 1000.0 * code / kCodes; }

void give_sizes(RandomScene& scene, int code) {
  for (int p = 0; p < scene.parts; ++p)
    scene.part_sizes.push_back(code == 0 ? 0 : static_cast<int>(mix64(static_cast<std::uint64_t>(code + p)) % kCodes));
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

partition::Tuning tuning_of(const RandomScene& from) {
  partition::Tuning tuning;
  tuning.chunk_max = static_cast<std::uint64_t>(from.chunk);
  tuning.gather_max = static_cast<std::uint64_t>(from.gather);
  tuning.bins_max = std::uint64_t{1} << static_cast<unsigned>(from.bins);
  if (from.buckets > 0) {
    const auto code = static_cast<std::uint64_t>(from.buckets);
    tuning.sample = {.count_min = 0,
                     .parts_min = 2,
                     .per_part_min = 0,
                     .stride = 1 + code % 5,
                     .sample_min = 1 + code % 3,
                     .sample_max = ~std::uint64_t{0}};
    tuning.bracket_sigmas = code % 8 == 0 ? 1 : 0;
    tuning.bracket_margin = code % 7 == 0 ? 1 : 0;
  }
  return tuning;
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

void old_axes(const cuts::CutTree& old_tree, const cuts::NodeRange& range, std::vector<int>& out) {
  if (range.leaf()) return;
  const cuts::Cut* cut = old_tree.cut_of(range.first, range.last);
  out.push_back(cut == nullptr ? -1 : cut->axes[0]);
  old_axes(old_tree, range.left(), out);
  old_axes(old_tree, range.right(), out);
}

cuts::CutTree tree_of(const Judgement& judged, int dims, int parts) {
  cuts::CutTree tree;
  tree.dims = dims;
  tree.parts = parts;
  for (const JudgeCut& from : judged.cuts) {
    cuts::Cut cut;
    for (std::size_t i = 0; i < from.axes.size(); ++i) cut.axes[i] = static_cast<std::int8_t>(from.axes[i]);
    cut.right_empty = from.right_empty;
    std::ranges::copy(from.at, cut.key.at.begin());
    cut.key.id = from.id;
    tree.cuts.push_back(cut);
  }
  return tree;
}

void on_threads(int ranks, const std::function<void(comm::Comm&)>& body) {
  if (ranks == 1) {
    SelfComm self;
    return body(self);
  }
  ThreadWorld world(ranks);
  run_threads(ranks, [&](int rank) {
    ThreadComm comm(world, rank);
    body(comm);
  });
}

rc::Gen<int> any_of(int count) { return rc::gen::resize(kFullSize, rc::gen::inRange(0, count)); }

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
        rc::gen::set(&RandomScene::ids, any_of(4)),
        rc::gen::set(&RandomScene::rows, rc::gen::resize(size, rc::gen::container<std::vector<Row>>(row))),
        rc::gen::set(&RandomScene::parts, rc::gen::resize(kFullSize, rc::gen::inRange(1, 41))),
        rc::gen::set(&RandomScene::ranks, rc::gen::weightedElement<int>({{50, 1}, {8, 2}, {5, 3}, {3, 4}, {2, 7}})),
        rc::gen::set(&RandomScene::chunk, rc::gen::resize(kFullSize, rc::gen::inRange(1, 80))),
        rc::gen::set(&RandomScene::gather, rc::gen::element(1, 2, 5, 20, 512)),
        rc::gen::set(&RandomScene::bins, rc::gen::element(1, 2, 4, 8, 11)));
  });
}

}  // namespace rcb::testing
