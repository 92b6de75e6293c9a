// A scene whose service was started again, empty, is made anew with the options that the client knows. What is pushed
// into it then is the business of Scene and MemberScene.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "client/lib/session.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

// What is known of a scene beside its particles.
struct KnownScene {
  wire::Json options;    // arguments of scene.create; null: not known yet
  std::string instance;  // the run of the service that had it
};

// The options among the fields of scene.show, or of a scene.create.
wire::Json scene_options(const wire::Json& description);

// scene.open with these arguments, once. Where the service that had the scene is no more, and this one doesn't have it,
// it is made first; whoever else makes it at the same time does so with the same options, so either will do.
// Errors: not_found, where it can't be made: it was dropped, its options aren't known, or the session doesn't outlive.
Result<wire::Json> open_or_make_anew(Session& session, const wire::Json& arguments, KnownScene& known,
                                     const Retry& retry);

// After a change that somebody else has made. What can't be learnt now stays as it was.
void refresh_options(Session& session, const std::string& scene, KnownScene& known, const Retry& retry);

// Defined here so that Scene and MemberScene see it; nobody outside this folder does.
struct Client::State {
  std::unique_ptr<Session> session;
  std::map<std::string, KnownScene> created;  // by this client, and not yet dropped
};

}  // namespace rcb::client
