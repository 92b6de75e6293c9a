// MpiCores: the processes of an MPI job as the cores that share one run of the material point method.
//
// Invariants
// 1. Two processes exchange only the nodes that the points of both may reach, directly with each other.
// 2. Every process sums a node's values in the order of the ranks, so that all get the same bits.
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

class MpiCores final : public OtherCores {
 public:
  explicit MpiCores(MPI_Comm comm);
  int rank() const { return rank_; }
  int size() const { return size_; }

  Result<double> signal_speed(const Mpm& mpm, const Result<double>& mine) override;
  void sum_grid(Mpm& mpm) override;
  Status agree(const Status& mine) override;

  // Sends the leaving points with their whole state, and adds those that the others send.
  void hand_over(Mpm& mpm, std::span<const client::LeavingRow> leaving);
  // Returns on rank 0 all points' positions in the order of their ids, (points, 3).
  std::vector<double> gather_positions(const Mpm& mpm, std::uint64_t points);
  Balance sum(const Balance& mine);
  double largest(double mine);
  std::vector<std::uint64_t> gather(std::uint64_t mine);  // on every rank

 private:
  MPI_Comm comm_;
  int rank_ = 0;
  int size_ = 1;
};

}  // namespace rcb::solvers
