// What the scenes of one Client share.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "client/lib/session/session.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// What a Client remembers of a scene that it has created.
struct KnownScene {
  std::optional<int> dims;
  int threads = 1;  // SceneOptions::threads
};

// The answer to a request that describes a scene.
Result<wire::Json> described(Session& session, wire::Json request, const Retry& retry);

// Defined here so that Scene can use it; nobody outside this folder sees it.
struct Client::State {
  std::unique_ptr<Session> session;
  std::map<std::string, KnownScene> created;  // scenes created and not dropped by this client
  std::multiset<std::string> scenes;          // the names of all Scene objects that have no seat
  std::multiset<std::string> seats;           // and of those that have one
  std::map<std::string, std::uint64_t> runs;  // how often this client has created or dropped a scene of that name

  std::uint64_t run_of(const std::string& scene) const {
    const auto found = runs.find(scene);
    return found == runs.end() ? 0 : found->second;
  }
  // What it has created; nothing is known of other scenes.
  KnownScene known(const std::string& scene) const {
    const auto made = created.find(scene);
    return made == created.end() ? KnownScene() : made->second;
  }
  // To be called when the client has created a scene or, without `made`, has dropped it.
  void begin_run(const std::string& scene, std::optional<KnownScene> made) {
    ++runs[scene];
    created.erase(scene);
    if (made) created[scene] = *made;
  }
};

}  // namespace rcb::client
