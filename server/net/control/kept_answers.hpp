// KeptAnswers: keeps the last answers to the members of each scene in files, which outlive this process.
//
// A step of M members is committed once and answered M times. If the service dies in between, some members have their
// answers and go on, while the others still need theirs: without them they can't know which particles to migrate. So
// all answers are written to disk before the first is sent, and a restarted service gives them to members that push
// that step again.
//
// Invariants
// 1. Each scene has two files, overwritten in turn: whenever this process dies, one of them is whole.
// 2. Files are not synced: they survive the end of the process, not of the machine.
// 3. Files are touched on the FileThread alone. Answers wait until theirs are written, for kWaitSeconds at most: a disk
//    that takes longer, or that can't take them, is logged and fails nothing else, and while it stands still nobody
//    waits for it again.
// 4. Of each scene only the newest answers wait to be written.
// 5. No file stays that nobody can ask for: files of a scene that is dropped or created anew are removed, and at start
//    those older than the longest deadline. A clean end leaves none.
// Thread-safety: I/O thread only.
#pragma once

#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/net/sockets/asio.hpp"

namespace rcb::net {

// The answers to one step of a scene's members.
struct MemberAnswers {
  std::int64_t step = 0;
  std::vector<std::string> sessions;  // session of each member
  wire::Json json;
  std::vector<std::vector<wire::Array>> arrays;  // by member
  std::vector<wire::Array> cuts;                 // for all members that say which cuts they know
};

class KeptAnswers {
 public:
  static constexpr double kWaitSeconds = 3;

  // directory: of the files; empty: nothing is kept. restarted: files that an earlier service has left are read now,
  // otherwise they are removed.
  KeptAnswers(asio::io_context& context, std::string directory, bool restarted);
  ~KeptAnswers();

  // then: called once, when the answers are written, or can't be, or not in time; maybe at once. Leaves out arrays
  // named place_*: they refer to slots, which a restarted service doesn't have.
  void keep(const std::string& scene, std::shared_ptr<const MemberAnswers> answers, std::function<void()> then);
  // The answers that an earlier service kept for the scene, until keep() replaces them; null if there are none.
  const MemberAnswers* before(const std::string& scene) const;
  // Removes the scene's files. To be called when its run is over: it was dropped, or created again by a client that
  // isn't restoring what a restart has lost. The steps of a new run may begin at any number.
  void forget(const std::string& scene);
  // At a clean end. Answers that wait are let go.
  void forget_all();

 private:
  class Files;
  // What is still to be done with a scene's files.
  struct Due {
    bool remove = false;                           // first
    std::shared_ptr<const MemberAnswers> answers;  // then these are written, if there are any
    std::uint64_t number = 0;                      // of the last keep() in it
  };
  struct Waiting {
    Waiting(asio::io_context& context, std::uint64_t of, std::function<void()> done)
        : number(of), then(std::move(done)), timer(context) {}
    std::uint64_t number;
    std::function<void()> then;
    Timer timer;
  };
  void work();
  // Lets go those whose answers were among the first `number`.
  void let_go(std::uint64_t number);
  void late();

  asio::io_context& context_;
  std::shared_ptr<Files> files_;  // null: nothing is kept
  std::map<std::string, MemberAnswers> before_;
  std::set<std::string> kept_;  // scenes that may have files
  std::map<std::string, Due> due_;
  std::list<Waiting> waiting_;                            // in the order of keep()
  std::uint64_t number_ = 0;                              // of the last keep()
  bool working_ = false;                                  // a job is with the FileThread
  bool late_ = false;                                     // it takes longer than anybody waits
  std::shared_ptr<int> there_ = std::make_shared<int>();  // whose end tells timers and jobs that this object has gone
};

}  // namespace rcb::net
