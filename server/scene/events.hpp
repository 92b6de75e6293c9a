// What orders have done to scenes, as the ranks tell rank 0's ledger.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "common/partition/balance/load.hpp"
#include "server/scene/count.hpp"
#include "server/scene/options.hpp"
#include "server/scene/report.hpp"

namespace rcb::scene {

// What the ranks hold of a scene, besides its particles; the same on all of them.
struct Held {
  std::uint64_t n = 0;
  bool weights = false;
  bool ids = false;                                     // of positions_step: given by the solver; else 0..n-1
  std::uint64_t epoch = 0;                              // 0: no cuts yet
  std::uint64_t hash = 0;                               // of the cuts
  std::shared_ptr<const cuts::CutTree> tree;            // null: no cuts yet
  std::shared_ptr<const partition::LoadSummary> loads;  // null: no cuts yet
  std::optional<std::uint64_t> id_sum;                  // of mix64(id), mod 2^64; none: not known
  std::uint64_t search_rounds = 0;                      // of the search for the current cuts
  std::uint64_t search_reductions = 0;
};

struct Created {
  SceneOptions options;
  Held held;
};

struct Stepped {
  StepReport report;
  Held held;
  std::vector<std::uint64_t> sessions;   // of those that pushed, one a seat: session_key() of each
  std::optional<double> step_seconds;    // as the push said
  std::optional<std::uint64_t> drifted;  // since the step before, as the push said
  bool wasted = false;                   // new cuts were searched, and not adopted
};

struct Rebalanced {
  SceneOptions options;
  Held held;
};

struct Dropped {};

// A query was answered for which the ranks passed over the particles.
struct Asked {
  std::string command;
};

struct Change {
  std::string scene;
  std::variant<Created, Stepped, Rebalanced, Dropped, Asked> event;
};

}  // namespace rcb::scene
