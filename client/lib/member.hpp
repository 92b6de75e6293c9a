// A scene pushed by the processes of a parallel solver, each with the particles it has.
//
//   auto scene = rcb::client::MemberScene::open(client, "jet", {.member = rank, .members = size, .follow = true});
//   auto result = scene->step(rcb::client::Positions::axes(axes, n), ids);
//   // then, with follow: send the particles result->leave, and receive result->enter
//
// With follow, a member that has handed over as told pushes straight to the ranks, without ids: the library remembers
// where its particles stand, and pushes by ids where it isn't sure. It costs least where rows keep their order, but for
// those that leave and come. RCBD_PATH and ConnectOptions::path choose as for a Scene.
//
// A step returns when every member has pushed it and it is committed, or, at its deadline, with the name of the member
// that is missing; then the previous step stands and all may push again. The service decides alone: members need not
// talk to one another. Connections that are cut, and a service that dies and is started again, are outlived as by a
// Scene: whoever comes first makes the scene anew, all push by ids, and a member that had not heard of a step which was
// committed before gets its answer from the new service. A process that was started again opens the scene and goes on
// from the last step. Thread-safety: as a Client's. A Client has one MemberScene of a scene.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/lib/client.hpp"

namespace rcb::client {

struct MemberOptions {
  int member = 0;   // 0 .. members-1
  int members = 1;  // the same for all
  // Member k keeps the particles of the parts [floor(k P / members), floor((k+1) P / members)), and each step says what
  // it hands over. The same for all.
  bool follow = false;
  double deadline_seconds = 60;
};

struct MemberStepOptions {
  std::optional<std::int64_t> step;    // default: the scene's last step + 1, 0 at first
  std::span<const double> weights;     // [count]; empty: none, or unchanged. All members give them, or none
  std::optional<double> step_seconds;  // what this member computed since its last push
  // No particle has moved since this member's last step: nothing is sent where it would push straight to the ranks, and
  // without weights. Elsewhere the positions are sent all the same.
  bool unmoved = false;
  bool want_changes = false;  // fill MemberStep::changes
  double deadline_seconds = 60;
};

struct MemberChange {
  std::int64_t id;
  std::int32_t part;
};

struct Leaving {
  std::int64_t id;
  int to;  // member
};

struct Entering {
  std::int64_t id;
  int from;  // member
  std::int32_t part;
};

struct MemberStep {
  StepReport report;
  std::vector<MemberChange> changes;  // of the particles pushed here, those whose part changed; ascending id
  std::vector<Leaving> leave;         // with follow; ascending id
  std::vector<Entering> enter;        // with follow; ascending id
};

class MemberScene {
 public:
  // Takes the seat; the scene was created by create_scene(), by one of the members or somebody else.
  // Errors: busy (the seat is taken), invalid_argument (the others were told other numbers), not_found.
  static Result<MemberScene> open(Client& client, const std::string& name, const MemberOptions& options);
  MemberScene(MemberScene&&) noexcept;
  MemberScene& operator=(MemberScene&&) noexcept;
  ~MemberScene();  // gives the seat up

  // Pushes this member's particles, in any order. positions: count may be 0.
  //   ids  [count]; every id of the scene has one member
  // Errors: deadline_exceeded and aborted name the member that is to blame; base_lost: the service has lost the scene,
  // which had weights: push this step with weights.
  Result<MemberStep> step(const Positions& positions, std::span<const std::int64_t> ids,
                          const MemberStepOptions& options = {});
  std::optional<std::int64_t> last_step() const;
  std::uint64_t generation() const;  // rises whenever the seat is taken again

 private:
  struct State;
  explicit MemberScene(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
