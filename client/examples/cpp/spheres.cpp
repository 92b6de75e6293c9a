#include "client/examples/cpp/spheres.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <tuple>
#include <utility>

#include "common/base/random.hpp"

namespace rcb::examples {
namespace {

using Force = std::array<std::int64_t, 3>;
constexpr double kForceUnits = 0x1p32;  // an integer force of 1 is this part of a unit

// At the start the spheres are on a lattice, and take half of its sites.
constexpr double kSpacing = 1.2;
std::int64_t lattice_sites(std::int64_t particles) {  // along an axis
  std::int64_t sites = 3;
  while (sites * sites * sites < 2 * particles) ++sites;
  return sites;
}

[[noreturn]] void end_with(int code, const char* program, std::string_view why) {
  std::fprintf(
      code == 0 ? stdout : stderr,
      "%.*s%sspheres in a periodic box: %s [--particles N] [--steps N] [--push-every N] [--parts N] [--seed N]\n"
      "    [--damping X] [--reach X] [--scene NAME] [--endpoint E] [--brute-force]\n",
      static_cast<int>(why.size()), why.data(), why.empty() ? "" : "\n", program);
  std::exit(code);
}

template <typename T>
bool read(std::string_view text, T least, T most, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && value >= least && value <= most;
}

// The contacts of spheres that lie in cells somewhat wider than a diameter: they are in cells next to each other.
class Cells {
 public:
  Cells(std::span<const Sphere> all, double side)
      : along_(static_cast<std::int64_t>(side / (1.01 * kDiameter))),
        side_(side),
        head_(std::bit_ceil(all.size() + 1), kNone),
        next_(all.size()),
        cell_(all.size()) {
    for (std::size_t i = 0; i < all.size(); ++i) {
      const std::int64_t cell = number(place(all[i].x[0]), place(all[i].x[1]), place(all[i].x[2]));
      cell_[i] = cell;
      next_[i] = std::exchange(head_[slot(cell)], i);
    }
  }
  // Calls visit(j) for all spheres, itself included, in the cells next to this sphere's.
  template <typename Visit>
  void near(const Sphere& sphere, Visit visit) const {
    const std::int64_t at[3] = {place(sphere.x[0]), place(sphere.x[1]), place(sphere.x[2])};
    for (int k = 0; k < 27; ++k) {
      const std::int64_t cell = number(at[0] + k % 3 - 1, at[1] + k / 3 % 3 - 1, at[2] + k / 9 - 1);
      for (std::size_t j = head_[slot(cell)]; j != kNone; j = next_[j])
        if (cell_[j] == cell) visit(j);
    }
  }

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);

  std::int64_t place(double x) const {
    return std::min(static_cast<std::int64_t>(x / side_ * static_cast<double>(along_)), along_ - 1);
  }
  std::int64_t number(std::int64_t i, std::int64_t j, std::int64_t k) const {  // each from -1 to along_
    const auto wrapped = [this](std::int64_t n) { return (n + along_) % along_; };
    return (wrapped(i) * along_ + wrapped(j)) * along_ + wrapped(k);
  }
  // Only cells with spheres take memory: a table by the hash of their numbers, so a process needs none for the rest of
  // the box.
  std::size_t slot(std::int64_t cell) const { return mix64(static_cast<std::uint64_t>(cell)) & (head_.size() - 1); }

  std::int64_t along_;  // cells along an axis, at least 3
  double side_;
  std::vector<std::size_t> head_, next_;  // by slot: the first sphere there; by sphere: the next one
  std::vector<std::int64_t> cell_;        // by sphere
};

// The force on b from a, whose id is lower; false if they don't touch.
bool contact(const Sphere& a, const Sphere& b, const Options& options, double side, Force& force) {
  double d[3], square = 0, closing = 0;
  for (int k = 0; k < 3; ++k) {
    d[k] = difference(a.x[k], b.x[k], side);
    square += d[k] * d[k];
    closing += (a.v[k] - b.v[k]) * d[k];
  }
  if (square >= kDiameter * kDiameter) return false;
  const double distance = std::sqrt(square);
  const double push = kStiffness * (kDiameter - distance);
  for (std::size_t k = 0; k < 3; ++k)  // no direction, no force
    force[k] = distance == 0
                   ? 0
                   : static_cast<std::int64_t>(std::floor(
                         (push + options.damping * closing / distance) * d[k] / distance * kForceUnits + 0.5));
  return true;
}

}  // namespace

double Options::side() const { return kSpacing * static_cast<double>(lattice_sites(particles)); }

// At the start no sphere is faster than 2 along an axis. Later some are twice as fast.
double Options::default_reach() const { return 6 * kTimeStep * static_cast<double>(push_every - 1); }

Options options_of(int argc, char** argv) {
  Options o;
  const std::tuple<std::string_view, std::int64_t, std::int64_t*> numbers[] = {{"--particles", 1, &o.particles},
                                                                               {"--steps", 0, &o.steps},
                                                                               {"--push-every", 1, &o.push_every},
                                                                               {"--parts", 0, &o.parts},
                                                                               {"--seed", 0, &o.seed}};
  const std::pair<std::string_view, double*> reals[] = {{"--damping", &o.damping}, {"--reach", &o.reach}};
  const std::pair<std::string_view, std::string*> texts[] = {{"--scene", &o.scene}, {"--endpoint", &o.endpoint}};
  for (int k = 1; k < argc; ++k) {
    const std::string_view name = argv[k];
    if (name == "--help") end_with(0, argv[0], "");
    if (name == "--brute-force") {
      o.brute_force = true;
      continue;
    }
    const std::string_view value = k + 1 < argc ? argv[++k] : "";
    bool well = false;
    for (const auto& [option, least, number] : numbers)
      if (name == option) well = read<std::int64_t>(value, least, 1'000'000'000, *number);
    for (const auto& [option, real] : reals)
      if (name == option) well = read<double>(value, 0, 100, *real);  // with more damping the time step is too long
    for (const auto& [option, text] : texts)
      if (name == option) *text = value, well = !value.empty();
    if (!well) end_with(2, argv[0], std::string(name) + " " + std::string(value) + ": wrong option or value");
  }
  if (o.reach == 0) o.reach = o.default_reach();
  return o;
}

void print(const Options& options, const Tally& tally) {
  std::printf("steps %" PRId64 "\ncontacts %" PRIu64 "\ntrajectory %016" PRIx64 "\npairs %016" PRIx64 "\n",
              options.steps, tally.contacts, tally.trajectory, tally.pairs);
}

std::vector<Sphere> spheres_at_start(const Options& options, std::int64_t first, std::int64_t last) {
  const std::int64_t sites = lattice_sites(options.particles);
  std::vector<Sphere> spheres;
  for (std::int64_t id = first; id < last; ++id) {
    Random random(mix64(static_cast<std::uint64_t>(options.seed)) + static_cast<std::uint64_t>(id));
    Sphere sphere{id, {}, {}};
    const std::int64_t site[3] = {id / (sites * sites), id / sites % sites, id % sites};
    for (int k = 0; k < 3; ++k) {
      sphere.x[k] = kSpacing * (static_cast<double>(site[k]) + random.uniform(0.4, 0.6));
      sphere.v[k] = random.uniform(-1, 1);
    }
    sphere.v[0] += site[1] < sites / 2 ? 1 : -1;
    spheres.push_back(sphere);
  }
  return spheres;
}

double difference(double from, double to, double side) {
  const double d = to - from;
  if (d > side / 2) return d - side;
  if (d < -side / 2) return d + side;
  return d;
}

Status within_reach(std::span<const Sphere> pushed, std::span<const Sphere> now, const Options& options) {
  const double side = options.side();
  for (std::size_t i = 0; i < now.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k)
      if (std::abs(difference(pushed[i].x[k], now[i].x[k], side)) > options.reach)
        return {Code::aborted,
                "sphere " + std::to_string(now[i].id) + " has moved by more than " + std::to_string(options.reach) +
                    " since the last push, so the halo may lack spheres that it touches",
                "push more often (--push-every) or give a greater --reach"};
  return {};
}

void advance(std::vector<Sphere>& mine, std::span<const Sphere> others, const Options& options, std::int64_t step,
             Tally& tally) {
  const double side = options.side();
  std::vector<Sphere> all = mine;
  all.insert(all.end(), others.begin(), others.end());
  std::vector<Force> forces(mine.size());
  const auto meet = [&](std::size_t a, std::size_t b) {
    if (all[a].id > all[b].id) std::swap(a, b);
    Force force;
    if (!contact(all[a], all[b], options, side, force)) return;
    for (std::size_t k = 0; k < 3; ++k) {
      if (a < mine.size()) forces[a][k] -= force[k];
      if (b < mine.size()) forces[b][k] += force[k];
    }
    if (a >= mine.size()) return;
    ++tally.contacts;
    tally.pairs += mix64(mix64(mix64(static_cast<std::uint64_t>(step)) + static_cast<std::uint64_t>(all[a].id)) +
                         static_cast<std::uint64_t>(all[b].id));
  };
  const Cells cells(all, side);
  for (std::size_t i = 0; i < mine.size(); ++i) {
    const auto with = [&](std::size_t j) {
      if (j > i) meet(i, j);  // so each pair once; of two others, none
    };
    if (!options.brute_force) {
      cells.near(all[i], with);
    } else {
      for (std::size_t j = 0; j < all.size(); ++j) with(j);
    }
  }
  for (std::size_t i = 0; i < mine.size(); ++i) {
    std::uint64_t hash = mix64(mix64(static_cast<std::uint64_t>(step)) + static_cast<std::uint64_t>(mine[i].id));
    for (std::size_t k = 0; k < 3; ++k) {
      double& x = mine[i].x[k];
      hash = mix64(hash + std::bit_cast<std::uint64_t>(x));
      mine[i].v[k] += kTimeStep * (static_cast<double>(forces[i][k]) / kForceUnits);
      x += kTimeStep * mine[i].v[k];
      if (x < 0) x += side;
      if (x >= side) x -= side;  // also what has just been rounded up to `side`
    }
    tally.trajectory += hash;
  }
}

}  // namespace rcb::examples
