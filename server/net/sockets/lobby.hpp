// Lobby: connections that are merely tolerated, such as those that haven't said hello. When there are too many, the
// oldest is closed to make room for the newest, and is told so; hence connections that only wait keep nobody out.
#pragma once

#include <cstddef>
#include <deque>
#include <utility>

#include "server/net/sockets/connection.hpp"

namespace rcb::net {

class Lobby {
 public:
  // A connection's place, freed by the destructor.
  class Place {
   public:
    Place(Lobby& lobby, Connection& connection) : lobby_(lobby), connection_(connection) {
      lobby_.here_.push_back(&connection_);
      if (lobby_.here_.size() <= lobby_.max_) return;
      lobby_.here_.front()->close_saying(lobby_.why_);
      lobby_.here_.pop_front();
    }
    Place(const Place&) = delete;
    Place& operator=(const Place&) = delete;
    ~Place() { std::erase(lobby_.here_, &connection_); }

   private:
    Lobby& lobby_;
    Connection& connection_;
  };

  // why: what a connection that is closed for a newer one is told.
  Lobby(std::size_t max, Status why) : max_(max), why_(std::move(why)) {}
  void close() {
    for (Connection* connection : std::exchange(here_, {})) connection->close();
  }

 private:
  std::size_t max_;
  Status why_;
  std::deque<Connection*> here_;  // oldest first
};

}  // namespace rcb::net
