// Round: a step of which some seats have brought their share, and wait. It ends for all of them at once.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "common/wire/message.hpp"
#include "server/net/sockets/asio.hpp"
#include "server/net/sockets/connection.hpp"

namespace rcb::net {

// Who has brought a share, and is answered at the end.
struct Asker {
  std::shared_ptr<Connection> connection;
  std::string client;
  std::uint64_t request = 0;  // its number
  TimePoint end;
  std::shared_ptr<void> held = nullptr;  // memory of a large request (Coordinator::hold_request)
};

// Share: an Asker, and what it has brought.
template <typename Share>
struct Round {
  Round(asio::io_context& context, std::string of, std::int64_t step, std::size_t seats)
      : scene(std::move(of)), number(step), shares(seats), timer(context) {}
  std::string scene;
  std::int64_t number;
  std::vector<std::shared_ptr<Share>> shares;  // by seat; null: not begun
  std::size_t begun = 0;                       // how many are begun
  Timer timer;                                 // until the deadline or the next notice
  TimePoint started = now();
  TimePoint end = TimePoint::max();  // the earliest of the shares'
  bool over = false;                 // every seat is answered

  // In place of what the seat has brought before, if anything.
  void put(std::size_t seat, std::shared_ptr<Share> share) {
    const TimePoint before = end;
    if (const auto older = std::exchange(shares[seat], std::move(share))) {
      const Status why(Code::aborted, "a newer attempt of the same session replaced it");
      older->connection->send(wire::FrameType::failure, older->request, wire::failure_json(why));
      end = TimePoint::max();
      for (const auto& one : shares)
        if (one) end = std::min(end, one->end);
    } else {
      ++begun;
    }
    end = std::min(end, shares[seat]->end);
    if (end != before) timer.cancel();  // so that it is heeded
  }
  // To all that have begun.
  void tell(wire::FrameType type, const std::string& json) const {
    for (const auto& one : shares)
      if (one) one->connection->send_text(type, one->request, json);
  }
};

// Gives notices, which say what is waited for, until the round is over; its deadline ends in late().
template <typename Of, typename WaitsFor, typename Late>
awaitable<void> watch(double notice_seconds, std::shared_ptr<Of> round, WaitsFor waits_for, Late late) {
  TimePoint notice_at = now() + duration_of(notice_seconds);
  while (!round->over) {
    round->timer.expires_at(std::min(notice_at, round->end));
    co_await round->timer.async_wait(kAwait);
    if (round->over) break;
    if (now() >= round->end) {
      late();
      break;
    }
    if (now() < notice_at) continue;
    const std::string notice = fmt::format("step {} of scene '{}' has waited {:.0f} s for {}", round->number,
                                           round->scene, seconds_since(round->started), waits_for());
    round->tell(wire::FrameType::notice, wire::dump_json({{"notice", notice}}));
    notice_at = now() + duration_of(notice_seconds);
  }
}

}  // namespace rcb::net
