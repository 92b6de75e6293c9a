#include "tests/bench/stress/stress_worker.hpp"

#include <fstream>

#include <fmt/format.h>

#include "common/base/random.hpp"
#include "tests/bench/json.hpp"
#include "tests/bench/measure.hpp"
#include "tests/bench/plan.hpp"
#include "tests/bench/stress/stress_scenes.hpp"
#include "tests/bench/worker.hpp"

namespace rcb::bench {
namespace {

// The same for the same parts of the same particles, however they are dealt to ranks. Collective.
std::uint64_t checksum(comm::Comm& comm, const Problem& problem, const Answer& answer) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < answer.part.size(); ++i)
    sum +=
        mix64(mix64(static_cast<std::uint64_t>(problem.particles.id[i])) + static_cast<std::uint32_t>(answer.part[i]));
  comm.all_sum({&sum, 1});
  return sum;
}

// Particles whose owner, as the tool itself says, isn't the part that it gave them. Collective.
Json strangers(comm::Comm& comm, Contender& contender, const Answer& answer) {
  const auto owners = contender.owners();
  std::uint64_t count = 0;
  if (owners)
    for (std::size_t i = 0; i < answer.part.size(); ++i)
      count += static_cast<std::uint64_t>((*owners)[i] != answer.part[i]);
  comm.all_sum({&count, 1});
  return owners ? Json(count) : Json();
}

// Collective.
Json answer_cell(comm::Comm& comm, const Problem& problem, const Contenders& contenders) {
  const std::vector<Measurement> measured = measure(comm, problem, contenders, {1, false});
  if (measured.empty()) return {{"failure", "not a problem for this tool"}};
  const Measurement& result = measured.front();
  if (!comm::agree(comm, result.failure.empty()))
    return {{"failure", result.failure.empty() ? "failed on another rank" : result.failure}};
  Contender& contender = *contenders.front();
  contender.reset();
  if (!comm::agree(comm, contender.run().ok())) return {{"failure", "failed when run once more"}};
  const Answer answer = contender.answer();
  Json row{{"error", result.error}, {"empty_parts", result.empty_parts}};
  row["assignment"] = fmt::format("{:016x}", checksum(comm, problem, answer));
  row["owner_differs"] = strangers(comm, contender, answer);
  if (answer.hash) row["hash"] = fmt::format("{:016x}", *answer.hash);
  if (answer.cost) {
    row["rounds"] = answer.cost->rounds;
    row["reductions"] = answer.cost->reductions;
  }
  return row;
}

// Collective.
Status answer_cells(comm::Comm& comm, const Plan& plan, const std::string& rows_path) {
  std::ofstream rows;
  if (comm.rank() == 0) rows.open(rows_path);
  if (!comm::agree(comm, !rows.fail())) return {Code::io_error, rows_path + ": can't be written"};
  const auto rank = static_cast<std::uint64_t>(comm.rank());
  const auto ranks = static_cast<std::uint64_t>(comm.size());
  Wish wish = plan.wish;
  wish.owners = true;
  for (std::size_t c = 0; c < plan.cells.size(); ++c) {
    const Cell& cell = plan.cells[c];
    const StressScene* scene = find_stress_scene(cell.scene);
    if (scene == nullptr) return {Code::not_found, "no scene " + cell.scene};
    if (comm.rank() == 0) rows << Json{{"begun", c}} << std::endl;
    const particles::ParticleSet points =
        make_stress_rows(*scene, cell.n, cell.n * rank / ranks, cell.n * (rank + 1) / ranks);
    const Contenders contenders = make_contenders(comm, wish);
    if (contenders.empty()) return {Code::unsupported, "this build has no " + wish.methods.front()};
    Json row = answer_cell(comm, Problem{points.view(), cell.n, cell.parts}, contenders);
    row["cell"] = c;
    row["tool"] = contenders.front()->setting().tool;
    if (comm.rank() == 0) rows << row << std::endl;
  }
  return {};
}

}  // namespace

int run_stress_worker(int argc, char** argv) { return run_as_rank(argc, argv, "rcb_stress", with_plan(answer_cells)); }

}  // namespace rcb::bench
