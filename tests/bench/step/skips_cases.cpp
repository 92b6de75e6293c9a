#include "tests/bench/step/skips_cases.hpp"

#include <cmath>

#include "common/base/random.hpp"
#include "tests/bench/scenes.hpp"

namespace rcb::bench {
namespace {

constexpr const char* kStep = "step";
constexpr const char* kFirst = "first push";

const std::vector<Case>& all_cases() {
  const Side flat{.words = "2-D", .points = "plane"};
  const Side solid{.words = "3-D, z = 0", .points = "plane", .as_solid = true};
  const Side plain{.words = "none"};
  const Side ones{.words = "all 1", .weight = 1};
  const Side uneven{.words = "unequal", .weight = 1, .weights_differ = true};
  const Side own_ids{.words = "0..n-1, sent", .ids = true};
  static const std::vector<Case> cases{
      {"dimension", kFirst, flat, solid, false},
      {"dimension", kStep, flat, solid, false},
      {"weights", kFirst, plain, ones},
      {"weights", kStep, plain, ones},
      {"weights", kFirst, plain, uneven, false, false},
      {"weights", kStep, plain, uneven, false, false},
      {"ids", kFirst, plain, own_ids},
      {"ids", kStep, plain, own_ids},
      {"exchange",
       kStep,
       {.words = "none crosses", .still = true},
       {.words = "exchanged", .no_skip = "exchange", .still = true},
       true,
       true,
       -1,
       100},
      {"search", kStep, {.words = "below tolerance"}, {.words = "searched", .no_skip = "search"}, true, true, 0.1},
      {"far from cuts", kStep, {.words = "few searched"}, {.words = "all searched", .no_skip = "warm"}, true, true, 0},
      {"ties",
       kFirst,
       {.words = "shaken lattice", .points = "lattice", .jitter = true},
       {.words = "lattice", .points = "lattice"},
       false,
       false},
      {"double precision",
       kFirst,
       {.words = "float32", .rounded = true, .single = true},
       {.words = "float64", .rounded = true}},
      {"double precision",
       kStep,
       {.words = "float32", .rounded = true, .single = true},
       {.words = "float64", .rounded = true}},
      {"questions", kStep, {.words = "nobody asks"}, {.words = "quality", .asks = "quality"}},
      {"questions", kStep, {.words = "nobody asks"}, {.words = "export (fetch)", .asks = "fetch"}},
  };
  return cases;
}

}  // namespace

std::span<const Case> skip_cases() { return all_cases(); }

SidePoints::SidePoints(const Side& side, std::size_t count) : side_(side), count_(count) {
  const SceneKind& kind = *find_scene_kind(side.points);
  const particles::ParticleSet set = make_rows(kind, count, 0, count);
  dims_ = side.as_solid ? 3 : kind.dims;
  // The distance of two neighbours: 1 in a slope and a lattice, that of a unit square's points in the plane.
  const double distance = kind.dims == 2 ? 1 / std::sqrt(static_cast<double>(count)) : 1.0;
  Random random(7);
  for (std::size_t a = 0; a < static_cast<std::size_t>(kind.dims); ++a) {
    axes_[0][a].assign(set.position[a].begin(), set.position[a].end());
    if (side.jitter)
      for (double& x : axes_[0][a]) x += distance * random.uniform(-0.1, 0.1);
    axes_[1][a] = axes_[0][a];
    if (!side.still)
      for (double& x : axes_[1][a]) x += 0.01 * distance * (0.5 + random.uniform());
  }
  if (side.as_solid)
    for (auto& phase : axes_) phase[2].assign(count, 0.0);
  for (int phase = 0; phase < 2 && side.rounded; ++phase)
    for (std::size_t a = 0; a < 3; ++a) {
      singles_[phase][a].assign(axes_[phase][a].begin(), axes_[phase][a].end());
      axes_[phase][a].assign(singles_[phase][a].begin(), singles_[phase][a].end());
    }
  for (std::size_t i = 0; i < count && side.ids; ++i) ids_.push_back(static_cast<std::int64_t>(i));
  if (side.weight > 0) weights_.assign(count, side.weight);
  for (std::size_t i = 0; i < weights_.size() && side.weights_differ; ++i) weights_[i] = 1 + static_cast<double>(i % 7);
}

client::Positions SidePoints::at(int phase) const {
  const auto d = static_cast<std::size_t>(dims_);
  if (side_.single) {
    std::array<const float*, 3> pointers{};
    for (std::size_t a = 0; a < d; ++a) pointers[a] = singles_[phase][a].data();
    return client::Positions::axes(std::span(pointers).first(d), count_);
  }
  std::array<const double*, 3> pointers{};
  for (std::size_t a = 0; a < d; ++a) pointers[a] = axes_[phase][a].data();
  return client::Positions::axes(std::span(pointers).first(d), count_);
}

}  // namespace rcb::bench
