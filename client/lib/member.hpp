// A scene pushed by the processes of a parallel solver, each with the particles it has.
//
//   auto scene = rcb::client::MemberScene::open(client, "jet", {.member = rank, .members = size, .follow = true});
//   auto result = scene->step(rcb::client::Positions::axes(axes, n), ids);
//   // then, with follow: send the rows result->leaving to their members, and add what those send
//
// With follow, a member that has handed over as told pushes directly to the ranks, without ids: the library
// keeps the rank and slot of each of its particles, and pushes by ids when it isn't sure of them. This is cheapest if
// rows keep their order except for the particles that leave and enter. RCBD_PATH and ConnectOptions::path apply as for
// a Scene.
//
// A step returns when every member has pushed it and it is committed. At its deadline it fails with the name of a
// missing member; then the previous step stands and all may push again. Members need not communicate: the service alone
// decides. Lost connections and a restarted service are handled as for a Scene: all bring their particles again, by
// ids. A member that had no answer yet to a step committed before the crash gets it from the restarted service. A
// restarted process opens the scene and goes on from the last step. Thread-safety: as a Client's. A Client has one
// MemberScene of a scene, and then no Scene of it (busy).
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
  // Member k keeps the particles of the parts [floor(k P / members), floor((k+1) P / members)), and each step tells it
  // which particles to hand over; it learns from the others what they hand over to it. The same for all members.
  bool follow = false;
  double deadline_seconds = 60;
};

struct MemberStepOptions {
  std::optional<std::int64_t> step{};  // default: the scene's last step + 1; 0 for the first
  // [count]; empty: none, or unchanged. Either all members that bring particles give them, or none.
  std::span<const double> weights{};
  std::optional<double> step_seconds{};  // computing time of this member since its last push
  // Rows that moved since this member's last step, distinct, in any order: the positions of the others are unchanged
  // and need not be sent. Not given: all. All are sent nevertheless with new weights, where the service can't build on
  // that step, and, unless they go straight to the ranks, with want_changes: else it can't tell whose a change is.
  std::optional<std::span<const std::uint64_t>> moved{};
  bool unmoved = false;  // no particle has moved: as an empty `moved`
  // Particles among `ids` that go with this step, and new ones that come. Members that insert in the same step either
  // all give ids, or none does.
  std::span<const std::int64_t> removed{};  // ids, distinct
  const Insertion* inserted = nullptr;
  bool want_parts = false;    // fill MemberStep::parts
  bool want_changes = false;  // fill MemberStep::changes
  int threads = 1;            // for finding parts, and what leaves
  double deadline_seconds = 60;
};

struct MemberChange {
  std::int64_t id;
  std::int32_t part;
};

struct LeavingRow {
  // Index into the arrays that were pushed; behind them count those of what was inserted: row 0 of these is `count`.
  std::uint64_t row;
  int to;  // member
};

struct MemberStep {
  StepReport report;
  std::vector<std::int64_t> inserted_ids;  // of what this member inserted, in the order given
  std::vector<MemberChange> changes;  // of the particles this member pushed, those whose part changed; ascending id
  // With follow: those that it has, or has just inserted, of the parts of other members; by ascending row. Found by the
  // cuts after the step, so it is there after a repeated step, too; what wasn't handed over is named again.
  std::vector<LeavingRow> leaving;
  std::vector<std::int32_t> parts;  // of each row that was pushed, then of each inserted, under the cuts after the step
};

class MemberScene {
 public:
  // Takes the seat. The scene must have been created by create_scene(), by a member or another client. Errors: busy
  // (another client has the seat, and keeps it until the deadline), invalid_argument (other terms than those of the
  // other members), not_found.
  static Result<MemberScene> open(Client& client, const std::string& name, const MemberOptions& options);
  MemberScene(MemberScene&&) noexcept;
  MemberScene& operator=(MemberScene&&) noexcept;
  ~MemberScene();  // gives the seat up

  // Pushes this member's particles, in any order. positions: count may be 0.
  //   ids  [count]; every id of the scene belongs to exactly one member, also those that this step removes
  // Errors: aborted and deadline_exceeded name the member at fault (if it names none: push this step again, it may be
  // committed); base_lost: the service was started again, and the scene has weights: push this step with weights.
  Result<MemberStep> step(const Positions& positions, std::span<const std::int64_t> ids,
                          const MemberStepOptions& options = {});
  // As those of Scene.
  Result<std::span<double>> position_rows(std::size_t count);
  Result<std::vector<std::span<double>>> position_axes(std::size_t count);
  Result<std::span<float>> position_rows_f4(std::size_t count);
  Result<std::vector<std::span<float>>> position_axes_f4(std::size_t count);
  std::optional<std::int64_t> last_step() const;
  // As those of Scene.
  Result<rcb::cuts::Cuts> cuts(double deadline_seconds = 60);
  std::uint64_t generation() const;  // of the seat; rises whenever it is taken again

 private:
  struct State;
  explicit MemberScene(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace rcb::client
