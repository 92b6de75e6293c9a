#include "server/net/control/control.hpp"

#include <list>
#include <thread>
#include <type_traits>
#include <utility>

#include <spdlog/spdlog.h>

#include "common/base/byte_size.hpp"
#include "common/files/paths.hpp"
#include "server/net/control/coordinator.hpp"
#include "server/net/control/session.hpp"
#include "server/net/sockets/listen.hpp"

namespace rcb::net {

struct Control::State : std::enable_shared_from_this<State> {
  State(IoLoop& io, ControlOptions options, Engine& engine)
      : loop(io), coordinator(std::make_shared<Coordinator>(io.context(), std::move(options), engine)) {}

  // endpoint: the name by which clients know the listener. Each listener has its own door, so that connections waiting
  // to say hello at one don't push out those at another.
  template <typename Acceptor>
  void accept(Acceptor& acceptor, std::string endpoint) {
    const ControlOptions& options = coordinator->options();
    constexpr bool kTcp = std::is_same_v<Acceptor, TcpAcceptor>;
    DoorOptions door{.listener = "endpoint",
                     .credentials = {},
                     .hello_seconds = options.hello_seconds,
                     .waiting_max = options.waiting_max};
    if (kTcp) door.credentials = options.credentials;
    const bool files = !kTcp || options.files_over_tcp;
    doors.push_back(std::make_shared<Door>(std::move(door)));
    auto take = [self = shared_from_this(), entrance = Entrance{std::move(endpoint), doors.back(), late, files}](
                    Socket socket, const Status& peer) { self->welcome(std::move(socket), entrance, peer); };
    asio::co_spawn(loop.context(), accept_all(loop.context(), acceptor, std::move(take)), asio::detached);
  }

  void welcome(Socket socket, const Entrance& entrance, const Status& refused) {
    if (!refused.ok() && refusing >= kRefusingMax) return;  // closes the socket without an answer
    auto session = std::make_shared<Session>(coordinator, std::move(socket), entrance);
    if (!refused.ok()) {
      ++refusing;
      spdlog::info("connection refused: {}", refused.message());
    }
    asio::co_spawn(
        loop.context(),
        [session, refused]() -> awaitable<void> {
          if (refused.ok())
            co_await session->run();
          else
            co_await session->refuse(refused);
        },
        [self = shared_from_this(), session, was_refused = !refused.ok()](const std::exception_ptr& fault) {
          if (was_refused) --self->refusing;
          if (fault) self->contain(*session, fault);
        });
  }

  // An exception here is a bug or a failed allocation: this client loses its connection, the others are unaffected.
  void contain(Session& session, const std::exception_ptr& fault) {
    coordinator->leave(&session);
    session.connection()->close();
    try {
      std::rethrow_exception(fault);
    } catch (const std::exception& what) {
      spdlog::error("session of {} ended by an internal fault: {}", session.client(), what.what());
    }
  }

  void stop_listening() {
    error_code ignored;
    unix_listener.close();
    for (TcpAcceptor& acceptor : tcp_acceptors) acceptor.close(ignored);
    for (const auto& door : doors) door->close();
  }

  static constexpr int kRefusingMax = 64;
  IoLoop& loop;
  std::shared_ptr<Coordinator> coordinator;
  LastingListener unix_listener;
  std::string unix_path;
  std::list<TcpAcceptor> tcp_acceptors;
  std::vector<std::shared_ptr<Door>> doors;
  std::shared_ptr<Lobby> late =
      std::make_shared<Lobby>(wire::kSessionsReserved,
                              Status(Code::busy, "all sessions are taken, and another client came that needs an answer",
                                     "try again when one has ended"));
  int refusing = 0;
};

Control::Control(IoLoop& loop, ControlOptions options, Engine& engine)
    : state_(std::make_shared<State>(loop, std::move(options), engine)) {}

Control::~Control() { state_->stop_listening(); }

Status Control::listen_unix(const std::string& path) {
  if (Status status = state_->unix_listener.listen(state_->loop.context(), path); !status.ok()) return status;
  state_->unix_path = path;
  state_->coordinator->add_endpoint("unix:" + path, false);
  return {};
}

Result<std::string> Control::listen_tcp(const std::string& where) {
  const Network network = state_->coordinator->options().credentials.network();
  Result<TcpAcceptor> acceptor = net::listen_tcp(state_->loop.context(), where, network);
  if (!acceptor.ok()) return acceptor.status();
  std::string bound = bound_address(*acceptor);
  state_->coordinator->add_endpoint(bound, network == Network::encrypted && !on_loopback(*acceptor));
  state_->tcp_acceptors.push_back(std::move(*acceptor));
  return bound;
}

void Control::serve_data(DataPlane& plane, const std::string& endpoint, std::vector<std::string> addresses) {
  state_->coordinator->serve_data(plane, endpoint, std::move(addresses));
}

void Control::serve_this_machine(std::vector<LocalAddress> addresses) {
  state_->coordinator->serve_this_machine(std::move(addresses));
}

void Control::set_silence_query(std::function<std::vector<SilentRank>()> ask) {
  state_->coordinator->set_silence_query(std::move(ask));
}

void Control::memory_reported(int rank, std::uint64_t resident_bytes) {
  state_->coordinator->memory_reported(rank, resident_bytes);
}

void Control::slice_reported(int rank, const SliceReport& report) { state_->coordinator->slice_reported(rank, report); }

void Control::start() {
  state_->coordinator->restore_scenes();
  state_->unix_listener.start(
      [state = state_.get()](UnixAcceptor& acceptor) { state->accept(acceptor, "unix:" + state->unix_path); });
  for (TcpAcceptor& acceptor : state_->tcp_acceptors) state_->accept(acceptor, bound_address(acceptor));
}

void Control::tick() { state_->unix_listener.look(); }

void Control::shut_down(const std::string& why) {
  state_->loop.post([state = state_, why] { state->coordinator->shut_down(why, [] {}); });
}

void Control::finish(double seconds) {
  state_->loop.run([this] { state_->stop_listening(); });
  const TimePoint end = now() + duration_of(seconds);
  bool empty = false;
  while (!empty && now() < end) {
    state_->loop.run([&] { empty = state_->coordinator->session_count() == 0; });
    if (!empty) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
}

std::uint64_t bulk_bytes_default() { return machine_bytes() / 2; }

}  // namespace rcb::net
