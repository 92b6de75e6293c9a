// MemberGroups: parallel solvers. A scene that is open by M members is pushed by all of them together: each brings the
// particles it has, and the step is ordered when the last one has brought its own.
//
// Invariants
// 1. A seat belongs to one connection; whoever takes it again has a higher generation, and the older connection's
//    pushes and slices of the scene are refused or dropped from then on.
// 2. A step of the members ends for all at once: ordered, or given up with the name of the member that is to blame.
// 3. The answers to the last step are kept, so that a member that lost its connection gets its own once it asks again;
//    where the service died meanwhile, from the next one (kept_answers.hpp).
// Everything runs on the I/O thread.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "server/net/asio.hpp"
#include "server/net/connection.hpp"
#include "server/net/engine.hpp"
#include "server/net/kept_answers.hpp"
#include "server/net/push.hpp"

namespace rcb::net {

class Coordinator;
struct OpenPush;

struct Membership {
  int member = 0;
  int members = 1;
  bool follow = false;
  std::uint64_t generation = 0;  // 0: the next one
};

wire::Json membership_json(const Membership& membership);
// Of a scene.open; nothing if it opens the scene without a seat. Errors: invalid_argument.
Result<std::optional<Membership>> read_membership(const wire::Json& request);

// A step that members are pushing. In the scene's gate an OpenPush without particles stands for it.
struct MemberPush {
  MemberPush(asio::io_context& context, std::string of, std::int64_t number)
      : scene(std::move(of)), step(number), timer(context) {}
  std::string scene;
  std::int64_t step;
  std::vector<std::shared_ptr<OpenPush>> shares;  // by member; null: not begun
  std::weak_ptr<OpenPush> front;                  // in the gate
  Timer timer;                                    // to the next notice
  TimePoint started = now();
  TimePoint end = TimePoint::max();
  bool ordered = false;
  bool over = false;  // every share has its answer

  // Its shares go to the ranks: all of them do, or none.
  bool direct() const;
  // Whether this connection has begun a share that isn't whole: what it reads next must be that.
  bool awaits(const Connection* connection) const;
  std::string progress() const;  // "2 of 4 members"
};

// A member's push.begin.
struct ShareBegin {
  PushId id;
  std::shared_ptr<Connection> connection;
  std::string client;
  std::uint64_t request = 0;
  wire::Json json;
  TimePoint end;
};

class MemberGroups {
 public:
  explicit MemberGroups(Coordinator& coordinator);

  // Takes a seat. Errors: busy (it is taken), invalid_argument (the others were told other terms).
  Result<Membership> join(const std::string& scene, Membership wanted, const Connection* connection,
                          const std::string& client);
  // Frees the connection's seat; a step of the members that isn't ordered is given up. why: "has closed the scene".
  void leave(const std::string& scene, const Connection* connection, const std::string& why);
  void leave_all(const Connection* connection);
  // The same of a member that has closed the scene. Once all have, nobody is left who could ask for an answer again.
  void close(const std::string& scene, const Connection* connection);
  // Whether the connection holds a seat of the scene, or has held one that another generation has taken.
  bool knows(const std::string& scene, const Connection* connection) const;
  // "4 members", where any seat of the scene is taken; else "".
  std::string holders(const std::string& scene) const;

  // Begins a member's share of a step; the gate holds no other push, and no change of the scene is under way.
  // Errors: what the push.begin has wrong. A step that is committed already is answered.
  Status begin(ShareBegin begin);
  // A share has all its slices.
  void share_whole(const std::shared_ptr<OpenPush>& share);
  // `share`: whose fault it is; null: nobody's.
  void give_up(const std::shared_ptr<MemberPush>& step, const OpenPush* share, const Status& why);
  // What a deadline says: who is missing.
  Status late(const MemberPush& step) const;
  // After every change of a scene.
  void scene_changed(const std::string& scene);

 private:
  struct Seat {
    std::string client;
    std::uint64_t generation = 0;            // 0: never taken
    const Connection* connection = nullptr;  // null: free
    std::vector<const Connection*> former;   // that lost the seat to a later generation, and are still there
  };
  struct Group {
    bool follow = false;
    std::vector<Seat> seats;
    std::optional<MemberAnswers> last;
  };

  Group* find(const std::string& scene);
  const Group* find(const std::string& scene) const;
  void blame(const std::string& scene, std::size_t member, const std::string& why);
  std::string name(const std::string& scene, std::size_t member) const;
  std::string missing(const MemberPush& step) const;
  // False: the member's push isn't of that step.
  bool answer_again(const MemberAnswers& answers, std::size_t member, const ShareBegin& begin);
  Result<PushTerms> read_terms(const ShareBegin& begin, const api::SceneSummary& info, const MemberPush* step) const;
  // A member pushes by ids: those that push directly shall do so, too.
  void withdraw_direct(MemberPush& step, std::size_t because_of);
  // All members have begun directly: they must have the particles of each rank between them.
  Status check_counts(const MemberPush& step) const;
  std::shared_ptr<MemberPush> open_step(const std::string& scene, std::int64_t step, const Group& group);
  void order(const std::shared_ptr<MemberPush>& step);
  void answered(const std::shared_ptr<MemberPush>& step, Answer answer);
  awaitable<void> watch(std::shared_ptr<Coordinator> self, std::shared_ptr<MemberPush> step);

  Coordinator& coordinator_;
  std::map<std::string, Group> groups_;
  KeptAnswers kept_;
};

}  // namespace rcb::net
