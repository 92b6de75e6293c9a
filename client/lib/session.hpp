// Session: what outlives one connection: where the service is, who we are to it, and how a lost service is reached
// again.
//
// Invariants
// 1. The session number stays the same over all connections, so the service knows a repeated step for what it is.
// 2. A command is sent again by itself only where doing it twice is the same as doing it once, or where the service
//    that may have done it is no more.
// 3. persist() is the only loop in which a call waits for a service that has gone.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include <fmt/format.h>

#include "client/lib/client.hpp"
#include "client/lib/connection.hpp"
#include "client/lib/endpoint.hpp"
#include "client/lib/retry.hpp"
#include "common/auth/proof.hpp"
#include "common/base/status.hpp"
#include "common/plan/plan.hpp"
#include "common/wire/message.hpp"

namespace rcb::client {

class DataPath;
struct Column;

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

  bool connected() const { return connection_ != nullptr; }
  // Rises with every new connection.
  std::uint64_t generation() const { return generation_; }
  // Names the run of the service that the last connection was to: where it is another one, all scenes were lost.
  const std::string& instance() const { return instance_; }
  // The service was started again since this session began.
  bool restarted() const { return instance_ != first_instance_; }
  bool outlive() const { return options_.outlive; }
  // What waits tell; may be empty.
  const NoticeHandler& on_notice() const { return options_.on_notice; }

  // Does `once`, on a connection that stands, until it ends otherwise than by the loss of the service. Any other
  // failure is shown to `mend`: true, and `once` is done again. `once` returns a Result and makes no loop of its own.
  template <typename Once, typename Mend>
  std::invoke_result_t<Once&> persist(Retry& retry, Once&& once, Mend&& mend) {
    for (;;) {
      Status status = ensure(retry.deadline());
      if (status) {
        if (retry.end_of_waiting()) notice(fmt::format("{} answers again", endpoint_text_));
        auto result = once();
        if (result) return result;
        status = result.status();
        const bool lost = status.code() == Code::unavailable && !connected();
        if (!lost && mend(status)) continue;
        if (!lost) return status;
      }
      if (Status over = wait(retry, status, gone()); !over) return over;
    }
  }
  // Before another try: ok when it is due, else why there is none. why: what the last one met; what: is waited for.
  Status wait(Retry& retry, const Status& why, const std::string& what) const;
  // "the service at E, which has gone"
  std::string gone() const;
  void notice(const std::string& text) const;
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
  // One command with all its arguments; waits for a lost service.
  Result<Frame> call(wire::Json request, double deadline_seconds);
  // The same on the connection that stands, once: a part of what persist() does.
  Result<Frame> call_once(wire::Json request, const Retry& retry);
  Result<wire::Json> ask_once(wire::Json request, const Retry& retry);

 private:
  explicit Session(ConnectOptions options);
  // Connects again if the connection is gone. Errors: as open.
  Status ensure(const Deadline& deadline);
  void drop_connection();
  Status connect(const Deadline& deadline);
  Status connect_to(const Endpoint& endpoint, const Deadline& deadline);
  // Reads the welcome and says hello on `link`, which is opened anew where a token was refused. Over TCP both sides
  // prove that they know the token before anything else is said. listener: "endpoint" or "rank R". The reply to hello.
  Result<wire::Json> greet(std::unique_ptr<Connection>& link, const Endpoint& endpoint, const std::string& listener,
                           const Deadline& deadline);
  Result<wire::Json> prove_and_say_hello(Connection& link, const std::string& token, auth::Opening opening,
                                         const std::string& where, const Deadline& deadline);
  Result<wire::Json> say_hello(Connection& link, wire::Json more, const Deadline& deadline);
  // The tokens to try there. Errors: not_authorised where there is none.
  Result<std::vector<std::string>> tokens_to_try(const Connection& link, const Endpoint& endpoint,
                                                 const std::string& listener) const;
  Result<Frame> await_answer(Connection& link, std::uint64_t request, const Deadline& deadline);
  Result<Frame> await_answer_to(std::uint64_t request, const std::string& what, const Deadline& deadline);
  Status open_data(const Deadline& deadline);
  void give_up_data();

  ConnectOptions options_;
  std::vector<Endpoint> endpoints_;  // to try; once one has answered, that one alone
  std::string endpoint_text_;
  std::string number_;
  int ranks_ = 0;
  std::string instance_, first_instance_;
  bool told_goodbye_ = false;  // by the service, which ended as it was told
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

}  // namespace rcb::client
