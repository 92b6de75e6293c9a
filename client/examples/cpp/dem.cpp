// dem_cpp: soft spheres in a periodic box, on the processes of mpirun. A process computes the spheres of its own parts;
// of the others' it has copies of those that may touch them, the ghosts. At the start spheres fill half of the box, in
// two layers that flow past each other.
//
//   mpicxx -std=c++14 -O2 -ffp-contract=off dem.cpp -o dem_cpp -lrcbd
//
// The spheres move the same on any number of processes, to the bit: a contact is computed once, by the process that has
// the sphere of the lower id, by + - * / and sqrt alone, which must not be contracted, and forces are summed as
// integers. The cuts are the same, too, with the same --parts (default: the number of processes).
#include <cinttypes>
#include <cmath>
#include <fstream>
#include <map>

#include <rcbd/mpi.hpp>

// ---- the solver, which knows nothing of processes ----

using Vector = std::array<double, 3>;
using Force = std::array<std::int64_t, 3>;
constexpr double D = 1, K = 1000, C = 2;  // diameter, stiffness of a contact, its damping; the mass is 1
constexpr double dt = 0.005;              // a contact lasts for 14 of these
constexpr double U = 4294967296.;         // an integer force of 1 is this part of a unit

struct Spheres {
  std::vector<std::int64_t> id;  // the ghosts' rows follow mine
  std::vector<Vector> x, v, x0;  // x0: where mine were at the last push
  std::vector<Force> f;
};

// Adds the sphere of this id, on a lattice with so many sites along an axis.
void place(Spheres& s, std::int64_t id, std::int64_t sites) {
  const std::int64_t site[] = {id / (sites * sites), id / sites % sites, id % sites};
  std::int64_t random = (id + 1) * 69621 % 2147483647;
  double u[9];  // the first three are thrown away
  for (double& one : u) {
    random = random * 16807 % 2147483647;
    one = static_cast<double>(random) / 2147483647.0;
  }
  Vector x, v;
  for (std::size_t k = 0; k < 3; ++k) {
    x[k] = 1.2 * (static_cast<double>(site[k]) + (0.4 + 0.2 * u[3 + k]));
    v[k] = 2 * u[6 + k] - 1;
  }
  v[0] += site[1] < sites / 2 ? 1 : -1;
  s.id.push_back(id);
  s.x.push_back(x);
  s.v.push_back(v);
}

// The forces of i and j, whose id is the higher one.
void touch(Spheres& s, std::size_t i, std::size_t j) {
  const Vector d = {s.x[j][0] - s.x[i][0], s.x[j][1] - s.x[i][1], s.x[j][2] - s.x[i][2]};
  const Vector w = {s.v[i][0] - s.v[j][0], s.v[i][1] - s.v[j][1], s.v[i][2] - s.v[j][2]};
  const double q = (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2], r = std::sqrt(q);
  if (q >= D * D || q == 0) return;
  const double closing = (w[0] * d[0] + w[1] * d[1]) + w[2] * d[2];
  const double g = (K * (D - r) + C * closing / r) / r;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto force = static_cast<std::int64_t>(std::floor(g * d[k] * U + 0.5));
    s.f[j][k] += force;
    s.f[i][k] -= force;
  }
}

// Forces of all spheres and ghosts, by pairs of which one at least is among the first `mine`. What touches is in cells
// next to each other, as these are somewhat wider than D.
void forces(Spheres& s, std::size_t mine) {
  s.f.assign(s.x.size(), Force{});
  if (s.x.empty()) return;
  Vector lo = s.x[0], hi = s.x[0];
  for (const Vector& x : s.x)
    for (std::size_t k = 0; k < 3; ++k) {
      lo[k] = std::min(lo[k], x[k]);
      hi[k] = std::max(hi[k], x[k]);
    }
  const auto along = [&](double x, std::size_t k) { return static_cast<std::int64_t>((x - lo[k]) / (1.01 * D)) + 1; };
  const std::int64_t ny = along(hi[1], 1) + 2, nz = along(hi[2], 2) + 2;  // with an empty one at each end
  std::vector<std::vector<std::size_t>> cells(static_cast<std::size_t>((along(hi[0], 0) + 2) * ny * nz));
  const auto cell = [&](const Vector& x) { return (along(x[0], 0) * ny + along(x[1], 1)) * nz + along(x[2], 2); };
  for (std::size_t i = 0; i < s.x.size(); ++i) cells[static_cast<std::size_t>(cell(s.x[i]))].push_back(i);
  for (std::size_t i = 0; i < mine; ++i)
    for (int k = 0; k < 27; ++k)
      for (const std::size_t j :
           cells[static_cast<std::size_t>(cell(s.x[i]) + ((k / 9 - 1) * ny + k / 3 % 3 - 1) * nz + k % 3 - 1)])
        if (s.id[i] < s.id[j]) touch(s, i, j);
}

void advance(Spheres& s, std::size_t mine) {
  for (std::size_t i = 0; i < mine; ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      s.v[i][k] += dt * (static_cast<double>(s.f[i][k]) / U);
      s.x[i][k] += dt * s.v[i][k];
    }
}

// ---- the coupling ----

struct Options {
  std::int64_t particles = 500, pushes = 50, push_every = 10, parts = 0;  // parts 0: one a process
  double reach = 0;  // how far a sphere may move, along an axis, between two pushes; 0: by default
  std::string scene = "spheres", endpoint, trajectory, positions = "every-step";
};

void check_reach(MPI_Comm comm, const Spheres& s, double reach) {
  std::int64_t far = INT64_MAX;
  for (std::size_t i = 0; i < s.x0.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k)
      if (!(std::abs(s.x[i][k] - s.x0[i][k]) <= reach)) far = std::min(far, s.id[i]);
  MPI_Allreduce(MPI_IN_PLACE, &far, 1, MPI_INT64_T, MPI_MIN, comm);
  if (far < INT64_MAX)
    throw rcbd::Error(RCBD_ABORTED,
                      "sphere " + std::to_string(far) + " has moved by more than " + std::to_string(reach) +
                          " since the last push, so the halo may lack spheres that it touches",
                      "push more often (--push-every), or give a greater --reach");
}

// Pushes my spheres and hands over those that leave. Returns whether there are new cuts.
bool push(MPI_Comm comm, const rcbd::Scene& scene, Spheres& s, const rcbd::Box& box) {
  rcbd::mpi::together(comm, [&] { rcbd::wrap(s.x, box.lo, box.hi); });
  rcbd::StepOptions options;
  options.ids = s.id;
  const rcbd::Step step = rcbd::mpi::step(comm, scene, s.x, options);
  rcbd::mpi::Moves(comm, step, s.id.size()).move(s.id, s.x, s.v);
  s.x0 = s.x;
  return step.report().repartitioned != 0;
}

// From a push until the next one.
void move_on(MPI_Comm comm, const rcbd::Scene& scene, Spheres& s, const Options& o, const rcbd::Box& box) {
  const std::size_t mine = s.id.size();
  rcbd::Near near;
  // A sphere of another process and one of mine may both move by the reach, towards each other. The millionth more is
  // for what is lost in rounding.
  near.width = 1.000001 * (D + 2 * o.reach);
  near.periodic = box;
  rcbd::AskOptions ask;
  ask.ids = s.id;
  const rcbd::mpi::Halo halo(comm, scene, s.x, near, ask);
  halo.forward(s.id);
  for (std::int64_t step = 0; step < o.push_every; ++step) {
    if (step > 0) check_reach(comm, s, o.reach);
    halo.forward(rcbd::mpi::positions(s.x), s.v);
    forces(s, mine);
    halo.reverse_add(s.f);
    advance(s, mine);
  }
  s.id.resize(mine);
  s.x.resize(mine);
  s.v.resize(mine);
}

// Of doubles [pushes][particles][3] those of my spheres, after so many others.
void write(MPI_Comm comm, const std::string& path, const Spheres& s, std::int64_t before) {
  rcbd::mpi::together(comm, [&] {
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    for (std::size_t i = 0; i < s.x.size(); ++i)
      file.seekp(24 * (before + s.id[i])).write(reinterpret_cast<const char*>(s.x[i].data()), 24);
    if (!file.flush()) throw rcbd::Error(RCBD_IO_ERROR, "the trajectory can't be written", path);
  });
}

void run(const Options& given, MPI_Comm comm) {
  Options o = given;
  int rank = 0, size = 1;
  MPI_Comm_rank(comm, &rank);
  MPI_Comm_size(comm, &size);
  std::int64_t sites = 4, repartitioned = 0;
  while (sites * sites * sites < 2 * o.particles) ++sites;
  const double side = 1.2 * static_cast<double>(sites);
  const rcbd::Box box{{0, 0, 0}, {side, side, side}};
  if (o.reach == 0) o.reach = 6 * dt * static_cast<double>(o.push_every);  // the fastest begin with 2 along an axis
  if (!(2 * 1.000001 * (D + 2 * o.reach) < side))
    throw rcbd::Error(RCBD_INVALID_ARGUMENT,
                      "the halo is as wide as half of the box, so a sphere could meet two images of another",
                      "take a smaller --reach or --push-every, or more --particles");
  rcbd::SceneOptions options;
  options.parts = o.parts > 0 ? static_cast<int>(o.parts) : size;
  options.tolerance = 0.05;
  options.positions = o.positions;
  options.replace = true;
  const rcbd::Client client = rcbd::mpi::connect(comm, o.endpoint);
  const rcbd::Scene scene = rcbd::mpi::scene_open(comm, client, o.scene, options);
  if (rank == 0 && !o.trajectory.empty()) std::ofstream{o.trajectory};  // empty, before the first push ends
  Spheres s;
  for (std::int64_t id = o.particles * rank / size; id < o.particles * (rank + 1) / size; ++id) place(s, id, sites);
  for (std::int64_t k = 0; k < o.pushes; ++k) {
    repartitioned += push(comm, scene, s, box);
    if (!o.trajectory.empty()) write(comm, o.trajectory, s, k * o.particles);
    move_on(comm, scene, s, o, box);
  }
  if (rank == 0)
    std::printf("pushes %" PRId64 "\nrepartitioned %" PRId64 "\ncuts %016" PRIx64 "\n", o.pushes, repartitioned,
                scene.cuts().hash());
}

[[noreturn]] void usage(std::FILE* to, int code) {
  std::fputs(
      "dem_cpp: soft spheres in a periodic box, on the processes of mpirun\n"
      "    [--particles N] [--pushes N] [--push-every TIME_STEPS] [--parts N] [--reach R] [--when-needed]\n"
      "    [--scene NAME] [--endpoint E] [--trajectory FILE] [--help]\n",
      to);
  std::exit(code);
}

Options options_of(int count, char** words) {
  Options o;
  const std::map<std::string, std::string*> texts = {
      {"--scene", &o.scene}, {"--endpoint", &o.endpoint}, {"--trajectory", &o.trajectory}};
  const std::map<std::string, std::int64_t*> numbers = {
      {"--particles", &o.particles}, {"--pushes", &o.pushes}, {"--push-every", &o.push_every}, {"--parts", &o.parts}};
  for (int k = 1; k < count; ++k) {
    const std::string name = words[k];
    if (name == "--help") usage(stdout, 0);
    const std::string value = name != "--when-needed" && k + 1 < count ? words[++k] : "";
    char* end = nullptr;
    const double number = std::strtod(value.c_str(), &end);
    const bool well = !value.empty() && *end == 0 && number < 1e9 && number >= (name == "--parts" ? 0 : 1e-9);
    if (name == "--when-needed")
      o.positions = "when-needed";
    else if (texts.count(name) && !value.empty())
      *texts.at(name) = value;
    else if (name == "--reach" && well)
      o.reach = number;
    else if (numbers.count(name) && well && number == std::floor(number))
      *numbers.at(name) = static_cast<std::int64_t>(number);
    else {
      std::fprintf(stderr, "dem_cpp: %s %s: a wrong option or value\n", name.c_str(), value.c_str());
      usage(stderr, 2);
    }
  }
  return o;
}

int main(int count, char** words) {
  const Options options = options_of(count, words);
  MPI_Init(&count, &words);
  try {
    run(options, MPI_COMM_WORLD);
  } catch (const rcbd::Error& error) {
    std::fprintf(stderr, "dem_cpp: %s; %s\n", error.what(), error.hint().c_str());
    MPI_Abort(MPI_COMM_WORLD, 1);
  }
  MPI_Finalize();
}
