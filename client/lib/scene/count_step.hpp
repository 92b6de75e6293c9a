// CountStep: the part of each row that a Scene has, by the cuts that it knows: to push each row to the rank that owns
// its part, to tell the caller, and to step by counts where the ranks need no positions.
//
// Invariants
// 1. A step's rows are counted once by the same cuts, however often the step is tried.
// 2. The parts are those of step_, whose rows were the same; while there is none, they are but a hint.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/client.hpp"
#include "client/lib/scene/scene_cuts.hpp"
#include "client/lib/session/session.hpp"
#include "common/cuts/count.hpp"
#include "common/cuts/id_sum.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// All rows of a step.
struct CountedRows {
  Positions positions;
  std::span<const std::int64_t> ids;  // empty: the row is the id
  cuts::IdSums id_sums;
  std::span<const double> weights;
  bool weighted = false;  // the scene has weights
  int threads = 1;
};

// Which step of which scene is counted.
struct CountCall {
  Session& session;
  const std::string& scene;
  const std::string& incarnation;
  std::int64_t step = 0;
  std::optional<std::int64_t> last_step;
  const StepOptions& options;
  bool of_seat = false;  // then the others wait, and are told what is wrong with the rows
};

class CountStep {
 public:
  // A step begins. others: its rows are of other particles, or in another order, than those of the step before.
  void begin(bool others);
  // Finds the parts of the rows, unless that has been done. last: the step before.
  Status find_parts(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last);
  // Whether the parts are those of the rows of this step by these cuts.
  bool holds(const cuts::Cuts& cuts) const { return found_ && parts_by_ == name_of(cuts); }
  std::span<const std::int32_t> parts() const { return part_; }
  // How many rows each part has.
  std::span<const std::uint64_t> counts() const { return count_.counts; }
  // Of the rows of this step; none where the parts before aren't known.
  std::optional<std::uint64_t> drifted() const { return found_ ? drifted_ : std::nullopt; }
  // Sends the count until it is judged: the answer that commits the step, or none if its positions are to be pushed.
  // cuts: asked for where they aren't known, or are others.
  Result<std::optional<Answer>> ask(const CountCall& call, const CountedRows& rows, SceneCuts& cuts,
                                    const Retry& retry);
  void committed(std::int64_t step) { step_ = found_ ? std::optional(step) : std::nullopt; }

 private:
  struct Name {  // of cuts
    std::uint64_t epoch = 0;
    std::uint64_t hash = 0;
    bool operator==(const Name&) const = default;
  };
  static Name name_of(const cuts::Cuts& cuts) { return {cuts.epoch(), cuts.hash()}; }
  // One pass over the rows.
  Status pass(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last,
              cuts::CountOptions options);
  // Counts the rows, unless that has been done. scale: the one that the service asks for.
  Status count(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last,
               std::optional<int> scale);
  // What has been counted, as it travels.
  std::string record(const CountCall& call) const;

  std::vector<std::int32_t> part_;    // by row
  std::optional<std::int64_t> step_;  // whose parts these are
  std::optional<Name> parts_by_;      // the cuts of part_
  bool found_ = false;                // part_ is of the rows of the step that has begun
  bool counted_ = false;              // and so is count_, by the same cuts
  cuts::Count count_;
  bool weighted_ = false;
  std::optional<int> scale_;  // of the last loads
  bool scale_told_ = false;   // by the service: what the weights of these rows need doesn't tell
  std::optional<std::uint64_t> drifted_;
  std::optional<std::uint64_t> id_sum_;
};

}  // namespace rcb::client
