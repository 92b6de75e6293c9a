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
// 3. A file that can't be written is logged once and fails nothing else.
// 4. No file stays that nobody can ask for: files of a scene that is dropped or created anew are removed, and at start
//    those older than the longest deadline. A clean end leaves none.
// Thread-safety: I/O thread only.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"

namespace rcb::net {

// The answers to one step of a scene's members.
struct MemberAnswers {
  std::int64_t step = 0;
  std::vector<std::string> sessions;  // session of each member
  wire::Json json;
  std::vector<std::vector<wire::Array>> arrays;  // by member
};

class KeptAnswers {
 public:
  // directory: of the files; empty: nothing is kept. restarted: files that an earlier service has left are read,
  // otherwise they are removed.
  KeptAnswers(std::string directory, bool restarted);

  // Leaves out arrays named place_*: they refer to slots, which a restarted service doesn't have.
  void keep(const std::string& scene, const MemberAnswers& answers);
  // The answers that an earlier service kept for the scene, until keep() replaces them; null if there are none.
  const MemberAnswers* before(const std::string& scene) const;
  // Removes the scene's files. To be called when its run is over: it was dropped, or created again by a client that
  // isn't restoring what a restart has lost. The steps of a new run may begin at any number.
  void forget(const std::string& scene);
  // At a clean end.
  void forget_all();

 private:
  std::string path(const std::string& scene, int which) const;
  void read(const std::string& path);

  std::string directory_;
  std::map<std::string, int> next_;  // which of the two files is written next, by scene
  std::map<std::string, MemberAnswers> before_;
  bool fault_told_ = false;
};

}  // namespace rcb::net
