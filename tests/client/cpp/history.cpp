// One of `seats` processes that step a trajectory by the C++ interface: cpp_history ENDPOINT SCENE FILE N DIMS STEPS
// PARTS POSITIONS SEAT SEATS [hard], as tests/client/c/history.c does. `hard`: with traps, and rounding upwards.
#include <cfenv>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>

#include <rcbd/rcbd.hpp>

namespace {

void ensure(bool right, const char* what) {
  if (!right) throw std::runtime_error(what);
}

struct Solver {
  std::int64_t seat, seats, parts;
  std::size_t n, dims, steps;
  std::vector<double> all;        // [steps][n][dims]
  std::vector<std::int64_t> ids;  // whose particles are mine
  std::vector<double> xyz;        // [ids.size()][dims]

  const double* step(std::size_t k) const { return all.data() + k * n * dims; }
  std::int64_t seat_of(std::int32_t part) const { return ((part + 1) * seats - 1) / parts; }

  void gather(std::size_t k) {
    xyz.resize(ids.size() * dims);
    for (std::size_t row = 0; row < ids.size(); ++row)
      std::memcpy(&xyz[row * dims], step(k) + static_cast<std::size_t>(ids[row]) * dims, dims * sizeof(double));
  }

  // Takes over the particles of my parts, and checks that `leaving` names those that were mine and are no more.
  void hand_over(const rcbd::Cuts& cuts, const rcbd::Leaving& leaving, std::size_t k) {
    const std::vector<std::int32_t> part = cuts.owner(rcbd::Positions(step(k), n, static_cast<int>(dims)));
    std::size_t left = 0;
    for (std::size_t row = 0; row < ids.size(); ++row) {
      const std::int64_t to = seat_of(part[static_cast<std::size_t>(ids[row])]);
      if (to == seat) continue;
      ensure(left < leaving.rows.size() && leaving.rows[left] == static_cast<std::int64_t>(row) &&
                 leaving.seats[left] == to,
             "a row leaves that was not named, or for another seat");
      ++left;
    }
    ensure(left == leaving.rows.size(), "more rows are named than leave");
    ids.clear();
    for (std::size_t id = 0; id < n; ++id)
      if (seat_of(part[id]) == seat) ids.push_back(static_cast<std::int64_t>(id));
  }
};

// What is printed depends on the rounding, too.
void print_step(const rcbd::Report& report, const rcbd::Cuts& cuts) {
  const int rounding = std::fegetround();
  std::fesetround(FE_TONEAREST);
  ensure(cuts.epoch() == report.epoch, "cuts of another epoch than the report's");
  std::printf("%" PRId64 " %" PRId64 " %d %.17g %.17g %.17g %d %" PRId64 " %" PRId64 " %d %016" PRIx64 " %d\n",
              report.step, report.n, report.parts, report.error_before, report.error, report.imbalance,
              report.repartitioned, report.epoch, report.moved, report.axes_flipped, cuts.hash(), report.sent);
  std::fesetround(rounding);
}

void run(char** arguments, bool hard) {
  const auto number = [&](int k) { return std::atoll(arguments[k]); };
  const auto size = [&](int k) { return static_cast<std::size_t>(number(k)); };
  Solver solver{number(9), number(10), number(7), size(4), size(5), size(6), {}, {}, {}};
  solver.all.resize(solver.steps * solver.n * solver.dims);
  std::ifstream file(arguments[3], std::ios::binary);
  file.read(reinterpret_cast<char*>(solver.all.data()),
            static_cast<std::streamsize>(solver.all.size() * sizeof(double)));
  ensure(bool(file), "the file is too short");
  for (std::int64_t id = solver.seat; id < number(4); id += solver.seats) solver.ids.push_back(id);
#ifdef _GNU_SOURCE
  if (hard) feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW);
#endif
  if (hard) std::fesetround(FE_UPWARD);
  const rcbd::Client client = rcbd::connect(arguments[1]);
  rcbd::SceneOptions options;
  options.parts = static_cast<int>(solver.parts);
  options.dims = static_cast<int>(solver.dims);
  options.positions = arguments[8];
  options.seat = static_cast<int>(solver.seat);
  options.seats = static_cast<int>(solver.seats);
  options.replace = true;
  const rcbd::Scene scene = client.scene_open(arguments[2], options);
  std::puts("made");
  std::fflush(stdout);
  for (std::size_t k = 0; k < solver.steps; ++k) {
    solver.gather(k);
    rcbd::StepOptions with;
    with.ids = solver.ids;
    with.send = k + 1 == solver.steps;
    const rcbd::Step step = scene.step({solver.xyz, options.dims}, with);
    const rcbd::Cuts cuts = scene.cuts();
    print_step(step.report(), cuts);
    solver.hand_over(cuts, step.leaving(), k);
  }
}

}  // namespace

int main(int count, char** arguments) try {
  ensure(count == 11 || count == 12, "wrong arguments");
  run(arguments, count == 12);
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
