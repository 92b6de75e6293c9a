// Session: what outlives one connection: where the service is, who we are to it, and how a lost connection is mended.
//
// Invariants
// 1. The session number stays the same over all connections, so the service knows a repeated step for what it is.
// 2. A command is sent again by itself only where doing it twice is the same as doing it once.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "client/lib/client.hpp"
#include "client/lib/connection.hpp"
#include "client/lib/endpoint.hpp"
#include "common/base/status.hpp"
#include "common/plan/plan.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

class DataPath;
struct Column;

// How much longer than the service a client waits, so that the service's own answer arrives first.
double with_margin(double deadline_seconds);

// The bytes of a request, made while they are sent.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  // The next bytes, valid until the next call; none: the end. answered: the answer is there already, so what can be
  // left out at the next frame's start is left out.
  virtual std::span<const Bytes> next(bool answered) = 0;
};

class Session {
 public:
  static Result<std::unique_ptr<Session>> open(const ConnectOptions& options);
  ~Session();  // says goodbye

  // Connects again if the connection is gone. Errors: as open.
  Status ensure(const Deadline& deadline);
  bool connected() const { return connection_ != nullptr; }
  // Rises with every new connection.
  std::uint64_t generation() const { return generation_; }
  std::uint64_t next_request() { return next_request_++; }
  // Of a push. A scene that is made anew begins at step 0 again, but none of its pushes bears an ended one's name.
  std::int64_t next_attempt() { return next_attempt_++; }
  const std::string& number() const { return number_; }
  const std::string& endpoint() const { return endpoint_text_; }
  int ranks() const { return ranks_; }

  // Sends a request on the connection that stands and waits for the answer to it. After a failure !connected() says
  // that the connection was lost.
  Result<Frame> exchange(std::uint64_t request, FrameSource& source, const std::string& what, const Deadline& deadline);
  // The connections to the ranks themselves, opened where that wasn't tried yet; null where there are none.
  DataPath* data(const Deadline& deadline);
  // The push begins with `begin` (whole frames), its slices go over data().
  Result<Frame> exchange_directly(std::uint64_t request, const std::string& begin, const wire::Json& slice,
                                  const std::vector<std::span<const std::uint64_t>>& rows,
                                  std::span<const Column> columns, const std::string& what, const Deadline& deadline);
  Path path() const { return options_.path; }
  // True after a push whose direct path broke; the next push goes another way, or on new connections.
  bool data_lost();
  // One command with all its arguments.
  Result<Frame> call(wire::Json request, double deadline_seconds);
  Result<wire::Json> call_json(wire::Json request, double deadline_seconds);

 private:
  explicit Session(ConnectOptions options);
  Status connect(const Deadline& deadline);
  Status connect_to(const Endpoint& endpoint, const Deadline& deadline);
  // Reads the welcome and says hello on `link`, which is opened anew where a token was refused. The reply to hello.
  Result<wire::Json> greet(std::unique_ptr<Connection>& link, const Endpoint& endpoint, const Deadline& deadline);
  Result<wire::Json> say_hello(Connection& link, const std::string& token, const Deadline& deadline);
  Result<Frame> await_answer(Connection& link, std::uint64_t request, const Deadline& deadline);
  Result<Frame> await_answer_to(std::uint64_t request, const std::string& what, const Deadline& deadline);
  Status open_data(const Deadline& deadline);
  void give_up_data();

  ConnectOptions options_;
  std::vector<Endpoint> endpoints_;  // to try; once one has answered, that one alone
  std::string endpoint_text_;
  std::string number_;
  int ranks_ = 0;
  std::uint64_t generation_ = 0;
  std::uint64_t next_request_ = 1;
  std::int64_t next_attempt_ = 1;
  std::unique_ptr<Connection> connection_;
  std::vector<std::string> data_addresses_;  // by rank; empty: no direct path
  std::unique_ptr<DataPath> data_;
  bool data_tried_ = false;  // on this connection
  bool data_broke_ = false;  // since the last push began
  std::string token_;        // that was taken
};

// Defined here so that Scene sees it; nobody outside this folder does.
struct Client::State {
  std::unique_ptr<Session> session;
};

}  // namespace rcb::client
