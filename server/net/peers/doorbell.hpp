// Room `peers`: communication between ranks without MPI: orders, heartbeats, which ranks are silent.
//
// Doorbells: rank 0's connections to every other rank, over a Unix socket to those on its machine and over TCP to the
// others. They carry orders and other short messages, never bulk data.
//
// Invariants
// 1. Every rank gets the same orders in the same order.
// 2. Both sides send a heartbeat every kTickSeconds without being asked, so that no heartbeat waits behind an order
//    that is being read. A rank that is silent for `silence_seconds`, or whose connection ends without a goodbye, is
//    reported as lost, once. Silence is counted in ticks of the waiting rank, so that no rank is lost when the machine
//    was suspended.
// 3. The Unix socket lies in a folder of its own that only this user can enter, inside the job's folder. It is removed
//    when all ranks are there; what a killed job leaves goes with the job's folder (client/launch/job/job_folder.hpp).
// 4. Nothing is heard from a peer before both sides have proved that they know the job's secret, which MPI told them
//    and which never crosses the connection. When all ranks are there, nobody listens any more.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/wire/message.hpp"
#include "server/net/peers/silent_rank.hpp"
#include "server/net/sockets/io_loop.hpp"

namespace rcb::net {

inline constexpr double kTickSeconds = 2;

// Where rank 0's DoorbellHub listens; rank 0 sends this to the other ranks through MPI.
struct DoorbellAddress {
  std::string path;  // of a Unix socket; empty if there are no other ranks
  std::string secret;
  std::vector<std::string> tcp;  // HOST:PORT, in the order to be tried; empty unless ranks are on other machines

  std::string text() const;
  static DoorbellAddress parse(const std::string& text);
};

struct HubOptions {
  int ranks = 1;
  double silence_seconds = 15;
  std::vector<std::string> hosts = {};  // by rank, for messages; empty: all are on one machine, and there is no TCP
  std::string interface = {};           // for TCP, as addresses_on() takes it
  std::string folder = "/tmp";          // for a folder with the Unix socket
};

// Handles peer messages: those between I/O threads that aren't orders (data_plane.hpp). From rank 0, orders and peer
// messages arrive in the order in which they were sent.
using PeerMessageHandler = std::function<void(int from, const wire::Json& message)>;
using LostHandler = std::function<void(const std::string& what)>;

// Rank 0's side.
class DoorbellHub {
 public:
  // Before the loop starts. Errors: io_error; those of addresses_on().
  static Result<std::unique_ptr<DoorbellHub>> open(IoLoop& loop, HubOptions options, LostHandler lost);
  ~DoorbellHub();
  const DoorbellAddress& address() const;
  // Any thread but the I/O thread. Errors: deadline_exceeded, saying how many ranks have come.
  Status wait_connected(double seconds);
  // I/O thread: sends the order `number` to all ranks. `request` is a JSON text.
  void ring(std::uint64_t number, const std::string& request);
  // Before the loop starts.
  void on_peer_message(PeerMessageHandler handler);
  // I/O thread.
  void tell(int rank, const wire::Json& message);
  // I/O thread, every kTickSeconds.
  void tick();
  // I/O thread. The ranks that have missed more than two heartbeats.
  std::vector<SilentRank> silent() const;
  // Any thread but the I/O thread: says goodbye and waits for the goodbyes of the others.
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
  // Before the loop starts. same_host: rank 0 is on this machine. Errors: unavailable, with the addresses tried.
  static Result<std::unique_ptr<Doorbell>> connect(IoLoop& loop, int rank, const DoorbellAddress& address,
                                                   bool same_host, double silence_seconds, OrderHandler ordered,
                                                   LostHandler lost);
  ~Doorbell();
  // This machine's address on the way to rank 0, without a port; empty over a Unix socket.
  const std::string& local_address() const;
  // Before the loop starts.
  void on_peer_message(PeerMessageHandler handler);
  // I/O thread.
  void tell(const wire::Json& message);
  // I/O thread, every kTickSeconds: sends a heartbeat with these fields.
  void tick(const wire::Json& word);
  void finish(double seconds);

 private:
  struct State;
  explicit Doorbell(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

}  // namespace rcb::net
