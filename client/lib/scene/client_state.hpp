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

// The answer to a request that describes a scene.
Result<wire::Json> described(Session& session, wire::Json request, const Retry& retry);

// Defined here so that Scene can use it; nobody outside this folder sees it.
struct Client::State {
  std::unique_ptr<Session> session;
  std::map<std::string, int> threads;  // SceneOptions::threads of the scenes that this client has created
  std::multiset<std::string> scenes;   // the names of all Scene objects that have no seat
  std::multiset<std::string> seats;    // and of those that have one
};

}  // namespace rcb::client
