// What goes out to the ranks, and when: a command that may last is in nobody's way.
#include "server/net/control/order_queue.hpp"

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace rcb::net {
namespace {

class OrderQueueTest : public ::testing::Test {
 protected:
  using Cancelled = std::shared_ptr<std::atomic<bool>>;

  void add(const std::string& command, const std::string& scene, Cancelled cancelled = nullptr, std::size_t bytes = 0) {
    Order order;
    order.text.resize(bytes);
    order.request = {{"command", command}, {"scene", scene}};
    order.cancelled = std::move(cancelled);
    const std::string name = command + " " + scene;
    queue.add(std::move(order), [this, name](const Answer& answer) {
      dropped.push_back(name + " " + std::string(code_name(answer.status.code())));
    });
  }
  // What has gone out since the last call.
  std::vector<std::string> gone() { return std::exchange(sent, {}); }
  using Names = std::vector<std::string>;

  std::vector<std::string> sent, dropped;
  std::string faulty;  // the command whose orders can't be sent
  OrderQueue queue{Credits(1, 8, 1000), [this](const Order& order, const OrderQueue::Done&, OrderQueue::Kind kind) {
                     if (order.request["command"] == faulty) throw std::runtime_error("a bug");
                     sent.push_back(order.request["command"].get<std::string>() + " " +
                                    order.request["scene"].get<std::string>() +
                                    (kind == OrderQueue::Kind::brief ? "" : " long"));
                   }};
};

TEST_F(OrderQueueTest, WhileOneLastsOtherScenesGoOn) {
  add("push", "a");
  add("compare", "a");
  add("assign", "a");     // of its scene: after it
  add("quality", "b");    // long, too: after it, in nobody's way
  add("push", "b");       // past that one, which only reads
  add("rebalance", "c");  // changes its scene: in the middle of the one that reads
  add("push", "c");       // after that one
  add("load", "d");       // changes its scene, too: after that one
  add("push", "d");
  EXPECT_EQ(gone(), (Names{"push a", "compare a long", "push b", "rebalance c long"}));
  queue.executed(1, 1);
  queue.long_order_ended(OrderQueue::Kind::long_changing);
  EXPECT_EQ(gone(), (Names{"push c", "load d long"}));
  queue.long_order_ended(OrderQueue::Kind::long_reading);
  EXPECT_EQ(gone(), (Names{"assign a"}));
  queue.long_order_ended(OrderQueue::Kind::long_changing);
  EXPECT_EQ(gone(), (Names{"quality b long", "push d"}));
}

TEST_F(OrderQueueTest, HoweverManyWaitForASceneOthersGoOn) {
  add("compare", "a");
  for (int i = 0; i < 500; ++i) add("assign", "a");
  add("push", "b");
  EXPECT_EQ(gone(), (Names{"compare a long", "push b"}));
  queue.executed(1, 2);
  queue.long_order_ended(OrderQueue::Kind::long_reading);
  EXPECT_EQ(gone().size(), 8U);  // no more than the slowest rank's queue takes
  queue.executed(1, 5);
  EXPECT_EQ(gone().size(), 3U);
}

TEST_F(OrderQueueTest, WhatNobodyWaitsForIsAnsweredAtOnce) {
  const auto cancelled = std::make_shared<std::atomic<bool>>(false);
  add("compare", "a", cancelled);
  add("assign", "a", cancelled);
  add("assign", "a");
  *cancelled = true;
  queue.drop_cancelled();
  EXPECT_EQ(dropped, (Names{"assign a aborted"}));  // the first has been sent: the engine answers it
  queue.long_order_ended(OrderQueue::Kind::long_reading);
  EXPECT_EQ(gone(), (Names{"compare a long", "assign a"}));
}

// It is answered, takes none of the credits, and isn't taken for one that lasts; those behind it go out.
TEST_F(OrderQueueTest, AnOrderThatCannotBeSentConcernsNoOther) {
  faulty = "quality";
  add("compare", "a");
  constexpr int kFaulty = 20;  // more than there are credits
  for (int i = 0; i < kFaulty; ++i) add("quality", "b");
  add("push", "b");
  queue.long_order_ended(OrderQueue::Kind::long_reading);
  EXPECT_EQ(dropped, Names(kFaulty, "quality b internal"));
  EXPECT_EQ(gone(), (Names{"compare a long", "push b"}));
  faulty.clear();
  add("quality", "b");
  EXPECT_EQ(gone(), (Names{"quality b long"}));
}

TEST_F(OrderQueueTest, WhatIsGivenUpHoldsUpNothing) {
  const auto cancelled = std::make_shared<std::atomic<bool>>(false);
  add("load", "a");
  add("rebalance", "b", cancelled);
  add("assign", "b");
  EXPECT_EQ(gone(), (Names{"load a long"}));
  *cancelled = true;
  queue.drop_cancelled();
  EXPECT_EQ(gone(), (Names{"assign b"}));
}

TEST_F(OrderQueueTest, TheEndComesAfterEverything) {
  add("compare", "a");
  add("push", "a");
  add("shutdown", "");
  EXPECT_EQ(gone(), (Names{"compare a long"}));
  queue.long_order_ended(OrderQueue::Kind::long_reading);
  EXPECT_EQ(gone(), (Names{"push a", "shutdown  long"}));
}

TEST_F(OrderQueueTest, TheEndComesAfterWhatWaitsForRoom) {
  for (const char* scene : {"a", "b"}) add("create", scene, nullptr, 600);
  add("shutdown", "");
  EXPECT_EQ(gone(), (Names{"create a"}));
  queue.executed(1, 1);
  EXPECT_EQ(gone(), (Names{"create b", "shutdown  long"}));
}

}  // namespace
}  // namespace rcb::net
