// KeptAnswers: what the members of each scene were answered last, in files, so that it outlives this process.
//
// A step of M members is committed once and answered M times. Where the service dies in between, some have their
// answers and go on, and the others need theirs: nothing else says what they are to hand over. So the answers are
// written before the first of them is sent, and a service that is started again gives them to whoever pushes that step
// again.
//
// Invariants
// 1. Written in turn to two files a scene, in place: whenever this process dies, one of them is whole.
// 2. Files are not synced: they outlive the process, not the machine.
// 3. A file that can't be written is told once, and nothing else fails.
// 4. No file stays that nobody can ask for: those of a scene that is dropped are removed, and at a start those that are
//    older than the longest deadline.
// Thread-safety: the I/O thread's.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"

namespace rcb::net {

// The answers to a step that members pushed together.
struct MemberAnswers {
  std::int64_t step = 0;
  std::vector<std::string> sessions;  // by member
  wire::Json json;
  std::vector<std::vector<wire::Array>> arrays;  // by member
};

class KeptAnswers {
 public:
  // directory: where the files are; empty: nothing is kept. restarted: what a service before this one has left is read,
  // else removed.
  KeptAnswers(std::string directory, bool restarted);

  // Arrays named place_ are left out: they tell of slots that a service started again doesn't have.
  void keep(const std::string& scene, const MemberAnswers& answers);
  // Those of the service before this one, until keep() has later ones; null where there are none.
  const MemberAnswers* before(const std::string& scene) const;
  // The scene, which this service had, was dropped.
  void forget(const std::string& scene);

 private:
  std::string path(const std::string& scene, int which) const;
  void read(const std::string& path);

  std::string directory_;
  std::map<std::string, int> next_;  // the file to write, of scenes of this service
  std::map<std::string, MemberAnswers> before_;
  bool fault_told_ = false;
};

}  // namespace rcb::net
