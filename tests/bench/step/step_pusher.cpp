#include "tests/bench/step/step_pusher.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "common/base/clock.hpp"

namespace rcb::bench {
namespace {

constexpr std::size_t kSubset = 100;

void shuffle(Random& random, std::size_t count, const auto& exchange) {
  for (std::size_t i = count; i > 1; --i) exchange(i - 1, static_cast<std::size_t>(random.below(i)));
}

}  // namespace

bool is_count(const std::string& variant) { return variant.starts_with("count"); }
bool by_members(const std::string& variant) { return variant.starts_with("members") || variant == "count-members"; }
std::vector<std::string> usual_variants() {
  std::vector<std::string> usual;
  for (const std::string variant : kStepVariants)
    if (!by_members(variant) && variant != "connect") usual.push_back(variant);
  return usual;
}

MovingPoints::MovingPoints(const SceneKind& kind, std::size_t count, bool shuffled) : dims(kind.dims), n(count) {
  particles::ParticleSet set = make_rows(kind, n, 0, n);
  Random order(11);
  const auto exchange = [&](std::size_t i, std::size_t j) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) std::swap(set.position[a][i], set.position[a][j]);
  };
  if (shuffled) shuffle(order, n, exchange);
  // About a hundredth of the distance between two particles, a slope's being 1 and a unit square's 1/sqrt(n).
  const double width = 0.01 * (dims == 2 ? 1 / std::sqrt(static_cast<double>(n)) : 1.0);
  Random random(7);
  for (int phase = 0; phase < 2; ++phase) rows[phase].resize(n * static_cast<std::size_t>(dims));
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) {
    axes[0][a].assign(set.position[a].begin(), set.position[a].end());
    axes[1][a] = axes[0][a];
    for (double& x : axes[1][a]) x += width * (0.5 + random.uniform());
    for (int phase = 0; phase < 2; ++phase) singles[phase][a].assign(axes[phase][a].begin(), axes[phase][a].end());
    for (int phase = 0; phase < 2; ++phase)
      for (std::size_t i = 0; i < n; ++i) rows[phase][i * static_cast<std::size_t>(dims) + a] = axes[phase][a][i];
  }
}

std::size_t MovingPoints::bytes_sent(const std::string& variant) const {
  const auto d = static_cast<std::size_t>(dims);
  if (variant == "float32") return n * d * sizeof(float);
  if (variant == "subset") return (n + kSubset - 1) / kSubset * (d * sizeof(double) + sizeof(std::uint64_t));
  return variant == "unmoved" || variant == "connect" ? 0 : n * d * sizeof(double);
}

std::size_t MovingPoints::bytes_read(const std::string& variant) const {
  const auto slots = variant == "subset" ? (n + kSubset - 1) / kSubset * sizeof(std::uint64_t) : 0;
  return bytes_sent(variant) - slots;
}

client::Positions MovingPoints::by_singles(int phase) const {
  std::array<const float*, 3> pointers{};
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) pointers[a] = singles[phase][a].data();
  return client::Positions::axes(std::span(pointers).first(static_cast<std::size_t>(dims)), n);
}

client::Positions MovingPoints::by_axes(int phase) const {
  std::array<const double*, 3> pointers{};
  for (std::size_t a = 0; a < static_cast<std::size_t>(dims); ++a) pointers[a] = axes[phase][a].data();
  return client::Positions::axes(std::span(pointers).first(static_cast<std::size_t>(dims)), n);
}

Pusher::Pusher(std::string variant, const MovingPoints& motion, int members)
    : variant_(std::move(variant)), motion_(motion) {
  if (by_members(variant_)) team_.emplace(motion.axes, motion.dims, members);
  if (variant_ == "subset")
    for (std::size_t row = 0; row < motion.n; row += kSubset) moved_.push_back(row);
  if (is_count(variant_) && !team_) rows_.resize(motion.rows[0].size());
  if (variant_ == "count-weighted")
    for (std::size_t row = 0; row < motion.n; ++row) weights_.push_back(random_.uniform(0.5, 1.5));
}

client::Path Pusher::path() const {
  if (variant_.ends_with("endpoint")) return client::Path::gateway;
  if (variant_.starts_with("shared-memory") || variant_ == "members" || variant_ == "send") return client::Path::shared;
  return client::Path::direct;
}

Status Pusher::open(const std::string& endpoint, int parts) {
  connect_.endpoint = endpoint;
  connect_.path = path();
  auto client = client::Client::connect(connect_);
  if (!client.ok()) return client.status();
  client_.emplace(std::move(*client));
  if (variant_ == "connect") return {};
  client::SceneOptions scene;
  scene.parts = parts;
  scene.dims = motion_.dims;
  scene.tolerance = variant_ == "send" ? 0 : std::numeric_limits<double>::infinity();
  if (variant_ == "send" || is_count(variant_)) scene.positions = "when-needed";
  scene.replace = true;
  if (Status status = client_->create_scene("step-" + variant_, scene); !status.ok()) return status;
  if (team_) return team_->open(endpoint, "step-" + variant_, connect_.path);
  auto opened = client_->open_scene("step-" + variant_);
  if (!opened.ok()) return opened.status();
  scene_.emplace(std::move(*opened));
  return {};
}

Result<double> Pusher::step(int phase, client::StepReport& report) {
  if (variant_ == "connect") return connect();
  if (team_) {
    const bool first = std::exchange(first_, false);
    const auto seconds = team_->step(phase, report);
    if (seconds.ok() && is_count(variant_) && !first && report.way != "count")
      return Status(Code::internal, fmt::format("variant {} went by {}", variant_, report.way));
    return seconds;
  }
  auto positions = prepare(phase);
  if (!positions.ok()) return positions.status();
  const bool first = !scene_->last_step();
  const SteadyClock clock;
  const double start = clock.seconds();
  client::StepOptions options;
  if ((variant_ == "subset" || variant_ == "unmoved") && !first) options.moved = moved_;
  options.weights = weights_;
  auto result = scene_->step(*positions, options);
  const double seconds = clock.seconds() - start;
  if (!result.ok()) return result.status();
  report = std::move(result->report);
  if (Status status = check_way(report, first); !status.ok()) return status;
  return seconds;
}

Status Pusher::check_way(const client::StepReport& report, bool first) const {
  const bool counted = is_count(variant_) && !first;  // the first step always sends
  const bool shared = variant_.starts_with("shared-memory") || variant_ == "send";
  if (counted == (report.way == "count") && shared == (report.way == "shared-memory")) return {};
  return {Code::internal, fmt::format("variant {} went by {}", variant_, report.way)};
}

Result<client::Positions> Pusher::prepare(int phase) {
  if (is_count(variant_)) return own_rows(phase);
  if (variant_ == "shared-memory" || variant_ == "send") {
    const auto rows = scene_->position_rows(motion_.n);
    if (!rows.ok()) return rows.status();
    std::copy(motion_.rows[phase].begin(), motion_.rows[phase].end(), rows->begin());
    return client::Positions::rows(rows->data(), motion_.n, motion_.dims);
  }
  if (variant_ == "shared-memory-axes") {
    const auto axes = scene_->position_axes(motion_.n);
    if (!axes.ok()) return axes.status();
    std::array<const double*, 3> pointers{};
    for (std::size_t a = 0; a < axes->size(); ++a) {
      std::copy(motion_.axes[phase][a].begin(), motion_.axes[phase][a].end(), (*axes)[a].begin());
      pointers[a] = (*axes)[a].data();
    }
    return client::Positions::axes(std::span(pointers).first(axes->size()), motion_.n);
  }
  if (variant_ == "rows" || variant_ == "endpoint" || variant_ == "shared-memory-copy")
    return client::Positions::rows(motion_.rows[phase].data(), motion_.n, motion_.dims);
  if (variant_ == "float32") return motion_.by_singles(phase);
  return motion_.by_axes(phase);
}

// The arrays of a solver that moves its particles where they are.
client::Positions Pusher::own_rows(int phase) {
  const std::vector<double>& from = motion_.rows[phase];
  std::copy(from.begin(), from.end(), rows_.begin());
  return client::Positions::rows(rows_.data(), motion_.n, motion_.dims);
}

Result<double> Pusher::connect() const {
  const SteadyClock clock;
  const double start = clock.seconds();
  const auto client = client::Client::connect(connect_);
  if (!client.ok()) return client.status();
  return clock.seconds() - start;
}

}  // namespace rcb::bench
