#include "tests/bench/step/step_pusher.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include "common/base/clock.hpp"

namespace rcb::bench {
namespace {

void shuffle(Random& random, std::size_t count, const auto& exchange) {
  for (std::size_t i = count; i > 1; --i) exchange(i - 1, static_cast<std::size_t>(random.below(i)));
}

}  // namespace

bool is_count(const std::string& variant) { return variant.starts_with("count"); }
bool by_seats(const std::string& variant) { return variant.find("members") != std::string::npos; }
std::vector<std::string> usual_variants() {
  std::vector<std::string> usual;
  for (const std::string variant : kStepVariants)
    if (!by_seats(variant) && variant != "connect") usual.push_back(variant);
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
    for (int phase = 0; phase < 2; ++phase)
      for (std::size_t i = 0; i < n; ++i) rows[phase][i * static_cast<std::size_t>(dims) + a] = axes[phase][a][i];
  }
  for (int phase = 0; phase < 2; ++phase) singles[phase].assign(rows[phase].begin(), rows[phase].end());
}

std::size_t MovingPoints::bytes_sent(const std::string& variant) const {
  // What goes to the ranks by parts, or from several seats, says whose positions it brings.
  const bool ids = by_seats(variant) || variant == "sockets" || variant == "float32";
  return bytes_read(variant) + (ids ? n * sizeof(std::int64_t) : 0);
}

std::size_t MovingPoints::bytes_read(const std::string& variant) const {
  if (variant == "connect") return 0;
  return n * static_cast<std::size_t>(dims) * (variant == "float32" ? sizeof(float) : sizeof(double));
}

Pusher::Pusher(std::string variant, const MovingPoints& motion, int seats)
    : variant_(std::move(variant)), motion_(motion) {
  if (by_seats(variant_)) team_.emplace(motion.axes, motion.dims, seats);
  if (is_count(variant_) && !team_) rows_.resize(motion.rows[0].size());
  if (variant_ == "count-permuted") {
    ids_.resize(motion.n);
    std::iota(ids_.begin(), ids_.end(), std::int64_t{0});
  }
  if (variant_ == "count-weighted")
    for (std::size_t row = 0; row < motion.n; ++row) weights_.push_back(random_.uniform(0.5, 1.5));
}

client::Path Pusher::path() const {
  if (variant_.ends_with("endpoint")) return client::Path::gateway;
  return variant_.starts_with("every-step") || variant_ == "send" ? client::Path::shared : client::Path::direct;
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
  Result<double> seconds = team_ ? team_->step(phase, report) : step_alone(phase, report);
  if (!seconds.ok()) return seconds;
  // The first step of a scene always sends.
  const bool counted = !std::exchange(first_, false) && is_count(variant_);
  const char* way = counted                           ? "count"
                    : path() == client::Path::gateway ? "endpoint"
                    : path() == client::Path::shared  ? "shared-memory"
                                                      : "sockets";
  if (report.way != way)
    return Status(
        Code::internal, fmt::format("variant {} went by {}", variant_, report.way),
        variant_ == "send" ? "an error of exactly 0 needs no new cuts: give --points that the parts don't divide" : "");
  return seconds;
}

Result<double> Pusher::step_alone(int phase, client::StepReport& report) {
  auto positions = prepare(phase);
  if (!positions.ok()) return positions.status();
  const SteadyClock clock;
  const double start = clock.seconds();
  auto result = scene_->step(*positions, {.ids = ids_, .weights = weights_});
  const double seconds = clock.seconds() - start;
  if (!result.ok()) return result.status();
  report = std::move(result->report);
  return seconds;
}

Result<client::Positions> Pusher::prepare(int phase) {
  const std::vector<double>& from = motion_.rows[phase];
  const auto rows_at = [this](const auto* at) { return client::Positions::rows(at, motion_.n, motion_.dims); };
  if (variant_ == "float32") return rows_at(motion_.singles[phase].data());
  if (variant_ == "count-permuted") permute(phase);
  // The arrays of a solver that moves its particles where they are.
  else if (is_count(variant_))
    std::copy(from.begin(), from.end(), rows_.begin());
  if (is_count(variant_)) return rows_at(rows_.data());
  if (variant_ != "every-step" && variant_ != "send") return rows_at(from.data());
  const auto rows = scene_->position_rows(motion_.n);
  if (!rows.ok()) return rows.status();
  std::copy(from.begin(), from.end(), rows->begin());
  return rows_at(rows->data());
}

void Pusher::permute(int phase) {
  shuffle(random_, ids_.size(), [this](std::size_t i, std::size_t j) { std::swap(ids_[i], ids_[j]); });
  const auto dims = static_cast<std::size_t>(motion_.dims);
  for (std::size_t row = 0; row < ids_.size(); ++row)
    std::copy_n(&motion_.rows[phase][static_cast<std::size_t>(ids_[row]) * dims], dims, &rows_[row * dims]);
}

Result<double> Pusher::connect() const {
  const SteadyClock clock;
  const double start = clock.seconds();
  const auto client = client::Client::connect(connect_);
  if (!client.ok()) return client.status();
  return clock.seconds() - start;
}

}  // namespace rcb::bench
