// Doorbells: small connections from rank 0 to every other rank. They carry orders and signs of life, never bulk.
//
// Invariants
// 1. Every rank gets the same orders in the same order.
// 2. Both sides send a sign of life every kTickSeconds of their own accord, so that none waits behind an order that is
//    being read. A rank that is silent for `silence_seconds`, or whose connection ends without a goodbye, is given as
//    lost, once. Silence is counted in the listener's own ticks, so a machine that was asleep loses nobody.
// 3. It has no name in the file system, so nothing of it can stay there, however the ranks end.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/net/control.hpp"
#include "server/net/io_loop.hpp"

namespace rcb::net {

inline constexpr double kTickSeconds = 2;

// Told to the other ranks through MPI.
struct DoorbellAddress {
  std::string name;  // of a nameless socket (listen.hpp)
  std::string secret;
};

// Words between the I/O threads that aren't orders (data_plane.hpp); from rank 0 they come in order with these.
using NewsHandler = std::function<void(int from, const wire::Json& news)>;
using LostHandler = std::function<void(const std::string& what)>;

// Rank 0's side.
class DoorbellHub {
 public:
  // Before the loop starts. Errors: io_error.
  static Result<std::unique_ptr<DoorbellHub>> open(IoLoop& loop, int ranks, double silence_seconds, LostHandler lost);
  ~DoorbellHub();
  const DoorbellAddress& address() const;
  // Any thread but the I/O thread. Errors: deadline_exceeded, naming the ranks that are missing.
  Status wait_connected(double seconds);
  // I/O thread: `request` is a JSON text.
  void ring(std::uint64_t number, const std::string& request);
  // Before the loop starts.
  void on_news(NewsHandler handler);
  // I/O thread.
  void tell(int rank, const wire::Json& news);
  // I/O thread, every kTickSeconds.
  void tick();
  // I/O thread. The ranks that have said nothing for longer than their signs of life are apart.
  std::vector<SilentRank> silent() const;
  // Any thread but the I/O thread: says goodbye and waits for the others' goodbyes.
  void finish(double seconds);

 private:
  struct State;
  explicit DoorbellHub(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

// Another rank's side.
class Doorbell {
 public:
  using OrderHandler = std::function<void(std::uint64_t number, wire::Json request)>;
  // Before the loop starts. Errors: unavailable.
  static Result<std::unique_ptr<Doorbell>> connect(IoLoop& loop, int rank, const DoorbellAddress& address,
                                                   double silence_seconds, OrderHandler ordered, LostHandler lost);
  ~Doorbell();
  // Before the loop starts.
  void on_news(NewsHandler handler);
  // I/O thread.
  void tell(const wire::Json& news);
  // I/O thread, every kTickSeconds: a sign of life, which takes `word` along.
  void tick(const wire::Json& word);
  void finish(double seconds);

 private:
  struct State;
  explicit Doorbell(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

}  // namespace rcb::net
