// Lobby: connections that stay on sufferance, such as those that haven't said hello. Where too many are there, the one
// that came first gives way to the one that comes, and is told so: nobody is kept out by those who only wait.
#pragma once

#include <cstddef>
#include <deque>
#include <utility>

#include "server/net/connection.hpp"

namespace rcb::net {

class Lobby {
 public:
  // A connection's place, given back whatever happens.
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

  // why: what those are told that give way.
  Lobby(std::size_t max, Status why) : max_(max), why_(std::move(why)) {}
  void close() {
    for (Connection* connection : std::exchange(here_, {})) connection->close();
  }

 private:
  std::size_t max_;
  Status why_;
  std::deque<Connection*> here_;  // who came first stands first
};

}  // namespace rcb::net
