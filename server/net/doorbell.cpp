#include "server/net/doorbell.hpp"

#include <cmath>
#include <condition_variable>
#include <mutex>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "common/auth/proof.hpp"
#include "common/wire/limits.hpp"
#include "server/net/connection.hpp"
#include "server/net/data_directory.hpp"
#include "server/net/listen.hpp"

namespace rcb::net {
namespace {

constexpr double kFrameSeconds = 3600;  // the rule about silence decides, and comes first
constexpr std::size_t kNewsBytesMax = std::size_t{64} << 10U;

int silent_ticks_max(double seconds) { return std::max(2, static_cast<int>(std::ceil(seconds / kTickSeconds))); }

// The engine threads wait on it for what the I/O thread sees.
class Gathering {
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

}  // namespace

struct DoorbellHub::State : std::enable_shared_from_this<State> {
  struct Peer {
    std::shared_ptr<Connection> connection;
    int silent_ticks = 0;
    bool goodbye = false;
  };

  State(IoLoop& io, int ranks, double silence_seconds, LostHandler handler)
      : loop(io),
        peers(static_cast<std::size_t>(ranks)),
        ticks_max(silent_ticks_max(silence_seconds)),
        lost(std::move(handler)) {}

  awaitable<void> accept() {
    while (acceptor) {
      asio::local::stream_protocol::socket socket(loop.context());
      auto [error] = co_await acceptor->async_accept(socket, kAwait);
      if (error) co_return;
      if (!check_peer_user(socket.native_handle()).ok()) continue;
      auto connection = std::make_shared<Connection>(Socket(std::move(socket)), kFrameSeconds);
      asio::co_spawn(
          loop.context(), [self = shared_from_this(), connection] { return self->serve(connection); }, asio::detached);
    }
  }

  awaitable<void> serve(std::shared_ptr<Connection> connection) {
    Result<Frame> first = co_await connection->read_frame(wire::kBytesBeforeHelloMax, 0);
    if (!first.ok() || first->header.type != wire::FrameType::hello) co_return connection->close();
    const auto rank = wire::integer_field(first->json, "rank", 1, static_cast<std::int64_t>(peers.size()) - 1);
    const auto secret = wire::string_field(first->json, "secret");
    if (!rank.ok() || !secret.ok() || !auth::same_secret(*secret, address.secret)) co_return connection->close();
    const auto index = static_cast<std::size_t>(*rank);
    Peer& peer = peers[index];
    if (peer.connection) co_return connection->close();
    peer.connection = connection;
    if (connected + 2 == peers.size()) acceptor.reset();  // the last one
    gathering.change([&] { ++connected; });
    while (true) {
      Result<Frame> frame = co_await connection->read_frame(kNewsBytesMax, 0);
      if (!frame.ok()) {
        if (!peer.goodbye && !finished)
          lost(fmt::format("rank {} is lost: {}", index,
                           frame.status().message().empty() ? "its process ended" : frame.status().message()));
        co_return;
      }
      peer.silent_ticks = 0;
      if (frame->header.type == wire::FrameType::goodbye) gathering.change([&] { peer.goodbye = true; });
      if (frame->header.type == wire::FrameType::notice && !frame->json.empty() && news)
        news(static_cast<int>(index), frame->json);
    }
  }

  bool all_said_goodbye() const {
    for (std::size_t i = 1; i < peers.size(); ++i)
      if (!peers[i].goodbye) return false;
    return true;
  }

  IoLoop& loop;
  DoorbellAddress address;
  std::optional<UnixAcceptor> acceptor;
  std::vector<Peer> peers;  // [0] is this rank, unused
  std::size_t connected = 0;
  int ticks_max;
  NewsHandler news;
  LostHandler lost;
  Gathering gathering;
  bool finished = false;
};

DoorbellHub::DoorbellHub(std::shared_ptr<State> state) : state_(std::move(state)) {}
DoorbellHub::~DoorbellHub() = default;

Result<std::unique_ptr<DoorbellHub>> DoorbellHub::open(IoLoop& loop, int ranks, double silence_seconds,
                                                       LostHandler lost) {
  auto state = std::make_shared<State>(loop, ranks, silence_seconds, std::move(lost));
  if (ranks > 1) {
    state->address = {"rcbd-doorbell-" + auth::random_hex(16), auth::random_hex(32)};
    Result<UnixAcceptor> acceptor = listen_nameless(loop.context(), state->address.name);
    if (!acceptor.ok()) return acceptor.status();
    state->acceptor.emplace(std::move(*acceptor));
    asio::co_spawn(
        loop.context(), [state] { return state->accept(); }, asio::detached);
  }
  return std::unique_ptr<DoorbellHub>(new DoorbellHub(std::move(state)));
}

const DoorbellAddress& DoorbellHub::address() const { return state_->address; }

Status DoorbellHub::wait_connected(double seconds) {
  State& state = *state_;
  if (state.gathering.wait(seconds, [&] { return state.connected + 1 == state.peers.size(); })) return {};
  return {Code::deadline_exceeded,
          fmt::format("only {} of {} ranks came within {} s", state.connected + 1, state.peers.size(), seconds)};
}

void DoorbellHub::ring(std::uint64_t number, const std::string& request) {
  for (State::Peer& peer : state_->peers)
    if (peer.connection) peer.connection->send_text(wire::FrameType::request, number, request);
}

void DoorbellHub::on_news(NewsHandler handler) { state_->news = std::move(handler); }

void DoorbellHub::tell(int rank, const wire::Json& news) {
  const State::Peer& peer = state_->peers[static_cast<std::size_t>(rank)];
  if (peer.connection) peer.connection->send(wire::FrameType::notice, 0, news);
}

void DoorbellHub::tick() {
  for (std::size_t i = 1; i < state_->peers.size(); ++i) {
    State::Peer& peer = state_->peers[i];
    if (!peer.connection || peer.goodbye || state_->finished) continue;
    if (++peer.silent_ticks > state_->ticks_max) {
      peer.goodbye = true;
      state_->lost(fmt::format("rank {} has been silent for {} s", i, state_->ticks_max * kTickSeconds));
      continue;
    }
    peer.connection->send_text(wire::FrameType::notice, 0, "{}");
  }
}

std::vector<SilentRank> DoorbellHub::silent() const {
  constexpr int kTicks = 2;  // more than a rank that lives may miss
  std::vector<SilentRank> list;
  for (std::size_t i = 1; i < state_->peers.size(); ++i)
    if (const State::Peer& peer = state_->peers[i]; peer.silent_ticks > kTicks && !peer.goodbye)
      list.push_back({static_cast<int>(i), peer.silent_ticks * kTickSeconds});
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
    state.acceptor.reset();
  });
}

struct Doorbell::State : std::enable_shared_from_this<State> {
  explicit State(IoLoop& io) : loop(io) {}

  awaitable<void> listen() {
    while (true) {
      Result<Frame> frame = co_await connection->read_frame(wire::kJsonBytesMax, 0);
      if (!frame.ok()) {
        if (!goodbye && !finished) lost("rank 0 is lost: its process ended");
        co_return;
      }
      silent_ticks = 0;
      if (frame->header.type == wire::FrameType::goodbye) gathering.change([&] { goodbye = true; });
      if (frame->header.type == wire::FrameType::notice) {
        if (!frame->json.empty() && news) news(0, frame->json);
      }
      if (frame->header.type == wire::FrameType::request) ordered(frame->header.request, std::move(frame->json));
    }
  }

  IoLoop& loop;
  std::shared_ptr<Connection> connection;
  int silent_ticks = 0;
  int ticks_max = 0;
  OrderHandler ordered;
  NewsHandler news;
  LostHandler lost;
  Gathering gathering;
  bool goodbye = false;
  bool finished = false;
};

Doorbell::Doorbell(std::shared_ptr<State> state) : state_(std::move(state)) {}
Doorbell::~Doorbell() = default;

Result<std::unique_ptr<Doorbell>> Doorbell::connect(IoLoop& loop, int rank, const DoorbellAddress& address,
                                                    double silence_seconds, OrderHandler ordered, LostHandler lost) {
  auto state = std::make_shared<State>(loop);
  state->ticks_max = silent_ticks_max(silence_seconds);
  state->ordered = std::move(ordered);
  state->lost = std::move(lost);
  asio::local::stream_protocol::socket socket(loop.context());
  error_code error;
  socket.connect({nameless_address(address.name)}, error);
  if (error) return Status(Code::unavailable, fmt::format("rank {} can't reach rank 0: {}", rank, error.message()));
  state->connection = std::make_shared<Connection>(Socket(std::move(socket)), kFrameSeconds);
  state->connection->send(wire::FrameType::hello, 0, {{"rank", rank}, {"secret", address.secret}});
  asio::co_spawn(
      loop.context(), [state] { return state->listen(); }, asio::detached);
  return std::unique_ptr<Doorbell>(new Doorbell(std::move(state)));
}

void Doorbell::on_news(NewsHandler handler) { state_->news = std::move(handler); }

void Doorbell::tell(const wire::Json& news) { state_->connection->send(wire::FrameType::notice, 0, news); }

void Doorbell::tick(const wire::Json& word) {
  if (state_->goodbye || state_->finished) return;
  tell(word);
  if (++state_->silent_ticks <= state_->ticks_max) return;
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
