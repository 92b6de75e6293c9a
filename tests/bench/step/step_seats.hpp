// The seats of a parallel solver, a thread each with its own connection, for rcb_bench step.
//
// What is timed is from the moment when all are ready to push until the last one has its answer. Handing particles over
// between steps, as the answers say, is the solver's own.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "client/lib/client.hpp"

namespace rcb::bench {

class SeatTeam {
 public:
  // axes: those of all particles, by row, in two phases; they outlive the team.
  SeatTeam(const std::array<std::vector<double>, 3> (&axes)[2], int dims, int seats);
  ~SeatTeam();
  SeatTeam(SeatTeam&&) noexcept;

  // The scene is there. Each seat has a block of rows at first.
  Status open(const std::string& endpoint, const std::string& scene, client::Path path);
  // The seconds of one step.
  Result<double> step(int phase, client::StepReport& report);

 private:
  struct Seat;
  const std::array<std::vector<double>, 3> (&axes_)[2];
  int dims_;
  std::vector<std::unique_ptr<Seat>> seats_;
};

}  // namespace rcb::bench
