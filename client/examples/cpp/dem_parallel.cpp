// dem_parallel: the spheres of spheres.hpp on several processes, each with a seat of the scene. A process computes
// those of its own parts; at every time step it gets copies of others that may touch them, the halo.
#include <algorithm>
#include <cstdio>
#include <iterator>
#include <numeric>
#include <optional>

#include <mpi.h>

#include "client/examples/cpp/spheres.hpp"
#include "client/lib/client.hpp"

namespace rcb::examples {
namespace {

using Lists = std::vector<std::vector<std::uint64_t>>;  // rows, by process

// Whether all processes are well. Every process must ask before it goes into an MPI call with the others: else they
// wait there for one that has given up.
bool all_well(const Status& mine) {
  if (!mine) std::fprintf(stderr, "dem_parallel: %s; %s\n", mine.message().c_str(), mine.hint().c_str());
  int well = mine ? 1 : 0;
  MPI_Allreduce(MPI_IN_PLACE, &well, 1, MPI_INT, MPI_MIN, MPI_COMM_WORLD);
  return well == 1;
}

// Which of my spheres go to each process, and how many come from each. All processes make it together.
class Routes {
 public:
  explicit Routes(Lists rows) : rows_(std::move(rows)), coming_(rows_.size()) {
    std::vector<std::uint64_t> going;
    for (const auto& list : rows_) going.push_back(list.size());
    MPI_Alltoall(going.data(), 1, MPI_UINT64_T, coming_.data(), 1, MPI_UINT64_T, MPI_COMM_WORLD);
  }

  // Sends them, and gives those that come. Only processes that have something for each other talk.
  std::vector<Sphere> exchange(const std::vector<Sphere>& mine) const {
    std::vector<Sphere> going, come(std::accumulate(coming_.begin(), coming_.end(), std::uint64_t{0}));
    for (const auto& list : rows_)
      for (const std::uint64_t row : list) going.push_back(mine[row]);
    std::vector<MPI_Request> requests;
    const auto bytes = [](std::uint64_t count) { return static_cast<int>(count * sizeof(Sphere)); };
    for (std::size_t k = 0, to = 0, from = 0; k < rows_.size(); to += coming_[k], from += rows_[k].size(), ++k) {
      const int other = static_cast<int>(k);
      if (coming_[k] > 0)
        MPI_Irecv(&come[to], bytes(coming_[k]), MPI_BYTE, other, 0, MPI_COMM_WORLD, &requests.emplace_back());
      if (!rows_[k].empty())
        MPI_Isend(&going[from], bytes(rows_[k].size()), MPI_BYTE, other, 0, MPI_COMM_WORLD, &requests.emplace_back());
    }
    MPI_Waitall(static_cast<int>(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
    return come;
  }

 private:
  Lists rows_;
  std::vector<std::uint64_t> coming_;  // by process
};

struct Arrays {  // as the service takes them
  std::vector<std::int64_t> ids;
  std::vector<double> xyz;

  explicit Arrays(const std::vector<Sphere>& spheres) {
    for (const Sphere& one : spheres) {
      ids.push_back(one.id);
      xyz.insert(xyz.end(), one.x, one.x + 3);
    }
  }
};

// Pushes my spheres, hands over those that leave, and takes in those that others hand over.
bool push(client::Scene& scene, std::vector<Sphere>& mine, int size) {
  const Arrays arrays(mine);
  const auto told = scene.step(client::Positions::rows(arrays.xyz.data(), mine.size(), 3), {.ids = arrays.ids});
  if (!all_well(told.status())) return false;
  Lists leaving(static_cast<std::size_t>(size));
  for (const auto& one : told->leaving) leaving[static_cast<std::size_t>(one.to)].push_back(one.row);
  const std::vector<Sphere> entering = Routes(leaving).exchange(mine);
  for (const auto& one : told->leaving) mine[one.row].id = -1;
  std::erase_if(mine, [](const Sphere& one) { return one.id < 0; });
  mine.insert(mine.end(), entering.begin(), entering.end());
  return true;
}

// The routes by which halos go until the next push.
std::optional<Routes> halo_routes(client::Scene& scene, const std::vector<Sphere>& mine, const Options& options,
                                  int rank, int size) {
  const Arrays arrays(mine);
  // A sphere of another process and one of mine may both move by `reach` until then, towards each other. The millionth
  // more is for what is lost in rounding.
  const double width = 1.000001 * (kDiameter + 2 * options.reach), side = options.side();
  cuts::HaloOptions with{.near = {.width = width, .box = {{0, 0, 0}, {side, side, side}}}, .seats = size};
  with.ids = arrays.ids;
  const auto cuts = scene.cuts();
  const auto halo = cuts ? cuts->halo(cuts::Positions::rows(arrays.xyz.data(), mine.size(), 3), with)
                         : Result<cuts::Halo>(cuts.status());
  if (!all_well(halo.status())) return {};
  // difference() finds the nearest image by itself. So a sphere goes to a process once, however many of its images are
  // near, and none to its own process.
  Lists rows(static_cast<std::size_t>(size));
  for (int other = 0; other < size; ++other)
    if (const auto at = static_cast<std::size_t>(other); other != rank)
      std::ranges::unique_copy(halo->rows_for(at), std::back_inserter(rows[at]));
  return Routes(rows);
}

int run(const Options& options) {
  int rank = 0, size = 1;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &size);
  auto client = client::Client::connect({.endpoint = options.endpoint, .name = "dem_parallel"});
  Status made = client.status();
  const int parts = options.parts > 0 ? static_cast<int>(options.parts) : size;
  if (made && rank == 0)
    made = client->create_scene(options.scene, {.parts = parts, .tolerance = 0.05, .replace = true});
  if (!all_well(made)) return 1;  // a barrier, too: nobody opens the scene before it is there
  auto scene = client->open_scene(options.scene, {.seat = rank, .seats = size});
  if (!all_well(scene.status())) return 1;

  const auto share = [&](int process) { return options.particles * process / size; };
  std::vector<Sphere> mine = spheres_at_start(options, share(rank), share(rank + 1)), pushed;
  std::optional<Routes> routes;
  Tally tally;
  for (std::int64_t step = 0; step < options.steps; ++step) {
    if (step % options.push_every == 0) {
      if (!push(*scene, mine, size)) return 1;
      routes = halo_routes(*scene, mine, options, rank, size);
      if (!routes) return 1;
      pushed = mine;
    }
    if (!all_well(within_reach(pushed, mine, options))) return 1;
    advance(mine, routes->exchange(mine), options, step, tally);
  }
  Tally total;
  MPI_Reduce(&tally, &total, sizeof(Tally) / 8, MPI_UINT64_T, MPI_SUM, 0, MPI_COMM_WORLD);  // of 64-bit numbers alone
  if (rank == 0) print(options, total);
  return 0;
}

}  // namespace
}  // namespace rcb::examples

int main(int argc, char** argv) {
  const auto options = rcb::examples::options_of(argc, argv);
  MPI_Init(&argc, &argv);
  const int code = rcb::examples::run(options);
  MPI_Finalize();
  return code;
}
