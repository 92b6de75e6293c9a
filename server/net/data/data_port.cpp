#include "server/net/data/data_port.hpp"

#include <algorithm>
#include <list>
#include <map>
#include <set>
#include <type_traits>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/wire/field_reader.hpp"
#include "server/net/data/incoming_slices.hpp"
#include "server/net/data/shared_memories.hpp"
#include "server/net/sockets/hello.hpp"
#include "server/net/sockets/listen.hpp"

namespace rcb::net {
namespace {

constexpr std::uint64_t kTellBytes = std::uint64_t{64} << 20U;   // between two reports to the coordinator
constexpr std::uint64_t kReadBytes = std::uint64_t{512} << 10U;  // of one read

}  // namespace

struct DataPort::State : std::enable_shared_from_this<State> {
  State(IoLoop& io, DataOptions data_options)
      : loop(io),
        options(std::move(data_options)),
        slices(options.rank, options.spare),
        memories(options.rank, options.bulk_bytes_max) {}

  asio::io_context& context() const { return loop.context(); }

  void wake(const PushId& id) {
    const auto [first, end] = waiting.equal_range(id);
    for (auto one = first; one != end; ++one) one->second->cancel();
  }

  // Waits until the push of a slice is opened. Null if the push has ended or isn't opened in time, or if the client has
  // gone: while the slice stays unread, nothing else would notice that.
  awaitable<std::shared_ptr<Incoming>> await_push(const PushId& id, Connection& connection) {
    const TimePoint late = now() + duration_of(options.unknown_seconds);
    while (true) {
      if (auto push = slices.find(id)) co_return push;
      if (slices.has_ended(id) || connection.peer_has_gone()) co_return nullptr;
      if (now() >= late) {
        slices.remember_ended(id);  // so that its other frames don't wait again
        co_return nullptr;
      }
      Timer timer(context(), std::min(late, now() + std::chrono::seconds(1)));
      const auto place = waiting.emplace(id, &timer);
      co_await timer.async_wait(kAwait);
      waiting.erase(place);
    }
  }

  // Each listener has its own door, so that connections waiting to say hello at one don't push out those at another.
  template <typename Acceptor>
  void accept(Acceptor& acceptor) {
    DoorOptions door{.listener = fmt::format("rank {}", options.rank),
                     .credentials = {},
                     .hello_seconds = options.hello_seconds,
                     .waiting_max = options.waiting_max};
    if (std::is_same_v<Acceptor, TcpAcceptor>) door.credentials = options.credentials;
    doors.push_back(std::make_shared<Door>(std::move(door)));
    auto take = [self = shared_from_this(), door = doors.back()](Socket socket, const Status& peer) {
      self->welcome(std::move(socket), door, peer);
    };
    asio::co_spawn(context(), accept_all(context(), acceptor, std::move(take)), asio::detached);
  }

  void welcome(Socket socket, const std::shared_ptr<Door>& door, const Status& refused) {
    if (!refused.ok()) {
      spdlog::info("data connection refused: {}", refused.message());
      return;  // closes the socket without an answer
    }
    auto connection = std::make_shared<Connection>(std::move(socket), options.frame_seconds);
    asio::co_spawn(
        context(), [self = shared_from_this(), connection, door] { return self->serve(connection, door); },
        [self = shared_from_this(), connection](const std::exception_ptr& fault) {
          if (fault) spdlog::error("a data connection ended by an internal fault");
          self->lose(*connection, {});
          connection->close();
          self->connections.erase(connection);
        });
  }

  void lose(const Connection& connection, const std::string& why) {
    slices.lose(connection, why);
    memories.forget(connection);
  }

  awaitable<void> serve(std::shared_ptr<Connection> connection, std::shared_ptr<Door> door) {
    const Result<Hello> hello = co_await door->greet(connection);
    const bool silent = !hello.ok() && hello.status().code() != Code::not_authorised;
    Status status = hello.status();
    if (status.ok() && connections.size() >= static_cast<std::size_t>(options.connections_max))
      status = Status(Code::busy, fmt::format("{} data connections are open, which is the most", connections.size()),
                      "push through the endpoint");
    if (status.ok()) {
      connections.insert(connection);
      if (!door->asks_for_token()) connection->accept_descriptors();  // a Unix socket
      Door::let_in(*connection, *hello, {{"rank", options.rank}});
    }
    while (status.ok()) {
      Result<Frame> frame = co_await connection->read_frame(wire::kBytesBeforeHelloMax, options.bulk_bytes_max);
      status = frame.status();
      if (frame.ok()) status = co_await take_frame(connection, *frame, hello->session);
      connection->close_descriptors_read();
    }
    lose(*connection, status.message());
    if (status.code() != Code::unavailable) {
      spdlog::log(silent ? spdlog::level::debug : spdlog::level::info, "data connection ended: {}: {}",
                  code_name(status.code()), status.message());
      connection->send(wire::FrameType::failure, 0, wire::failure_json(status));
      co_await connection->end_gently();
    }
  }

  // An error ends the connection.
  awaitable<Status> take_frame(const std::shared_ptr<Connection>& connection, const Frame& frame,
                               const std::string& session) {
    if (frame.header.type == wire::FrameType::goodbye) co_return Status(Code::unavailable, "");
    const auto command = wire::string_field(frame.json, "command", 64);
    const bool request = frame.header.type == wire::FrameType::request && command.ok();
    if (request && (*command == "memory.share" || *command == "memory.drop")) {
      Status taken = memories.take_frame(*connection, frame, session, *command == "memory.share");
      if (taken.ok()) taken = co_await connection->skip_bulk(frame, 0);  // which may have a checksum all the same
      co_await connection->flush();  // who doesn't read the answers isn't read either
      co_return taken;
    }
    if (!request || *command != "push.slice")
      co_return Status(Code::protocol_error, "a data connection takes push.slice, memory.share and memory.drop alone");
    const auto id = read_push_id(frame.json, session);
    if (!id.ok()) co_return Status(Code::protocol_error, id.status().message());
    if (frame.header.bulk_bytes == 0) co_return co_await connection->skip_bulk(frame, 0);  // may be of no opened push
    const auto push = co_await await_push(*id, *connection);
    if (!push || push->over) co_return co_await connection->skip_bulk(frame, frame.header.bulk_bytes);
    if (push->connection != nullptr && push->connection != connection.get()) {
      slices.end(push,
                 {Code::invalid_argument, fmt::format("two connections bring the slice of rank {}", options.rank)});
      co_return co_await connection->skip_bulk(frame, frame.header.bulk_bytes);
    }
    if (push->connection == nullptr) push->connection_bytes = connection->bytes_received();
    push->connection = connection.get();
    const auto slice = check(frame, *push);
    if (!slice.ok()) {
      slices.end(push, slice.status());
      if (slice.status().code() == Code::protocol_error) co_return slice.status();
      co_return co_await connection->skip_bulk(frame, frame.header.bulk_bytes);
    }
    co_return co_await receive(connection, frame, push, slice->count);
  }

  Result<Slice> check(const Frame& frame, const Incoming& push) const {
    const PushTerms& terms = push.ticket.terms;
    wire::FieldReader fields(frame.json);
    const std::int64_t rank = fields.integer("rank", 0, terms.ranks - 1);
    const std::uint64_t first = fields.particles("first");
    const auto count = static_cast<std::uint64_t>(fields.integer("count", 0, wire::kParticlesMax));
    if (!fields.ok()) return fields.status();
    if (rank != options.rank)
      return Status(Code::invalid_argument, fmt::format("the slice of rank {} came to rank {}", rank, options.rank));
    if (first != push.have)
      return Status(Code::invalid_argument,
                    fmt::format("the slice of rank {} goes on at row {}, expected {}", rank, first, push.have));
    if (count > terms.n - push.have)
      return Status(Code::invalid_argument,
                    fmt::format("the slice of rank {} has more than the {} particles of 'counts'", rank, terms.n));
    return make_slice(frame.json, frame.header.bulk_bytes, terms, count);
  }

  awaitable<Status> receive(const std::shared_ptr<Connection>& connection, const Frame& frame,
                            std::shared_ptr<Incoming> push, std::uint64_t count) {
    const bool checked = (frame.header.flags & wire::kFlagBulkChecksum) != 0;
    wire::BulkChecksum checksum;
    std::uint64_t left = frame.header.bulk_bytes;
    const PushTerms& terms = push->ticket.terms;
    Buffer<std::byte> floats;  // one piece of float32 values, small enough for the cache
    for (std::size_t a = 0; left > 0; ++a) {
      const bool axis = a < static_cast<std::size_t>(terms.dims);
      std::uint64_t at = push->have * 8;
      const std::uint64_t upto = at + count * 8;
      while (at < upto) {
        if (push->over) co_return co_await connection->skip_bulk(frame, left);
        // The buffer is moved here during the read, so that the memory of a push that is given up meanwhile lives until
        // the read has ended.
        const std::uint64_t size = std::min(upto - at, kReadBytes);
        Buffer<std::byte> array = std::move(push->arrays[a]);
        const bool single = terms.is_float32 && axis;
        const std::span<std::byte> place = array.span().subspan(at, size);
        if (single) floats.resize(size / 2);
        const std::span<std::byte> piece = single ? floats.span() : place;
        const Status status = co_await connection->read_bulk(piece);
        if (!status.ok()) co_return status;
        if (checked) checksum.add(piece);
        if (single) widen(piece, place);
        if (!push->over) push->arrays[a] = std::move(array);
        slices.tell(*push, kTellBytes);
        at += size;
        left -= piece.size();
      }
    }
    if (checked) {
      std::array<std::byte, 8> sent{};
      const Status status = co_await connection->read_bulk(sent);
      if (!status.ok()) co_return status;
      if (wire::BulkChecksum::decode(sent) != checksum.value())
        co_return Status(Code::protocol_error, "the checksum of a slice's arrays doesn't match");
    }
    if (push->over) co_return Status();
    push->have += count;
    if (push->have == push->ticket.terms.n) slices.end(push, {});
    co_return Status();
  }

  void stop() {
    error_code ignored;
    unix_listener.close();
    for (TcpAcceptor& acceptor : tcp_acceptors) acceptor.close(ignored);
    for (const auto& door : doors) door->close();
    for (const auto& connection : std::set(connections)) connection->close();
  }

  IoLoop& loop;
  DataOptions options;
  LastingListener unix_listener;
  std::list<TcpAcceptor> tcp_acceptors;
  std::vector<std::shared_ptr<Door>> doors;
  std::set<std::shared_ptr<Connection>> connections;  // after hello
  IncomingSlices slices;
  SharedMemories memories;
  std::multimap<PushId, Timer*> waiting;  // of slices whose push isn't open yet
};

DataPort::DataPort(IoLoop& loop, DataOptions options) : state_(std::make_shared<State>(loop, std::move(options))) {}

DataPort::~DataPort() { state_->stop(); }

Status DataPort::listen_unix(const std::string& path) { return state_->unix_listener.listen(state_->context(), path); }

Result<std::string> DataPort::listen_tcp(const std::string& where) {
  Result<TcpAcceptor> acceptor = net::listen_tcp(state_->context(), where, state_->options.credentials.network());
  if (!acceptor.ok()) return acceptor.status();
  std::string bound = bound_address(*acceptor);
  state_->tcp_acceptors.push_back(std::move(*acceptor));
  return bound;
}

void DataPort::start(Report report) {
  state_->slices.set_report(std::move(report));
  state_->unix_listener.start([state = state_.get()](UnixAcceptor& acceptor) { state->accept(acceptor); });
  for (TcpAcceptor& acceptor : state_->tcp_acceptors) state_->accept(acceptor);
}

void DataPort::finish() { state_->stop(); }

void DataPort::open(PushTicket ticket) {
  const PushId id = ticket.terms.id;
  state_->slices.open(std::move(ticket));
  state_->wake(id);
}

void DataPort::drop(const PushId& id) {
  state_->slices.drop(id);
  state_->wake(id);
}

std::optional<Slice> DataPort::take(std::uint64_t number) { return state_->slices.take(number); }

void DataPort::tick() {
  state_->unix_listener.look();
  state_->slices.tell_all();
}

std::shared_ptr<const SharedMemory> DataPort::memory(const std::string& session, std::int64_t number) const {
  return state_->memories.find(session, number);
}

int DataPort::rank() const { return state_->options.rank; }

}  // namespace rcb::net
