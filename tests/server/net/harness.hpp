// A service without MPI: the real sockets, sessions and coordinator over an engine that is a function, and a client
// that is written against PROTOCOL.md with bare system calls.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/wire/frame.hpp"
#include "common/wire/message.hpp"
#include "server/net/control/control.hpp"
#include "server/net/sockets/file_thread.hpp"
#include "tests/support/directory.hpp"

namespace rcb::net::testing {

using rcb::testing::Directory;

inline constexpr const char* kAnna = "00000000000000aa";  // sessions
inline constexpr const char* kBert = "00000000000000bb";

inline constexpr std::uint64_t kCutsHash = 0xc075;  // of every scene after its first push; their epoch is 1

// Executes orders one by one on its own thread. Knows scene.create, scene.drop, push (after which all parts have
// equally many particles, or one more), scene.restore (but of "refused") and fetch (an answer with as many doubles as
// the scene's name says: "n1000"); anything else is answered with {"echo": command}.
class FakeEngine final : public Engine {
 public:
  FakeEngine();
  ~FakeEngine() override;
  void submit(Order order, std::function<void(Answer)> done) override;

  // While held, orders pile up.
  void hold();
  void release();
  // Until so many orders wait; the test fails where they don't come in time.
  void wait_for_orders(std::size_t count);
  // Until nobody waits for the first of them; the test fails where that isn't so in time.
  void wait_for_cancelled();
  // Commands executed so far, "push step 3" with its step.
  std::vector<std::string> executed() const;
  // The last order's request.
  wire::Json request() const;
  // The slices of the last push or scene.restore.
  std::vector<Slice> slices() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

struct Received {
  wire::FrameType type = wire::FrameType::goodbye;
  std::uint64_t request = 0;
  wire::Json json;
  std::string bulk;
  bool ended = false;  // the connection ended instead

  std::string code() const;  // of a failure, else ""
  std::string message() const;
  std::string hint() const;
};

class Client {
 public:
  Client() = default;
  Client(Client&& other) noexcept;
  Client& operator=(Client&& other) noexcept;
  ~Client();
  static Client on_unix(const std::string& path);
  static Client on_tcp(const std::string& address);

  void send_bytes(const std::string& bytes);  // a connection that is gone is no fault
  std::uint64_t send(wire::FrameType type, wire::Json json, const std::string& bulk = {}, bool checked = false);
  std::uint64_t request(const std::string& command, wire::Json arguments = wire::Json::object());
  // The next frame; the test fails where none comes in time.
  Received receive();
  Received receive_but_notices();
  Received call(const std::string& command, wire::Json arguments = wire::Json::object());
  // Reads the welcome and says hello, with a proof of the token where one is given; gives the answer.
  Received hello(const std::string& name, const std::string& session, const std::string& token = {},
                 const std::string& listener = "endpoint");
  // A push of two axes, with the values 0, 1, ..., unless `more` says other arrays or another way. Returns the bulk as
  // it was sent.
  std::string push(std::int64_t step, std::uint64_t n, const wire::Json& more = wire::Json::object(),
                   bool checked = false);
  // The same without its bulk; then that.
  void begin(std::int64_t step, std::uint64_t n, const wire::Json& more = wire::Json::object());
  void finish(std::uint64_t n);
  void close();

 private:
  explicit Client(int socket) : socket_(socket) {}
  bool read(char* into, std::size_t bytes);
  int socket_ = -1;
  std::uint64_t next_ = 1;
};

// Runs what waits in the loop until the condition holds; the test fails where it does not in time.
void run_until(asio::io_context& context, const std::function<bool()>& holds);

// A frame as bytes.
std::string frame(wire::FrameType type, std::uint64_t request, const std::string& json, const std::string& bulk = {},
                  bool checked = false);

class TestService {
 public:
  explicit TestService(ControlOptions options = defaults());
  explicit TestService(const std::function<void(ControlOptions&)>& change);  // of the defaults
  ~TestService();
  static ControlOptions defaults();

  Client connect() { return Client::on_unix(path()); }
  // Said hello.
  Client client(const std::string& name, const std::string& session = "00000000000000aa");
  std::string path() const { return directory_ / "s"; }
  const std::string& tcp() const { return tcp_; }
  FakeEngine& engine() { return engine_; }
  Control& control() { return *control_; }

 private:
  Directory directory_;
  IoLoop loop_;
  FakeEngine engine_;  // ends before the loop it answers to
  std::unique_ptr<Control> control_;
  std::string tcp_;
};

}  // namespace rcb::net::testing
