// OrderQueue: orders for all ranks wait here, on rank 0, until they may be sent. An order waits
// - while a rank is too far behind (Credits),
// - while a long command (api::CommandInfo::gives_way: it may take seconds) of the same scene is unfinished,
// - if it is long itself, while another long one is unfinished. But one that changes its scene, such as a rebalance, is
//   executed in the middle of one that only reads, such as a compare,
// - if it is the end of the service, while any other waits.
// Orders of other scenes overtake, so that the ranks can execute them in the middle of the long command.
//
// Invariants
// 1. Orders of one scene are sent in the order of add(). Only a long order that merely reads can be overtaken by later
//    orders.
// 2. No order in the engines' queues has to wait for the end of a long command before it.
// Everything runs on the I/O thread.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "server/net/control/credits.hpp"
#include "server/net/push/engine.hpp"

namespace rcb::net {

class OrderQueue {
 public:
  using Done = std::function<void(Answer)>;
  enum class Kind { brief, long_reading, long_changing };
  // Sends an order to all ranks, or throws before it has sent or taken anything. After the answer to a long order its
  // sender calls long_order_ended().
  using Send = std::function<void(Order&& order, Done&& done, Kind kind)>;
  OrderQueue(Credits credits, Send send) : credits_(std::move(credits)), send_(std::move(send)) {}

  void add(Order order, Done done);
  // `rank` has executed this many orders in all.
  void executed(int rank, std::uint64_t orders);
  void long_order_ended(Kind kind);
  // Answers the waiting orders that are cancelled.
  void drop_cancelled();

 private:
  struct Waiting {
    Order order;
    Done done;
    std::string scene;  // empty: none
    Kind kind = Kind::brief;
    bool is_end = false;  // the shutdown: after all others
  };
  bool long_one_may_start(const Waiting& one) const;
  // Sends what may be sent.
  void release();
  void send(Waiting one);

  Credits credits_;
  Send send_;
  std::deque<Waiting> waiting_;  // at most the coordinator's unfinished orders
  // The scenes of the unfinished long orders.
  std::optional<std::string> reading_;
  std::optional<std::string> changing_;
};

}  // namespace rcb::net
