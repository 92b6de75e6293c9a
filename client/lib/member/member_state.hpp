// MemberScene::State: a member's seat and what it knows of its scene. member.cpp takes the seat and makes the steps,
// member_push.cpp pushes, member_answer.cpp reads the answers.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/member.hpp"
#include "client/lib/member/member_places.hpp"
#include "client/lib/scene/changes.hpp"
#include "client/lib/scene/client_state.hpp"
#include "client/lib/scene/count_step.hpp"
#include "client/lib/scene/scene_cuts.hpp"
#include "client/lib/session/shared_arrays.hpp"
#include "client/lib/session/unanswered.hpp"

namespace rcb::client {

// Of an answer that isn't as the protocol says.
inline Status odd_member_answer(const std::string& why) {
  return {Code::protocol_error, fmt::format("answer to a member: {}", why),
          "use a client and a service of the same version"};
}

struct MemberScene::State {
  State(std::shared_ptr<Client::State> of, std::string scene, const MemberOptions& terms)
      : client(std::move(of)), name(std::move(scene)), options(terms), run(client->run_of(name)) {
    client->seats.insert(name);
  }

  ~State() {
    client->seats.erase(client->seats.find(name));
    if (connection_held()) arrays.unshare(session(), Deadline(kCloseSeconds));
    if (connection_held())
      static_cast<void>(session().call_once({{"command", "scene.close"}, {"scene", name}}, Retry(kCloseSeconds)));
  }

  Session& session() const { return *client->session; }
  bool connection_held() const { return session().connected() && connection == session().generation(); }

  Status open();
  // Forgets the scene if this client has created another one in its place.
  void forget_if_replaced();
  int dims_now() {
    forget_if_replaced();
    return dims;
  }
  // Takes the seat on the current connection, unless it is held already.
  Status take_seat(const Retry& retry);
  Status check(const Positions& positions, std::span<const std::int64_t> ids, const MemberStepOptions& step) const;
  // Whether to push directly to the ranks. All members decide alike, unless their Path options differ.
  Result<bool> wants_direct(const Deadline& deadline) const;
  // One attempt to push a step.
  Result<MemberStep> try_step(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                              const MemberStepOptions& with, const Retry& retry);
  // Whether this member can count the step; if all can, none pushes.
  bool can_count(const MemberStepOptions& with) const;
  // The answer to the count that commits the step; none: its particles are to be pushed. What is wrong with them is
  // told to the other members.
  Result<std::optional<Frame>> count(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                                     const MemberStepOptions& with, const Retry& retry);
  Result<Frame> push(const Positions& positions, std::span<const std::int64_t> ids, std::int64_t step,
                     const MemberStepOptions& with, const Retry& retry);
  // Brings ranks that hold none this member's particles, as the other members do. Errors: base_lost (no weights).
  Status refill(const Positions& positions, std::span<const std::int64_t> ids, const MemberStepOptions& with,
                const Retry& retry);
  // Of a step that the service has committed, as it says. It is answered by the report alone.
  Result<Frame> ask_for_answer(std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  // Whether few positions would be copied for nothing if the ranks on this machine read them from shared memory. rows:
  // by rank, of all particles, here and below.
  bool mostly_here(const std::vector<std::vector<std::uint64_t>>& rows, const Positions& positions) const;
  // By the sockets of the ranks, or from memory that is shared with them.
  Result<Frame> push_to_ranks(wire::Json begin, const std::vector<std::vector<std::uint64_t>>& rows,
                              const Positions& positions, const MemberStepOptions& with, const std::string& what,
                              const Retry& retry);
  Result<Frame> push_by_sockets(wire::Json begin, std::uint64_t request, const EditFrames& edits,
                                const std::vector<std::vector<std::uint64_t>>& rows, const Positions& positions,
                                const MemberStepOptions& with, const std::string& what, const Deadline& deadline);
  static std::uint64_t content_of(const Positions& positions, std::span<const std::int64_t> ids,
                                  const MemberStepOptions& with);
  // Asks whether the unanswered step of an earlier call was committed; true if so, and its answer is needed.
  Result<bool> needs_unanswered(const Retry& retry);
  // The rows that moved; nullopt: all are to be sent.
  std::optional<std::span<const std::uint64_t>> moved_rows(const MemberStepOptions& with) const;
  Result<MemberStep> read(const Frame& answer, const Positions& positions, std::span<const std::int64_t> ids,
                          std::int64_t step, const MemberStepOptions& with, const Retry& retry);
  bool uses_cuts(const MemberStepOptions& with) const { return scene_cuts.wanted || options.follow || with.want_parts; }
  // Fills in `parts` and `leaving` by the cuts after the step.
  Status classify(const Positions& positions, std::span<const std::int64_t> ids, const MemberStepOptions& with,
                  MemberStep& result) const;
  // Keeps the places of the particles if the answer tells all of them. left: what went, or is to be handed over.
  Status read_places(const Frame& answer, const wire::Json& json, std::vector<std::int64_t> left);

  std::shared_ptr<Client::State> client;
  std::string name;
  MemberOptions options;
  std::uint64_t run;             // Client::State::runs
  std::uint64_t connection = 0;  // the one that holds the seat
  std::uint64_t seat = 0;        // generation of the seat; 0: never had it
  std::uint64_t asked = 0;       // the last generation asked for
  int dims = 3;
  std::uint64_t n = 0;  // particles of the scene; 0: not known yet
  bool weights = false;
  std::string incarnation;
  bool filled = true;  // the ranks hold the scene's particles, if it has any
  std::optional<std::int64_t> last_step;
  UnansweredStep unanswered;
  std::uint64_t epoch = 0;  // after last_step
  SceneCuts scene_cuts;
  bool when_needed = false;  // positions travel when needed
  CountStep counting;
  // Whether this object was told of the last step and of the cuts. If not, it can't name a step as the base of its
  // push, and brings all its particles.
  bool up_to_date = false;
  // After last_step, with follow:
  MemberPlaces places;
  wire::Json plan;
  bool pushing_directly = false;  // path of the current push
  bool pushing_few = false;       // particles, or none
  bool send_all = false;          // whatever has moved, in the current step
  SharedArrays arrays;
  bool share_unsupported = false;  // a rank, or this kernel, refused it
};

}  // namespace rcb::client
