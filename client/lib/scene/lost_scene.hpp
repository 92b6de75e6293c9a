// Creates a scene again if its service was restarted, empty, with the options that the client knows. Scene and
// MemberScene then push the particles into it.
#pragma once

#include <map>
#include <memory>
#include <set>
#include <string>

#include <fmt/format.h>

#include "client/lib/session/session.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// What is known of a scene besides its particles.
struct KnownScene {
  wire::Json options;    // arguments of scene.create; null: not known yet
  std::string instance;  // identifies the run of the service that had the scene
  int threads = 1;       // SceneOptions::threads
};

// Picks the scene's options out of a described() scene or the arguments of a scene.create.
wire::Json scene_options(const wire::Json& description);

// The answer to a request that describes a scene. Long part sizes, which come as an array beside the answer, are in it.
Result<wire::Json> described(Session& session, wire::Json request, const Retry& retry);

// One scene.open with these arguments. If the service was restarted and doesn't have the scene, creates it first.
// Another client may create it at the same moment, with the same options: either will do. Errors: not_found, if the
// scene can't be created: it was dropped, its options aren't known, or ConnectOptions::outlive is false.
Result<wire::Json> open_or_make_anew(Session& session, const wire::Json& arguments, KnownScene& known,
                                     const Retry& retry);

// Asks for the scene's options after another client has changed them. If that fails, they stay as they were.
void refresh_options(Session& session, const std::string& scene, KnownScene& known, const Retry& retry);

// Defined here so that Scene and MemberScene can use it; nobody outside this folder sees it.
struct Client::State {
  std::unique_ptr<Session> session;
  std::map<std::string, KnownScene> created;  // scenes created and not dropped by this client
  std::multiset<std::string> scenes;          // the names of all Scene objects
  std::multiset<std::string> seats;           // and of all MemberScene objects
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
  // A connection opens a scene once, as a member or for all particles: the end of either would end both. others: those
  // of the other kind.
  static Status refuse_both(const std::multiset<std::string>& others, const char* kind, const std::string& scene) {
    if (!others.contains(scene)) return {};
    return {Code::busy, fmt::format("this client has scene '{}' open as a {}", scene, kind),
            "open it with another client, or after that one has ended"};
  }
  // To be called when the client has created a scene, with its options, or has dropped it, with none.
  void begin_run(const std::string& scene, wire::Json options, int threads = 1);
};

}  // namespace rcb::client
