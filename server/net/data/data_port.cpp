#include "server/net/data/data_port.hpp"

#include <algorithm>
#include <deque>
#include <limits>
#include <list>
#include <map>
#include <mutex>
#include <set>
#include <type_traits>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/base/axis_names.hpp"
#include "common/wire/field_reader.hpp"
#include "server/net/sockets/hello.hpp"
#include "server/net/sockets/listen.hpp"

namespace rcb::net {
namespace {

constexpr std::uint64_t kTellBytes = std::uint64_t{64} << 20U;  // between two reports to the coordinator
constexpr std::ptrdiff_t kMemoriesMax = 256;                    // that a connection brings
constexpr std::size_t kAllMemoriesMax = 4096;       // of all connections: a process has a limited number of mappings,
constexpr std::uint64_t kAllMemoriesBytesMax = 16;  // and of addresses; in multiples of the limit of one push
constexpr std::size_t kEndedMax = 16384;            // number of ended pushes that are remembered
constexpr std::uint64_t kReadBytes = std::uint64_t{512} << 10U;  // of one read

// An open push whose slice is being received.
struct Incoming {
  PushTicket ticket;
  std::vector<Buffer<std::byte>> arrays;   // each of the whole slice's size
  std::uint64_t have = 0;                  // particles complete so far
  const Connection* connection = nullptr;  // the one that brings the slice
  std::uint64_t connection_bytes = 0;      // received on it before this slice
  std::uint64_t told_bytes = 0;            // bytes of the slice reported so far
  bool over = false;                       // reported or dropped
};

// Memory that a client shares with this rank, and the connection that brought it.
struct Shared {
  std::shared_ptr<const SharedMemory> memory;
  const Connection* connection = nullptr;
};

// Slice buffers that the engine gave back, kept for the next push, by scene.
class Pool {
 public:
  void put(const std::string& scene, std::vector<Buffer<std::byte>> buffers) {
    const std::lock_guard lock(mutex_);
    if (buffers.empty())
      kept_.erase(scene);
    else
      kept_[scene] = std::move(buffers);
  }
  // A kept buffer, or an empty one.
  Buffer<std::byte> take(const std::string& scene) {
    const std::lock_guard lock(mutex_);
    const auto found = kept_.find(scene);
    Buffer<std::byte> buffer;
    if (found == kept_.end() || found->second.empty()) return buffer;
    buffer.swap(found->second.back());
    found->second.pop_back();
    return buffer;
  }

 private:
  std::mutex mutex_;
  std::map<std::string, std::vector<Buffer<std::byte>>> kept_;
};

}  // namespace

struct DataPort::State : std::enable_shared_from_this<State> {
  State(IoLoop& io, DataOptions data_options) : loop(io), options(std::move(data_options)) {}

  asio::io_context& context() const { return loop.context(); }

  void end(const std::shared_ptr<Incoming>& push, const Status& status) {
    if (std::exchange(push->over, true)) return;
    const std::uint64_t bytes = push->arrays.size() * push->ticket.terms.n * 8;
    if (!status.ok()) push->arrays.clear();
    report({push->ticket.number, bytes, status.ok(), status});
  }

  // Reports the bytes that have come if they are at least `more` above the last report.
  void tell(Incoming& push, std::uint64_t more) {
    if (push.over || push.connection == nullptr) return;
    const std::uint64_t bytes = push.connection->bytes_received() - push.connection_bytes;
    if (bytes < push.told_bytes + more) return;
    push.told_bytes = bytes;
    report({push.ticket.number, bytes, false, {}});
  }

  void remember(const PushId& id) {
    if (!ended.insert(id).second) return;
    ended_in_turn.push_back(id);
    if (ended_in_turn.size() <= kEndedMax) return;
    ended.erase(ended_in_turn.front());
    ended_in_turn.pop_front();
  }

  std::shared_ptr<Incoming> find(const PushId& id) const {
    for (const auto& [number, push] : pushes)
      if (push->ticket.terms.id == id) return push;
    return nullptr;
  }

  void wake() {
    for (Timer* timer : waiting) timer->cancel();
  }

  // Waits until the push of a slice is opened. Null if the push has ended or isn't opened in time, or if the client has
  // gone: while the slice stays unread, nothing else would notice that.
  awaitable<std::shared_ptr<Incoming>> await_push(const PushId& id, Connection& connection) {
    const TimePoint late = now() + duration_of(options.unknown_seconds);
    while (true) {
      if (auto push = find(id)) co_return push;
      if (ended.contains(id) || connection.peer_has_gone()) co_return nullptr;
      if (now() >= late) {
        remember(id);  // so that its other frames don't wait again
        co_return nullptr;
      }
      Timer timer(context(), std::min(late, now() + std::chrono::seconds(1)));
      const auto place = waiting.insert(waiting.end(), &timer);
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
          self->lose(connection, {});
          connection->close();
          self->connections.erase(connection);
        });
  }

  // This connection has gone: ends the pushes whose slices it was bringing.
  void lose(const std::shared_ptr<Connection>& connection, const std::string& why) {
    std::vector<std::shared_ptr<Incoming>> lost;
    for (const auto& [number, push] : pushes)
      if (push->connection == connection.get() && !push->over) lost.push_back(push);
    for (const auto& push : lost)
      end(push, {Code::aborted,
                 fmt::format("the data connection to rank {} was lost after {} of {} particles{}{}", options.rank,
                             push->have, push->ticket.terms.n, why.empty() ? "" : ": ", why),
                 "the previous step stands; push again"});
    std::erase_if(memories, [&](const auto& entry) { return entry.second.connection == connection.get(); });
    last_dropped.erase(connection.get());
  }

  std::uint64_t bytes_shared() const {
    std::uint64_t bytes = 0;
    for (const auto& [key, shared] : memories) bytes += shared.memory->size();
    return bytes;
  }

  using MemoryKey = std::pair<std::string, std::int64_t>;  // session and number

  // A number stands for one memory as long as its connection lasts, so that a push never takes some ranks' values from
  // one and others' from the next. Errors: too_large, busy, invalid_argument, already_exists, and those of
  // SharedMemory::map.
  Status share_memory(const MemoryKey& key, std::uint64_t bytes, Descriptor descriptor, const Connection& connection) {
    const auto others = std::count_if(memories.begin(), memories.end(), [&](const auto& entry) {
      return entry.second.connection == &connection && entry.first != key;
    });
    if (others >= kMemoriesMax)
      return {Code::too_large, fmt::format("a connection shares {} memories at most", kMemoriesMax)};
    if (bytes > options.bulk_bytes_max)
      return {Code::too_large, fmt::format("{} bytes are shared, at most {} are taken", bytes, options.bulk_bytes_max)};
    if (!descriptor.open())
      return {Code::invalid_argument, "no descriptor came with memory.share",
              "send it with the frame, over the rank's Unix socket (SCM_RIGHTS)"};
    if (memories.size() >= kAllMemoriesMax || bytes_shared() + bytes > kAllMemoriesBytesMax * options.bulk_bytes_max)
      return {Code::busy,
              fmt::format("{} memories of {} bytes are shared with rank {}, which is about the most", memories.size(),
                          bytes_shared(), options.rank),
              "push through a socket"};
    auto mapped = SharedMemory::map(std::move(descriptor), bytes);
    if (!mapped.ok()) return mapped.status();
    const auto found = memories.find(key);
    const bool known = found != memories.end() && found->second.connection == &connection;
    if (known && !found->second.memory->same_as(*mapped))
      return {Code::already_exists, fmt::format("memory {} is another one", key.second), "take a new number"};
    if (const auto last = last_dropped.find(&connection);
        !known && last != last_dropped.end() && key.second <= last->second)
      return {Code::invalid_argument,
              fmt::format("memory {} can't be shared after {} was dropped", key.second, last->second),
              "take a greater number"};
    memories[key] = {std::make_shared<const SharedMemory>(std::move(*mapped)), &connection};
    return {};
  }

  // Carries out memory.share and memory.drop, and answers. An error ends the connection.
  Status take_memory_frame(Connection& connection, const Frame& frame, const std::string& session, bool share) {
    if (frame.header.bulk_bytes > 0) return {Code::protocol_error, "shared memory comes without arrays"};
    constexpr std::int64_t kLargest = std::numeric_limits<std::int64_t>::max();
    wire::FieldReader fields(frame.json);
    const MemoryKey key(session, fields.integer("memory", 0, kLargest));
    const auto bytes = static_cast<std::uint64_t>(share ? fields.integer("bytes", 1, kLargest) : 0);
    Status status = fields.status();
    Descriptor descriptor = share ? connection.take_descriptor() : Descriptor();  // also where the frame is refused
    if (status.ok() && share) status = share_memory(key, bytes, std::move(descriptor), connection);
    if (const auto found = memories.find(key);
        !share && found != memories.end() && found->second.connection == &connection) {
      memories.erase(found);
      std::int64_t& last = last_dropped[&connection];
      last = std::max(last, key.second);
    }
    if (status.ok())
      connection.send(wire::FrameType::reply, frame.header.request, {{"memory", key.second}});
    else
      connection.send(wire::FrameType::failure, frame.header.request, wire::failure_json(status));
    return {};
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
    lose(connection, status.message());
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
      const Status taken = take_memory_frame(*connection, frame, session, *command == "memory.share");
      co_await connection->flush();  // who doesn't read the answers isn't read either
      co_return taken;
    }
    if (!request || *command != "push.slice")
      co_return Status(Code::protocol_error, "a data connection takes push.slice, memory.share and memory.drop alone");
    const auto id = read_push_id(frame.json, "");
    if (!id.ok()) co_return Status(Code::protocol_error, id.status().message());
    const auto push = co_await await_push(*id, *connection);
    if (!push || push->over) co_return co_await connection->skip_bulk(frame, frame.header.bulk_bytes);
    if (push->connection != nullptr && push->connection != connection.get()) {
      end(push, {Code::invalid_argument, fmt::format("two connections bring the slice of rank {}", options.rank)});
      co_return co_await connection->skip_bulk(frame, frame.header.bulk_bytes);
    }
    if (push->connection == nullptr) push->connection_bytes = connection->bytes_received();
    push->connection = connection.get();
    const auto slice = check(frame, *push);
    if (!slice.ok()) {
      end(push, slice.status());
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
    const auto plan = read_plan(frame.json);
    if (!plan.ok()) return plan.status();
    if (*plan != terms.plan)
      return Status(Code::stale_plan, fmt::format("the slice of rank {} follows another plan than its push", rank),
                    "fetch the plan and push again");
    if (first != push.have)
      return Status(Code::invalid_argument,
                    fmt::format("the slice of rank {} goes on at slot {}, expected {}", rank, first, push.have));
    if (count > terms.n - push.have)
      return Status(Code::stale_plan,
                    fmt::format("the slice of rank {} has more than the {} particles of the plan", rank, terms.n),
                    "fetch the plan and push again");
    return make_slice(frame.json, frame.header.bulk_bytes, terms, options.rank, count);
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
        tell(*push, kTellBytes);
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
    if (push->have == push->ticket.terms.n) end(push, {});
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
  Report report;
  LastingListener unix_listener;
  std::list<TcpAcceptor> tcp_acceptors;
  std::vector<std::shared_ptr<Door>> doors;
  std::set<std::shared_ptr<Connection>> connections;          // after hello
  std::map<std::uint64_t, std::shared_ptr<Incoming>> pushes;  // by the push's number
  std::map<MemoryKey, Shared> memories;
  std::map<const Connection*, std::int64_t> last_dropped;  // the greatest number of a memory that it has dropped
  std::set<PushId> ended;
  std::deque<PushId> ended_in_turn;  // in order; may name pushes that were opened again since
  std::list<Timer*> waiting;         // of slices whose push isn't open yet
  Pool pool;
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
  state_->report = std::move(report);
  state_->unix_listener.start([state = state_.get()](UnixAcceptor& acceptor) { state->accept(acceptor); });
  for (TcpAcceptor& acceptor : state_->tcp_acceptors) state_->accept(acceptor);
}

void DataPort::finish() { state_->stop(); }

void DataPort::open(PushTicket ticket) {
  auto push = std::make_shared<Incoming>();
  push->ticket = std::move(ticket);
  const PushTerms& terms = push->ticket.terms;
  const std::size_t arrays =
      static_cast<std::size_t>(terms.dims) + (terms.weights ? 1U : 0U) + (terms.last_array() ? 1U : 0U);
  bool fits = true;
  for (std::size_t a = 0; a < arrays && fits; ++a) {
    Buffer<std::byte> buffer = state_->pool.take(terms.id.scene);
    // Reserves room for some arrivals, which costs address space only: if a slice outgrew its buffer by a few
    // particles, the kernel would have to clear new pages for all of it.
    fits = buffer.capacity() >= terms.n * 8 || buffer.try_reserve((terms.n + terms.n / 16) * 8);
    if (fits) buffer.resize(terms.n * 8);
    push->arrays.push_back(std::move(buffer));
  }
  state_->ended.erase(terms.id);  // the client repeats an attempt that had ended
  state_->pushes[push->ticket.number] = push;
  if (!fits)
    state_->end(push, {Code::too_large, fmt::format("rank {} has no memory for {} particles", state_->options.rank,
                                                    push->ticket.terms.n)});
  else if (terms.n == 0)
    state_->end(push, {});
  state_->wake();
}

void DataPort::tick() {
  state_->unix_listener.look();
  for (const auto& [number, push] : state_->pushes) state_->tell(*push, 1);
}

void DataPort::drop(const PushId& id) {
  if (const auto push = state_->find(id)) {
    push->over = true;
    push->arrays.clear();
    state_->pushes.erase(push->ticket.number);
  }
  state_->remember(id);
  state_->wake();
}

std::vector<Slice> DataPort::take(std::uint64_t number) {
  const auto found = state_->pushes.find(number);
  if (found == state_->pushes.end()) return {};
  const std::shared_ptr<Incoming> push = found->second;
  state_->pushes.erase(found);
  const PushTerms& terms = push->ticket.terms;
  state_->remember(terms.id);
  if (push->have != terms.n) return {};
  std::vector<Slice> slices(1);
  slices[0].rank = state_->options.rank;
  slices[0].count = terms.n;
  for (std::size_t a = 0; a < push->arrays.size(); ++a) {
    const bool axis = a < static_cast<std::size_t>(terms.dims);
    const bool weight = !axis && terms.weights && a == static_cast<std::size_t>(terms.dims);
    const bool slots = terms.moved == Moved::some;
    const char* name = axis ? kAxisNames[a] : weight ? "w" : slots ? "slot" : "id";
    const char* dtype = axis || weight ? "<f8" : slots ? "<u8" : "<i8";
    slices[0].arrays.push_back({name, dtype, {terms.n}, std::move(push->arrays[a])});
  }
  return slices;
}

std::shared_ptr<const SharedMemory> DataPort::memory(const std::string& session, std::int64_t number) const {
  const auto found = state_->memories.find({session, number});
  return found == state_->memories.end() ? nullptr : found->second.memory;
}

int DataPort::rank() const { return state_->options.rank; }

void DataPort::recycle(const std::string& scene, std::vector<Buffer<std::byte>> buffers) {
  state_->pool.put(scene, std::move(buffers));
}

}  // namespace rcb::net
