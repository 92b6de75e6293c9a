// What takes part in rcb_bench step: points that move, and for each variant a scene to which they are pushed.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/lib/client.hpp"
#include "common/base/random.hpp"
#include "tests/bench/scenes.hpp"
#include "tests/bench/step/step_seats.hpp"

namespace rcb::bench {

// every-step: the solver computes in arrays of the library, which the ranks read; every-step-copy: it keeps its own,
// which are copied into shared memory. sockets: straight to each rank; float32: the same in single precision. endpoint:
// through rank 0. connect: no step, but the time until a new client has been let in. every-step-members: a parallel
// solver's, with the particles of their parts, from shared memory; members-sockets and members-endpoint: the same by
// these ways. count: own rows of a scene whose positions travel when needed, so that none do; count-permuted: in a new
// order each step; count-weighted: with a weight for each particle; count-members: by seats. send: as every-step, of
// such a scene at the tolerance 0, so that each step is counted, then sends, and new cuts are found.
inline constexpr std::array kStepVariants{
    "count",           "count-permuted",   "count-weighted", "send",    "every-step",
    "every-step-copy", "sockets",          "endpoint",       "float32", "every-step-members",
    "members-sockets", "members-endpoint", "count-members",  "connect"};

bool is_count(const std::string& variant);
// The processes of a solver step together.
bool by_seats(const std::string& variant);
// Those of a single client's steps.
std::vector<std::string> usual_variants();

// Two sets of positions, in turn, so that every particle moves at every step.
struct MovingPoints {
  int dims = 3;
  std::size_t n = 0;
  std::array<std::vector<double>, 3> axes[2];
  std::vector<double> rows[2];
  std::vector<float> singles[2];  // rows

  // shuffled: neighbours in the arrays aren't neighbours in space.
  MovingPoints(const SceneKind& kind, std::size_t count, bool shuffled);

  // What a variant sends.
  std::size_t bytes_sent(const std::string& variant) const;
  // The positions that its client looks at.
  std::size_t bytes_read(const std::string& variant) const;
};

// One variant's scene, and its positions the way the variant has them.
class Pusher {
 public:
  Pusher(std::string variant, const MovingPoints& motion, int seats);

  Status open(const std::string& endpoint, int parts);
  int ranks() const { return client_->ranks(); }
  // The seconds of one step. Errors also: internal, if it went by another way than the variant's.
  Result<double> step(int phase, client::StepReport& report);

 private:
  client::Path path() const;
  Result<client::Positions> prepare(int phase);
  void permute(int phase);
  Result<double> step_alone(int phase, client::StepReport& report);
  Result<double> connect() const;

  std::string variant_;
  const MovingPoints& motion_;
  client::ConnectOptions connect_;
  Random random_{23};
  std::vector<double> rows_;       // of the count variants
  std::vector<std::int64_t> ids_;  // of their particles; empty: the rows' numbers
  std::vector<double> weights_;
  std::optional<client::Client> client_;
  std::optional<client::Scene> scene_;
  std::optional<SeatTeam> team_;  // instead
  bool first_ = true;
};

}  // namespace rcb::bench
