// Engine: what the socket side needs of the ranks' engine threads, and no more. The real one orders the command on
// all ranks; tests answer from a function.
//
// Invariants
// 1. Orders are executed one after another; those of one scene in the order of submit().
// 2. Every submitted order is answered exactly once, with what it has made of its scene.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/api/snapshot.hpp"

namespace rcb::net {

// Sees the positions of one slice of all particles as they arrive, while they are in the cache. On the I/O thread.
class SliceObserver {
 public:
  virtual ~SliceObserver() = default;
  // The values of an axis from slot `first` on, in the order in which they came.
  virtual void arrived(std::size_t axis, std::uint64_t first, std::span<const double> values) = 0;
};

// One rank's particles of a push, as the client sent them.
struct Slice {
  int rank = 0;
  std::uint64_t count = 0;
  std::vector<wire::Array> arrays;
  std::shared_ptr<SliceObserver> observer = nullptr;  // that has seen it; may be null
};

struct Order {
  // "command" and its arguments; with "staged", a number, where each rank has its slice of that direct push, or such
  // numbers, one a member, where each has what the members' pushes bring it.
  wire::Json request;
  std::string text;  // the same, at most kJsonBytesMax bytes
  std::vector<Slice> slices;
  double received_seconds = 0;
  double deadline_seconds = 60;
  // Set once nobody waits for the answer any more: a long command may end early. May be null.
  std::shared_ptr<const std::atomic<bool>> cancelled;
};

struct Answer {
  Status status;
  wire::Json json = wire::Json::object();
  std::vector<wire::Array> arrays;
  std::optional<api::SceneChange> change = {};  // where the order may have changed its scene
};

class Engine {
 public:
  virtual ~Engine() = default;
  // Called on the I/O thread. `done` may be called from any thread, after submit() has returned or before.
  virtual void submit(Order order, std::function<void(Answer)> done) = 0;
};

}  // namespace rcb::net
