// MpiCores: the processes of an MPI job as the cores that share one run of the material point method.
//
// Invariants
// 1. Two processes exchange only the nodes that the points of both may reach, directly with each other.
// 2. Every process sums a node's values in the order of the ranks, so that all get the same bits.
// 3. Processor time is that of the calling thread. Waiting for other processes is none: see computing().
//
// Every method is collective over the communicator.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <mpi.h>

#include "client/lib/client.hpp"
#include "client/solvers/mpm/mpm.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

// What a process did in a step.
struct Work {
  double wall = 0;          // s, of the whole step
  double service = 0;       // s of it in Scene::step
  double computing = 0;     // s of processor time
  double shared_nodes = 0;  // of the grid, reached by points here and of another process: once for each such process
  double grid_bytes = 0;    // sent to other processes, in all substeps
  double handed_over = 0;   // points
};

class MpiCores final : public OtherCores {
 public:
  explicit MpiCores(MPI_Comm comm);
  int rank() const { return rank_; }
  int size() const { return size_; }

  Result<double> signal_speed(const Mpm& mpm, const Result<double>& mine) override;
  void sum_grid(Mpm& mpm) override;
  Status agree(const Status& mine) override;

  // Processor time of this thread so far, less what it spent in MPI: that waits by asking again and again.
  double computing() const;
  // Of the step; the caller clears it, and fills in the seconds.
  Work& work() { return work_; }

  // Sends the leaving points with their whole state, and adds those that the others send.
  void hand_over(Mpm& mpm, std::span<const client::LeavingRow> leaving);
  // Returns on rank 0 all points' positions in the order of their ids, (points, 3).
  std::vector<double> gather_positions(const Mpm& mpm, std::uint64_t points);
  Balance sum(const Balance& mine);
  std::vector<Work> sum(std::vector<Work> mine);          // step by step, value by value
  std::vector<Work> largest(std::vector<Work> mine);      // likewise
  std::vector<std::uint64_t> gather(std::uint64_t mine);  // on every rank

 private:
  template <typename Call>
  void in_mpi(const Call& call);
  std::vector<Work> reduce(std::vector<Work> mine, MPI_Op op);

  MPI_Comm comm_;
  int rank_ = 0;
  int size_ = 1;
  double seconds_in_mpi_ = 0;
  Work work_;
};

}  // namespace rcb::solvers
