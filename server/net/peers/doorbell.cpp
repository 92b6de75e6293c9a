#include "server/net/peers/doorbell.hpp"

#include <cerrno>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "common/base/host_port.hpp"
#include "common/base/tcp_peer.hpp"
#include "common/wire/limits.hpp"
#include "server/net/files/data_directory.hpp"
#include "server/net/peers/host.hpp"
#include "server/net/sockets/connection.hpp"
#include "server/net/sockets/hello.hpp"
#include "server/net/sockets/listen.hpp"

namespace rcb::net {
namespace {

constexpr double kFrameSeconds = 3600;  // long, since the limit on silence ends a dead connection before
constexpr std::size_t kPeerMessageBytesMax = std::size_t{64} << 10U;
constexpr const char* kListener = "doorbell";  // to which proofs are bound
constexpr double kHandshakeSeconds = 10;
constexpr double kConnectSeconds = 5;  // for each address

int silent_ticks_max(double seconds) { return std::max(2, static_cast<int>(std::ceil(seconds / kTickSeconds))); }

// How long nothing has come from a peer. Every byte counts, not only whole messages: a large order takes long over a
// slow link.
class Silence {
 public:
  int ticks() const { return ticks_; }
  // To be called every kTickSeconds.
  void tick(const Connection& connection) {
    const std::uint64_t bytes = connection.bytes_received();
    ticks_ = bytes == std::exchange(bytes_, bytes) ? ticks_ + 1 : 1;
  }
  // Something has come since the last tick.
  void heard(const Connection& connection) {
    ticks_ = 0;
    bytes_ = connection.bytes_received();
  }

 private:
  int ticks_ = 0;
  std::uint64_t bytes_ = 0;
};

// Lets an engine thread wait for a change that the I/O thread makes.
class SharedCondition {
 public:
  template <typename Predicate>
  bool wait(double seconds, Predicate predicate) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, duration_of(seconds), predicate);
  }
  template <typename Change>
  void change(Change make) {
    const std::lock_guard lock(mutex_);
    make();
    changed_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
};

// What a rank has said and can't be taken is missing ever after, which no other rank would know.
template <typename Take>
void or_lost(const LostHandler& lost, const std::string& from, Take take) {
  try {
    take();
  } catch (const std::exception& fault) {
    lost(fmt::format("an internal fault in what {} said: {}", from, fault.what()));
  }
}

// Listens for ranks on other machines: on the interface that is named, else on all, and lists where that is.
Result<TcpAcceptor> listen_for_ranks(asio::io_context& context, const std::string& interface,
                                     std::vector<std::string>& addresses) {
  auto found = addresses_on(interface);
  if (!found.ok()) return found.status();
  const bool one = !interface.empty() && found->size() == 1;
  auto acceptor = listen_tcp(context, join_host_port(one ? found->front() : "::", 0), Network::trusted);
  if (!acceptor.ok() && !one) acceptor = listen_tcp(context, "0.0.0.0:0", Network::trusted);
  if (!acceptor.ok()) return acceptor.status();
  error_code error;
  const std::uint16_t port = acceptor->local_endpoint(error).port();
  for (const std::string& address : *found) addresses.push_back(join_host_port(address, port));
  return acceptor;
}

// A connection to the first of these addresses that answers; without the loop, which has not started yet.
Result<asio::ip::tcp::socket> connect_to_any(asio::io_context& context, const std::vector<std::string>& addresses) {
  std::string tried;
  for (const std::string& address : addresses) {
    asio::io_context waiting;
    asio::ip::tcp::socket socket(waiting);
    error_code error;
    const HostPort parts = split_host_port(address);
    const asio::ip::tcp::endpoint endpoint(asio::ip::make_address(parts.host, error),
                                           port_number(parts.port).value_or(0));
    error = asio::error::timed_out;
    socket.async_connect(endpoint, [&error](const error_code& ended) { error = ended; });
    waiting.run_for(duration_of(kConnectSeconds));
    if (!error) {
      asio::ip::tcp::socket connected(context, endpoint.protocol(), socket.release());
      connected.set_option(asio::ip::tcp::no_delay(true), error);
      set_keep_alive(connected.native_handle(), kPeerGoneSeconds, kPeerGoneSeconds);
      return connected;
    }
    tried += fmt::format("{}{} ({})", tried.empty() ? "" : ", ", address, error.message());
  }
  return Status(Code::unavailable, fmt::format("rank 0 can't be reached at {}", tried),
                "name the network that all hosts share with --interface");
}

}  // namespace

std::string DoorbellAddress::text() const {
  return wire::Json{{"path", path}, {"secret", secret}, {"tcp", tcp}}.dump();
}

DoorbellAddress DoorbellAddress::parse(const std::string& text) {
  const wire::Json json = wire::Json::parse(text);
  return {json.at("path").get<std::string>(), json.at("secret").get<std::string>(),
          json.at("tcp").get<std::vector<std::string>>()};
}

struct DoorbellHub::State : std::enable_shared_from_this<State> {
  struct Peer {
    std::shared_ptr<Connection> connection;
    Silence silence;
    bool goodbye = false;
  };

  State(IoLoop& io, HubOptions chosen, LostHandler handler)
      : loop(io),
        options(std::move(chosen)),
        address{{}, auth::random_hex(32), {}},
        door({.listener = kListener,
              .credentials = Credentials{address.secret, {}},  // without TLS, as MPI is
              .hello_seconds = kHandshakeSeconds,
              .waiting_max = wire::kBeforeHelloMax + static_cast<std::size_t>(options.ranks)}),
        peers(static_cast<std::size_t>(options.ranks)),
        ticks_max(silent_ticks_max(options.silence_seconds)),
        lost(std::move(handler)) {}

  template <typename Acceptor>
  void accept(Acceptor& acceptor) {
    auto take = [self = shared_from_this()](Socket socket, const Status& peer) {
      if (!peer.ok()) return;                                                      // closes it
      set_keep_alive(socket.native_handle(), kPeerGoneSeconds, kPeerGoneSeconds);  // longer than for clients
      auto connection = std::make_shared<Connection>(std::move(socket), kFrameSeconds);
      asio::co_spawn(
          self->loop.context(), [self, connection] { return self->serve(connection); }, asio::detached);
    };
    asio::co_spawn(loop.context(), accept_all(loop.context(), acceptor, std::move(take)), asio::detached);
  }

  // In a folder of its own: to a socket that other users can reach they could send descriptors whose end, in the
  // kernel, holds up whoever closes the connection.
  Status listen_in(std::string folder) {
    folder += "/doorbell-XXXXXX";
    if (::mkdtemp(folder.data()) == nullptr)
      return {Code::io_error, fmt::format("{} can't be made: {}", folder, std::strerror(errno))};
    address.path = folder + "/socket";
    auto listening = listen_unix(loop.context(), address.path);
    if (!listening.ok()) remove_files();
    if (!listening.ok()) return listening.status();
    listener.emplace(std::move(*listening));
    accept(listener->acceptor);
    return {};
  }

  // Not every file system takes sockets, and not every path is short enough for one.
  Status listen_here() { return listen_in(options.folder).ok() ? Status() : listen_in("/tmp"); }

  void remove_files() {
    if (listener) listener->name.remove();
    if (!address.path.empty()) ::rmdir(address.path.substr(0, address.path.rfind('/')).c_str());
  }

  void listen_no_more() {
    error_code ignored;
    if (listener) listener->acceptor.close(ignored);
    if (tcp_acceptor) tcp_acceptor->close(ignored);
  }

  std::string name_of(std::size_t rank) const {
    return options.hosts.empty() ? fmt::format("rank {}", rank)
                                 : fmt::format("rank {} on {}", rank, options.hosts[rank]);
  }

  awaitable<void> serve(std::shared_ptr<Connection> connection) {
    const Result<Hello> hello = co_await door.greet(connection);
    const auto rank = hello.ok() ? wire::parse_hex64(hello->session) : Result<std::uint64_t>(hello.status());
    if (!rank.ok() || *rank == 0 || *rank >= peers.size() || peers[*rank].connection) co_return connection->close();
    Door::let_in(*connection, *hello, wire::Json::object());
    const auto index = static_cast<std::size_t>(*rank);
    Peer& peer = peers[index];
    peer.connection = connection;
    if (connected + 2 == peers.size()) listen_no_more();
    gathering.change([&] { ++connected; });
    while (true) {
      Result<Frame> frame = co_await connection->read_frame(kPeerMessageBytesMax, 0);
      if (!frame.ok()) {
        if (!peer.goodbye && !finished)
          lost(fmt::format("{} is lost: {}", name_of(index),
                           frame.status().message().empty() ? "its process ended" : frame.status().message()));
        co_return;
      }
      peer.silence.heard(*connection);
      if (frame->header.type == wire::FrameType::goodbye) gathering.change([&] { peer.goodbye = true; });
      if (frame->header.type == wire::FrameType::notice && !frame->json.empty() && message)
        or_lost(lost, name_of(index), [&] { message(static_cast<int>(index), frame->json); });
    }
  }

  bool all_said_goodbye() const {
    for (std::size_t i = 1; i < peers.size(); ++i)
      if (!peers[i].goodbye) return false;
    return true;
  }

  IoLoop& loop;
  HubOptions options;
  DoorbellAddress address;
  std::optional<UnixListener> listener;
  std::optional<TcpAcceptor> tcp_acceptor;
  Door door;
  std::vector<Peer> peers;  // by rank; [0] is unused
  std::size_t connected = 0;
  int ticks_max;
  PeerMessageHandler message;
  LostHandler lost;
  SharedCondition gathering;
  bool finished = false;
};

DoorbellHub::DoorbellHub(std::shared_ptr<State> state) : state_(std::move(state)) {}
DoorbellHub::~DoorbellHub() { state_->remove_files(); }

Result<std::unique_ptr<DoorbellHub>> DoorbellHub::open(IoLoop& loop, HubOptions options, LostHandler lost) {
  auto state = std::make_shared<State>(loop, std::move(options), std::move(lost));
  if (state->options.ranks > 1) {
    if (Status status = state->listen_here(); !status.ok()) return status;
  }
  // A misspelt interface is an error on one machine too.
  if (const auto found = addresses_on(state->options.interface); !state->options.interface.empty() && !found.ok())
    return found.status();
  if (!state->options.hosts.empty()) {
    auto acceptor = listen_for_ranks(loop.context(), state->options.interface, state->address.tcp);
    if (!acceptor.ok()) return acceptor.status();
    state->tcp_acceptor.emplace(std::move(*acceptor));
    state->accept(*state->tcp_acceptor);
  }
  return std::unique_ptr<DoorbellHub>(new DoorbellHub(std::move(state)));
}

const DoorbellAddress& DoorbellHub::address() const { return state_->address; }

Status DoorbellHub::wait_connected(double seconds) {
  State& state = *state_;
  const bool all = state.gathering.wait(seconds, [&] { return state.connected + 1 == state.peers.size(); });
  state.remove_files();
  if (all) return {};
  return {Code::deadline_exceeded,
          fmt::format("only {} of {} ranks came within {} s", state.connected + 1, state.peers.size(), seconds)};
}

void DoorbellHub::ring(std::uint64_t number, const std::string& request) {
  // Encoded once, however many ranks there are.
  const auto frame = std::make_shared<const std::string>(
      wire::encode_frame({.type = wire::FrameType::request, .request = number}, request));
  for (State::Peer& peer : state_->peers)
    if (peer.connection) peer.connection->send_shared(frame);
}

void DoorbellHub::on_peer_message(PeerMessageHandler handler) { state_->message = std::move(handler); }

void DoorbellHub::tell(int rank, const wire::Json& message) {
  const State::Peer& peer = state_->peers[static_cast<std::size_t>(rank)];
  if (peer.connection) peer.connection->send(wire::FrameType::notice, 0, message);
}

void DoorbellHub::tick() {
  for (std::size_t i = 1; i < state_->peers.size(); ++i) {
    State::Peer& peer = state_->peers[i];
    if (!peer.connection || peer.goodbye || state_->finished) continue;
    peer.silence.tick(*peer.connection);
    if (peer.silence.ticks() > state_->ticks_max) {
      peer.goodbye = true;
      state_->lost(fmt::format("{} has been silent for {} s", state_->name_of(i), state_->ticks_max * kTickSeconds));
      continue;
    }
    peer.connection->send_text(wire::FrameType::notice, 0, "{}");
  }
}

std::vector<SilentRank> DoorbellHub::silent() const {
  constexpr int kTicks = 2;  // a live rank may miss so many
  std::vector<SilentRank> list;
  for (std::size_t i = 1; i < state_->peers.size(); ++i)
    if (const State::Peer& peer = state_->peers[i]; peer.silence.ticks() > kTicks && !peer.goodbye)
      list.push_back({static_cast<int>(i), peer.silence.ticks() * kTickSeconds});
  return list;
}

void DoorbellHub::finish(double seconds) {
  State& state = *state_;
  state.loop.run([&] {
    for (State::Peer& peer : state.peers)
      if (peer.connection) peer.connection->send(wire::FrameType::goodbye, 0, wire::Json::object());
  });
  const bool all = state.gathering.wait(seconds, [&] { return state.all_said_goodbye(); });
  state.loop.run([&] {
    state.finished = true;
    if (!all) state.lost("a rank didn't say goodbye in time");
    for (State::Peer& peer : state.peers)
      if (peer.connection) peer.connection->close();
    state.listen_no_more();
  });
}

struct Doorbell::State : std::enable_shared_from_this<State> {
  State(IoLoop& io, int own, std::string job_secret) : loop(io), rank(own), secret(std::move(job_secret)) {}

  // As a client says hello (hello.hpp): both sides prove that they know the secret before this one takes any order.
  awaitable<bool> shake_hands() {
    connection->limit_reading(now() + duration_of(kHandshakeSeconds + ticks_max * kTickSeconds));
    const Result<Frame> welcome = co_await connection->read_frame(wire::kBytesBeforeHelloMax, 0);
    if (!welcome.ok() || welcome->header.type != wire::FrameType::welcome) co_return false;
    const auto nonce = wire::string_field(welcome->json, "nonce");
    if (!nonce.ok() || !auth::is_nonce(*nonce)) co_return false;
    const auth::Opening opening{kListener, *nonce, auth::random_nonce(), wire::hex64(static_cast<std::uint64_t>(rank))};
    connection->send(wire::FrameType::hello, 1,
                     {{"protocol", wire::kProtocolVersion},
                      {"client", fmt::format("rank {}", rank)},
                      {"session", opening.session},
                      {"nonce", opening.client_nonce},
                      {"proof", auth::proof(auth::Role::client, secret, opening)}});
    const Result<Frame> reply = co_await connection->read_frame(wire::kBytesBeforeHelloMax, 0);
    if (!reply.ok() || reply->header.type != wire::FrameType::reply) co_return false;
    const auto proof = wire::string_field(reply->json, "proof");
    if (!proof.ok() || !auth::same_secret(*proof, auth::proof(auth::Role::service, secret, opening))) co_return false;
    connection->limit_reading(TimePoint::max());
    co_return true;
  }

  awaitable<void> listen() {
    ready = co_await shake_hands();
    if (!ready) {
      if (!finished) lost("rank 0 hasn't shown that it is this job's");
      co_return;
    }
    while (true) {
      Result<Frame> frame = co_await connection->read_frame(wire::kJsonBytesMax, 0);
      if (!frame.ok()) {
        if (!goodbye && !finished) lost("rank 0 is lost: its process ended");
        co_return;
      }
      silence.heard(*connection);
      if (frame->header.type == wire::FrameType::goodbye) gathering.change([&] { goodbye = true; });
      or_lost(lost, "rank 0", [&] {
        if (frame->header.type == wire::FrameType::notice && !frame->json.empty() && message) message(0, frame->json);
        if (frame->header.type == wire::FrameType::request) ordered(frame->header.request, std::move(frame->json));
      });
    }
  }

  IoLoop& loop;
  int rank;
  std::string secret;
  std::string local_address;
  std::shared_ptr<Connection> connection;
  bool ready = false;  // both have proved who they are
  Silence silence;     // of rank 0
  int ticks_max = 0;
  OrderHandler ordered;
  PeerMessageHandler message;
  LostHandler lost;
  SharedCondition gathering;
  bool goodbye = false;
  bool finished = false;
};

Doorbell::Doorbell(std::shared_ptr<State> state) : state_(std::move(state)) {}
Doorbell::~Doorbell() = default;

Result<std::unique_ptr<Doorbell>> Doorbell::connect(IoLoop& loop, int rank, const DoorbellAddress& address,
                                                    bool same_host, double silence_seconds, OrderHandler ordered,
                                                    LostHandler lost) {
  auto state = std::make_shared<State>(loop, rank, address.secret);
  state->ticks_max = silent_ticks_max(silence_seconds);
  state->ordered = std::move(ordered);
  state->lost = std::move(lost);
  error_code error;
  if (same_host) {
    asio::local::stream_protocol::socket socket(loop.context());
    socket.connect({address.path}, error);
    if (error) return Status(Code::unavailable, fmt::format("rank {} can't reach rank 0: {}", rank, error.message()));
    state->connection = std::make_shared<Connection>(Socket(std::move(socket)), kFrameSeconds);
  } else {
    auto socket = connect_to_any(loop.context(), address.tcp);
    if (!socket.ok()) return socket.status();
    state->local_address = socket->local_endpoint(error).address().to_string();
    state->connection = std::make_shared<Connection>(Socket(std::move(*socket)), kFrameSeconds);
  }
  asio::co_spawn(
      loop.context(), [state] { return state->listen(); }, asio::detached);
  return std::unique_ptr<Doorbell>(new Doorbell(std::move(state)));
}

const std::string& Doorbell::local_address() const { return state_->local_address; }

void Doorbell::on_peer_message(PeerMessageHandler handler) { state_->message = std::move(handler); }

void Doorbell::tell(const wire::Json& message) { state_->connection->send(wire::FrameType::notice, 0, message); }

void Doorbell::tick(const wire::Json& word) {
  if (!state_->ready || state_->goodbye || state_->finished) return;
  tell(word);
  state_->silence.tick(*state_->connection);
  if (state_->silence.ticks() <= state_->ticks_max) return;
  state_->finished = true;
  state_->lost(fmt::format("rank 0 has been silent for {} s", state_->ticks_max * kTickSeconds));
}

void Doorbell::finish(double seconds) {
  State& state = *state_;
  state.loop.run([&] { state.connection->send(wire::FrameType::goodbye, 0, wire::Json::object()); });
  const bool heard = state.gathering.wait(seconds, [&] { return state.goodbye; });
  state.loop.run([&] {
    state.finished = true;
    if (!heard) state.lost("rank 0 didn't say goodbye in time");
    state.connection->close();
  });
}

}  // namespace rcb::net
