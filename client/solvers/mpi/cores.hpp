// MpiCores: the processes of an MPI job as the cores that share one material point run.
//
// Invariants
// 1. Only nodes that two processes' points may reach are exchanged, straight between the two.
// 2. A node's value is added up in the order of the ranks on every process, so that all have the same bits.
// Every method is collective over the communicator.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <mpi.h>

#include "client/lib/member.hpp"
#include "client/solvers/mpm.hpp"
#include "common/base/status.hpp"

namespace rcb::solvers {

class MpiCores final : public OtherCores {
 public:
  explicit MpiCores(MPI_Comm comm);
  int rank() const { return rank_; }
  int size() const { return size_; }

  Result<double> fastest(const Mpm& mpm, const Result<double>& mine) override;
  void sum_grid(Mpm& mpm) override;
  Status agree(const Status& mine) override;

  // Sends the points that leave and takes in those that enter, whole. Errors, the same everywhere: the lists don't fit
  // the points or one another.
  Status hand_over(Mpm& mpm, std::span<const client::Leaving> leave, std::span<const client::Entering> enter);
  // All points' positions by id, (points, 3), on rank 0.
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
