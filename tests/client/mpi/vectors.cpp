// rcbd/mpi.hpp: what it adds to mpi.h, which are vectors and exceptions. mpi_vectors ENDPOINT.
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include <rcbd/mpi.hpp>

namespace {

int rank = 0, size = 1;

void ensure(bool right, const std::string& what) {
  if (right) return;
  std::fprintf(stderr, "process %d of %d: wrong: %s\n", rank, size, what.c_str());
  MPI_Abort(MPI_COMM_WORLD, 1);
}

template <typename Call>
void fails(Call call, int code, const std::string& message) {
  try {
    call();
  } catch (const rcbd::Error& error) {
    ensure(error.code() == code && error.message().find(message) != std::string::npos, error.what());
    return;
  }
  ensure(false, "not thrown: " + message);
}

void check_together() {
  const int last = size - 1;
  ensure(rcbd::mpi::together(MPI_COMM_WORLD, [] { return 7; }) == 7, "what was computed");
  rcbd::mpi::together(MPI_COMM_WORLD, [] {});
  const std::string by = "process " + std::to_string(last) + ": ";
  fails(
      [&] {
        rcbd::mpi::together(MPI_COMM_WORLD, [&] {
          return rank == last ? throw rcbd::Error(RCBD_IO_ERROR, "disk full", "buy one") : 1;
        });
      },
      RCBD_IO_ERROR, by + "disk full");
  fails(
      [&] { rcbd::mpi::together(MPI_COMM_WORLD, [&] { return rank == last ? throw std::runtime_error("odd") : 1; }); },
      RCBD_INTERNAL, by + "odd");
  fails(
      [&] {
        rcbd::mpi::together(MPI_COMM_WORLD, [&] {
          if (rank == last) throw 7;
        });
      },
      RCBD_INTERNAL, by + "an exception");
  fails([&] { rcbd::mpi::connect(MPI_COMM_WORLD, rank == last ? "unix:/nowhere/s" : ""); }, RCBD_UNAVAILABLE, by);
}

// Every particle has flat arrays of all kinds; some processes have none at first.
void check_arrays(const rcbd::Scene& scene) {
  std::vector<std::int64_t> id;
  std::vector<double> x;
  std::vector<float> weight;
  std::vector<std::array<std::uint8_t, 3>> colour;
  for (int k = rank == 0 ? 0 : 300; k < 300; ++k) {
    id.push_back(k);
    for (int a = 1; a <= 3; ++a) x.push_back(k * 0.618 * a - static_cast<int>(k * 0.618 * a));
    weight.insert(weight.end(), {1.f, static_cast<float>(k)});
    colour.push_back({{static_cast<std::uint8_t>(k % 256), 1, 2}});
  }
  rcbd::StepOptions options;
  options.ids = id;
  const rcbd::Step step = rcbd::mpi::step(MPI_COMM_WORLD, scene, x, options);
  const rcbd::mpi::Moves moves(MPI_COMM_WORLD, step, id.size());
  std::vector<int> longer(id.size() + 1);
  fails([&] { moves.move(id, longer); }, RCBD_INVALID_ARGUMENT,
        "where there are " + std::to_string(id.size()) + " rows");
  moves.move(rcbd::mpi::columns(x, 3), id, rcbd::mpi::columns(weight, 2), colour);
  const std::size_t n = moves.rows();
  ensure(id.size() == n && x.size() == 3 * n && weight.size() == 2 * n && colour.size() == n, "sizes");
  ensure(n > 0 && n < 300, "each has some");

  rcbd::Near near;
  near.width = 0.1;
  near.periodic.lo = {{0, 0, 0}};
  near.periodic.hi = {{1, 1, 1}};
  rcbd::AskOptions ask;
  std::vector<std::int64_t> short_one(rank == size - 1 ? n - 1 : n);
  ask.ids = short_one;
  fails([&] { rcbd::mpi::Halo(MPI_COMM_WORLD, scene, x, near, ask); }, RCBD_INVALID_ARGUMENT,
        "process " + std::to_string(size - 1) + ": ");
  ask.ids = id;
  std::vector<double> odd(3 * n + (rank == size - 1));
  fails([&] { rcbd::mpi::Halo(MPI_COMM_WORLD, scene, odd, near, ask); }, RCBD_INVALID_ARGUMENT,
        "process " + std::to_string(size - 1) + ": " + std::to_string(3 * n + 1) + " numbers");
  rcbd::mpi::Halo(MPI_COMM_WORLD, scene.cuts(), x, near, ask);
  const rcbd::mpi::Halo halo(MPI_COMM_WORLD, scene, x, near, ask);
  const std::size_t all = halo.rows() + halo.ghosts();
  ensure(halo.rows() == n && halo.ghosts() > 0, "ghosts");
  halo.forward(id, rcbd::mpi::positions(x), rcbd::mpi::columns(weight, 2), colour);
  halo.forward(rcbd::mpi::positions(x));
  ensure(id.size() == all && x.size() == 3 * all && colour.size() == all, "room for ghosts");
  std::vector<std::int32_t> sum(all, 0);
  for (std::size_t i = 0; i < all; ++i) {
    const auto k = static_cast<int>(id[i]);
    ensure(weight[2 * i + 1] == static_cast<float>(k) && colour[i][0] == k % 256, "a row");
    for (std::size_t a = 0; a < 3; ++a) {
      const double home =
          k * 0.618 * static_cast<double>(a + 1) - static_cast<int>(k * 0.618 * static_cast<double>(a + 1));
      const double there = x[3 * i + a];
      ensure(there == home || (i >= n && (there == home + 1 || there == home - 1)), "a position");
    }
    if (i >= n) sum[i] = 1;
  }
  halo.reverse_add(sum);
  std::int64_t mine = 0, ghosts = static_cast<std::int64_t>(halo.ghosts()), total[2] = {0, 0};
  for (std::size_t i = 0; i < n; ++i) mine += sum[i];
  const std::int64_t both[] = {mine, ghosts};
  MPI_Allreduce(both, total, 2, MPI_INT64_T, MPI_SUM, MPI_COMM_WORLD);
  ensure(total[0] == total[1], "each ghost counts for one row");
  x.resize(3 * n - 3);
  fails([&] { halo.forward(rcbd::mpi::positions(x)); }, RCBD_INVALID_ARGUMENT,
        "where there are " + std::to_string(n) + " rows");
}

void check_numbers_that_are_no_positions(const rcbd::Scene& scene) {
  const std::vector<double> x(rank == size - 1 ? 301 : 300);
  std::vector<std::int64_t> id;
  for (std::int64_t k = 0; k < 100; ++k) id.push_back(100 * rank + k);
  rcbd::StepOptions options;
  options.ids = id;
  fails([&] { rcbd::mpi::step(MPI_COMM_WORLD, scene, x, options); }, RCBD_INVALID_ARGUMENT,
        "process " + std::to_string(size - 1) + ": 301 numbers are no positions");
}

// It closes its scene, so that the other processes do not wait.
void check_a_step_that_fails(const rcbd::Scene& scene) {
  const std::vector<double> x(3, rank == 0 ? NAN : 0);
  const std::vector<std::int64_t> id(1, rank);
  rcbd::StepOptions options;
  options.ids = id;
  fails([&] { rcbd::mpi::step(MPI_COMM_WORLD, scene, x, options); }, RCBD_NOT_FINITE, "process 0: ");
}

}  // namespace

int main(int count, char** words) {
  MPI_Init(&count, &words);
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &size);
  check_together();
  {
    const auto client = rcbd::mpi::connect(MPI_COMM_WORLD, words[1]);
    rcbd::SceneOptions options;
    options.parts = 2 * size;
    options.replace = true;
    check_arrays(rcbd::mpi::scene_open(MPI_COMM_WORLD, client, "vectors", options));
    check_numbers_that_are_no_positions(rcbd::mpi::scene_open(MPI_COMM_WORLD, client, "vectors", options));
    check_a_step_that_fails(rcbd::mpi::scene_open(MPI_COMM_WORLD, client, "vectors", options));
  }
  MPI_Finalize();
}
