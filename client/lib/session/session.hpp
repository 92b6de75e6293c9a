// Room `session`: what commands and pushes of all kinds share: the session, the data connections to the ranks, the
// source of a push's arrays, memory shared with the ranks. Nothing here knows what a scene was like before.
//
// Session: what outlives a single connection: the service's endpoint, the session number, and how to reach a lost
// service again.
//
// Invariants
// 1. The session number stays the same over all connections, so that the service recognises a repeated step.
// 2. A command is repeated automatically only if doing it twice has the same effect as once.
// 3. retry_until_deadline() is the only loop in which a call waits for a service that has gone.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <unistd.h>

#include "client/lib/client.hpp"
#include "client/lib/connect/connection.hpp"
#include "client/lib/connect/endpoint.hpp"
#include "client/lib/connect/retry.hpp"
#include "common/auth/proof.hpp"
#include "common/base/status.hpp"
#include "common/files/shared_memory.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

class DataPath;
class PushSource;
struct Column;
struct Rows;
using RankRows = std::vector<Rows>;  // by rank, in the order to be sent

inline constexpr double kCloseSeconds = 2;                                        // for scene.close in a destructor
inline constexpr std::int64_t kLarge = std::numeric_limits<std::int64_t>::max();  // accepted of the service's counters

// A request without arrays, as bytes.
std::string request_frame(std::uint64_t request, const wire::Json& json);

class Session {
 public:
  static Result<std::unique_ptr<Session>> open(const ConnectOptions& options);
  ~Session();  // says goodbye

  // False in a forked child: what it sends would mix with its parent's.
  bool connected() const { return connection_ != nullptr && process_ == ::getpid(); }
  // Rises with every new connection.
  std::uint64_t generation() const { return generation_; }
  bool outlive() const { return options_.outlive; }

  // Runs `once`, with a connection established, and repeats it while it fails by losing the service. Any other error is
  // passed to `mend`: if that returns true, `once` is repeated. `once` returns a Result or a Status and has no retry
  // loop of its own.
  template <typename Once, typename Mend>
  std::invoke_result_t<Once&> retry_until_deadline(Retry& retry, Once&& once, Mend&& mend) {
    for (const std::uint64_t before = generation_;;) {
      Status status = ensure(retry.deadline());
      if (status) {
        if (generation_ != before && retry.end_of_waiting()) notice(fmt::format("{} answers again", endpoint_text_));
        auto result = once();
        if (result) return result;
        status = status_of(result);
        const bool lost = status.code() == Code::unavailable && !connected();
        if (!lost && mend(status)) continue;
        if (!lost) return status;
      }
      if (Status over = wait(retry, status, gone()); !over) return over;
    }
  }
  // The same where nothing else can be mended.
  template <typename Once>
  std::invoke_result_t<Once&> retry_until_deadline(Retry& retry, Once&& once) {
    return retry_until_deadline(retry, once, [](const Status&) { return false; });
  }
  // Waits until the next attempt is due; if there is none, returns why. why: the error of the last attempt; what:
  // names what is waited for, in notices.
  Status wait(Retry& retry, const Status& why, const std::string& what) const;
  // "the service at E, which has gone"
  std::string gone() const;
  // Of a lost service which has said that it was told to end: that, once.
  void tell_of_stop();
  void notice(const std::string& text) const;
  std::uint64_t next_request() { return next_request_++; }
  // Number of a push. A scene that is created again starts at step 0, but the attempt number makes each push unique.
  std::int64_t next_attempt() { return next_attempt_++; }
  const std::string& number() const { return number_; }
  const std::string& endpoint() const { return endpoint_text_; }
  int ranks() const { return ranks_; }

  // Sends a request on the current connection and waits for its answer. If the connection is lost, connected() is false
  // afterwards.
  Result<Frame> exchange(std::uint64_t request, PushSource& source, const std::string& what, const Deadline& deadline);
  // The connections to the ranks themselves, opened if that wasn't tried yet; null if there are none.
  DataPath* data(const Deadline& deadline);
  // Rises whenever data() is opened anew; what was shared over older connections is shared no more.
  std::uint64_t data_generation() const { return data_generation_; }
  // Whether ranks can share memory with this client: some are on its host, and that was not stopped.
  bool can_share(const Deadline& deadline);
  bool shares_with(int rank) const;
  // On this connection: a rank, or this kernel, doesn't take positions so. True once.
  bool stop_sharing() { return !std::exchange(share_refused_, true); }
  // The ranks, ascending, that don't share memory: they are on other hosts.
  std::vector<int> ranks_apart() const;
  // Numbers name the memory that this session shares.
  std::int64_t next_memory() { return next_memory_++; }
  // Shares the memory with every rank on this host, under this number. Errors: too_large and unsupported (a rank
  // refuses it), aborted (a rank was lost).
  Status share(const SharedMemory& memory, std::int64_t number, const Deadline& deadline);
  void unshare(std::int64_t number, const Deadline& deadline);
  // The error of a push that must go directly when data() is null. If the service has addresses for its ranks, a rank
  // may just have died: then the connection is closed too, so that the call is tried again.
  Status no_data();
  // Sends whole frames to the endpoint and waits for the answer.
  Result<Frame> exchange_frames(std::uint64_t request, const std::string& frames, const std::string& what,
                                const Deadline& deadline);
  // Sends the push to the endpoint and the slices of these rows over data().
  Result<Frame> exchange_directly(std::uint64_t request, const wire::Json& push, const RankRows& rows,
                                  std::span<const Column> columns, const std::string& what, const Deadline& deadline);
  Path path() const { return options_.path; }
  // Sends one command and returns its answer; waits for a lost service.
  Result<Frame> call(wire::Json request, double deadline_seconds);
  // One attempt of call() on the current connection, for use in retry_until_deadline().
  Result<Frame> call_once(wire::Json request, const Retry& retry);

 private:
  explicit Session(ConnectOptions options);
  static Status status_of(const Status& status) { return status; }
  template <typename T>
  static Status status_of(const Result<T>& result) {
    return result.status();
  }
  // Connects again if the connection is gone. Errors: those of open().
  Status ensure(const Deadline& deadline);
  void drop_connection();
  Status connect(const Deadline& deadline);
  Status connect_to(const Endpoint& endpoint, const Deadline& deadline);
  // Reads the welcome and says hello on `link`, which is reconnected if a token was refused. Over TCP both sides prove
  // that they know the token before anything else is said, and if they may be on different machines they do so over
  // TLS, unless the token says that the network is trusted. listener: "endpoint" or "rank R". Returns the reply to
  // hello.
  Result<wire::Json> greet(std::unique_ptr<Connection>& link, const Endpoint& endpoint, const std::string& listener,
                           const Deadline& deadline);
  // With one token, or none.
  Result<wire::Json> greet_once(Connection& link, const Endpoint& endpoint, const std::string& listener,
                                const std::string& token, const Deadline& deadline);
  Result<wire::Json> prove_and_say_hello(Connection& link, const std::string& token, auth::Opening opening,
                                         const std::string& where, const Deadline& deadline);
  Result<wire::Json> say_hello(Connection& link, wire::Json more, const Deadline& deadline);
  // The tokens to try at this listener.
  Result<std::vector<std::string>> tokens_to_try(const Connection& link, const Endpoint& endpoint,
                                                 const std::string& listener) const;
  Result<Frame> await_answer(Connection& link, std::uint64_t request, const Deadline& deadline);
  Result<Frame> await_answer_to(std::uint64_t request, const std::string& what, const Deadline& deadline);
  Status open_data(const Deadline& deadline);
  // Of the rank's own listener: on its Unix socket, if it is on this machine and lets us in, else at its address.
  Result<std::unique_ptr<Connection>> open_link(std::size_t rank, const Deadline& deadline);
  // Sends every rank on this host a request over data(), with a descriptor unless it is -1, and waits for all answers.
  Status ask_ranks(const wire::Json& request, int descriptor, const Deadline& deadline);
  // Of data(). New connections are tried once, then the endpoint, if the caller leaves the choice.
  void give_up_data();
  Status lost_connection() const;
  bool held_here(const Status& status) const;

  ConnectOptions options_;
  std::vector<Endpoint> endpoints_;  // to try; after the first connection only the one that answered
  std::string endpoint_text_;
  std::string number_;
  int ranks_ = 0;
  pid_t process_ = 0;          // the one that made the connection
  bool told_goodbye_ = false;  // the service said that it was told to end
  bool told_caller_of_stop_ = false;
  std::uint64_t generation_ = 0;
  std::uint64_t next_request_ = 1;
  std::int64_t next_attempt_ = 1;
  std::unique_ptr<Connection> connection_;
  std::vector<std::string> data_addresses_;   // by rank; empty: no direct path
  std::vector<std::string> local_addresses_;  // by rank: its Unix socket; empty where it is on another machine
  std::unique_ptr<DataPath> data_;
  std::uint64_t data_generation_ = 0;
  bool share_refused_ = false;  // stop_sharing()
  std::int64_t next_memory_ = 1;
  bool data_tried_ = false;  // to open it, on this connection
  int data_failures_ = 0;    // in a row, of data()
  std::string token_;        // the one that was accepted
};

}  // namespace rcb::client
