// The harness's own code (a part of this program, since programs are built from *_test.cpp).
#include "tests/server/net/harness.hpp"

#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/auth/proof.hpp"
#include "tests/support/wait.hpp"

namespace rcb::net::testing {

using wire::FrameType;
using wire::Json;

struct FakeEngine::State {
  struct Work {
    Order order;
    std::function<void(Answer)> done;
  };
  mutable std::mutex mutex;
  std::condition_variable changed;
  std::deque<Work> queue;
  bool held = false;
  bool ended = false;
  std::vector<std::string> executed;
  Json request;
  std::vector<Slice> slices;
  std::map<std::string, scene::SceneOptions> scenes;
  std::thread thread;

  Answer execute(Order& order) {
    const std::string command = order.request.value("command", "");
    const std::string scene = order.request.value("scene", "");
    Answer answer;
    answer.json = {{"echo", command}};
    executed.push_back(command);
    request = order.request;
    if (command == "scene.create") {
      scene::SceneOptions& options = scenes[scene] = {};
      options.dims = order.request.value("dims", 3);
      options.parts = order.request.value("parts", 1);
      options.tolerance = order.request.value("tolerance", 0.1);
      options.positions = *scene::travel_from_name(order.request.value("positions", "every-step"));
      answer.change = {scene, scene::Created{options, {}}};
    } else if (command == "scene.drop") {
      if (scenes.erase(scene) == 0) answer.status = Status(Code::not_found, "no scene '" + scene + "'");
      answer.change = {scene, scene::Dropped{}};
    } else if (command == "scene.restore") {
      scenes[scene] = *scene::read_options(order.request);
      slices = std::move(order.slices);
      if (scene == "refused") answer.status = Status(Code::too_large, "no memory for it");
    } else if (command == "push") {
      scene::Stepped stepped = push(order.request, scenes[scene]);
      executed.back() += fmt::format(" step {}", stepped.report.step);
      slices = std::move(order.slices);
      answer.json["previous_step"] = nullptr;
      answer.change = {scene, std::move(stepped)};
    } else if (command == "fetch") {
      const std::uint64_t count = std::stoull(scene.substr(1));
      Buffer<std::byte> bytes(count * 8);
      std::memset(bytes.data(), 0, bytes.size());
      answer.arrays.push_back({"x", "<f8", {count}, std::move(bytes)});
    }
    return answer;
  }

  static scene::Stepped push(const Json& request, const scene::SceneOptions& options) {
    scene::Stepped stepped;
    stepped.report.step = request.value("step", std::int64_t{-1});
    stepped.report.positions_step = stepped.report.step;
    stepped.report.n = stepped.held.n = request.value("n", std::uint64_t{0});
    stepped.held.weights = request.value("weights", false);
    stepped.held.epoch = 1;
    stepped.held.hash = kCutsHash;
    auto counts = partition::quotas(stepped.held.n, options.part_sizes, options.parts);
    stepped.held.loads = std::make_shared<const partition::LoadSummary>(
        partition::summarise_counts(std::move(counts), options.part_sizes));
    return stepped;
  }

  void run() {
    std::unique_lock lock(mutex);
    while (true) {
      changed.wait(lock, [&] { return ended || (!queue.empty() && !held); });
      if (ended) return;
      Work work = std::move(queue.front());
      queue.pop_front();
      Answer answer = execute(work.order);
      lock.unlock();
      work.done(std::move(answer));
      lock.lock();
    }
  }
};

FakeEngine::FakeEngine() : state_(std::make_unique<State>()) {
  state_->thread = std::thread([this] { state_->run(); });
}

FakeEngine::~FakeEngine() {
  {
    const std::lock_guard lock(state_->mutex);
    state_->ended = true;
  }
  state_->changed.notify_all();
  state_->thread.join();
}

void FakeEngine::submit(Order order, std::function<void(Answer)> done) {
  const std::lock_guard lock(state_->mutex);
  state_->queue.push_back({std::move(order), std::move(done)});
  state_->changed.notify_all();
}

void FakeEngine::hold() {
  const std::lock_guard lock(state_->mutex);
  state_->held = true;
}

void FakeEngine::release() {
  const std::lock_guard lock(state_->mutex);
  state_->held = false;
  state_->changed.notify_all();
}

void FakeEngine::wait_for_cancelled() {
  EXPECT_TRUE(rcb::testing::eventually([this] {
    const std::lock_guard lock(state_->mutex);
    return !state_->queue.empty() && *state_->queue.front().order.cancelled;
  })) << "somebody still waits for the order";
}

void FakeEngine::wait_for_orders(std::size_t count) {
  std::unique_lock lock(state_->mutex);
  EXPECT_TRUE(state_->changed.wait_for(lock, std::chrono::seconds(rcb::testing::kWaitSeconds),
                                       [&] { return state_->queue.size() >= count; }));
}

std::vector<std::string> FakeEngine::executed() const {
  const std::lock_guard lock(state_->mutex);
  return state_->executed;
}

Json FakeEngine::request() const {
  const std::lock_guard lock(state_->mutex);
  return state_->request;
}

std::vector<Slice> FakeEngine::slices() const {
  const std::lock_guard lock(state_->mutex);
  return state_->slices;
}

namespace {
std::string in_failure(const Json& json, const char* name) {
  return json.contains("failure") ? json["failure"].value(name, "") : "";
}
}  // namespace

std::string Received::code() const { return in_failure(json, "code"); }
std::string Received::message() const { return in_failure(json, "message"); }
std::string Received::hint() const { return in_failure(json, "hint"); }

Client::Client(Client&& other) noexcept : socket_(std::exchange(other.socket_, -1)), next_(other.next_) {}

Client& Client::operator=(Client&& other) noexcept {
  std::swap(socket_, other.socket_);
  std::swap(next_, other.next_);
  return *this;
}

Client::~Client() { close(); }

void Client::close() {
  if (socket_ >= 0) ::close(std::exchange(socket_, -1));
}

Client Client::on_unix(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
  Client client(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  EXPECT_EQ(::connect(client.socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)), 0) << path;
  return client;
}

Client Client::on_tcp(const std::string& where) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(where.substr(where.rfind(':') + 1))));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  Client client(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  EXPECT_EQ(::connect(client.socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)), 0) << where;
  return client;
}

void Client::send_bytes(const std::string& bytes) {
  std::size_t sent = 0;
  while (sent < bytes.size()) {
    const ssize_t count = ::send(socket_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (count <= 0) return;
    sent += static_cast<std::size_t>(count);
  }
}

std::string frame(FrameType type, std::uint64_t request, const std::string& json, const std::string& bulk,
                  bool checked) {
  wire::FrameHeader header;
  header.type = type;
  header.request = request;
  header.bulk_bytes = bulk.size();
  header.flags = checked ? wire::kFlagBulkChecksum : 0;
  std::string bytes = wire::encode_frame(header, json) + bulk;
  if (!checked) return bytes;
  wire::BulkChecksum sum;
  sum.add(std::as_bytes(std::span(bulk)));
  const auto tail = wire::BulkChecksum::encode(sum.value());
  bytes.append(reinterpret_cast<const char*>(tail.data()), tail.size());
  return bytes;
}

std::uint64_t Client::send(FrameType type, Json json, const std::string& bulk, bool checked) {
  send_bytes(frame(type, next_, json.dump(), bulk, checked));
  return next_++;
}

std::uint64_t Client::request(const std::string& command, Json arguments) {
  arguments["command"] = command;
  return send(FrameType::request, std::move(arguments));
}

bool Client::read(char* into, std::size_t bytes) {
  while (bytes > 0) {
    pollfd waiting{socket_, POLLIN, 0};
    if (::poll(&waiting, 1, rcb::testing::kWaitSeconds * 1000) == 0) {
      ADD_FAILURE() << "nothing came within " << rcb::testing::kWaitSeconds << " s";
      return false;
    }
    const ssize_t count = ::recv(socket_, into, bytes, 0);
    if (count <= 0) return false;
    into += count;
    bytes -= static_cast<std::size_t>(count);
  }
  return true;
}

Received Client::receive() {
  Received received;
  received.ended = true;
  wire::HeaderBytes bytes;
  if (!read(reinterpret_cast<char*>(bytes.data()), bytes.size())) return received;
  const auto header = wire::decode_header(bytes);
  EXPECT_TRUE(header.ok());
  if (!header.ok()) return received;
  std::string text(header->json_bytes, '\0');
  received.bulk.resize(header->bulk_bytes);
  if (!read(text.data(), text.size()) || !read(received.bulk.data(), received.bulk.size())) return received;
  EXPECT_TRUE(wire::verify_checksum(bytes, text).ok());
  received.ended = false;
  received.type = header->type;
  received.request = header->request;
  received.json = Json::parse(text);
  return received;
}

Received Client::receive_but_notices() {
  while (true) {
    Received received = receive();
    if (received.ended || received.type != FrameType::notice) return received;
  }
}

Received Client::call(const std::string& command, Json arguments) {
  request(command, std::move(arguments));
  return receive_but_notices();
}

Received Client::hello(const std::string& name, const std::string& session, const std::string& token,
                       const std::string& listener) {
  const Received welcome = receive();
  EXPECT_EQ(welcome.type, FrameType::welcome);
  Json json{{"protocol", 2}, {"client", name}, {"session", session}};
  if (!token.empty()) {
    const auth::Opening opening{listener, welcome.json.value("nonce", ""), auth::random_nonce(), session};
    json["nonce"] = opening.client_nonce;
    json["proof"] = auth::proof(auth::Role::client, token, opening);
  }
  send(FrameType::hello, std::move(json));
  return receive();
}

namespace {

using Columns = std::vector<std::pair<const char*, const char*>>;  // names and types
const Columns kAxes{{"x", "<f8"}, {"y", "<f8"}};

std::string bulk_of(const Columns& columns, std::uint64_t n) {
  std::string bulk;
  for (const auto& [name, dtype] : columns)
    for (std::uint64_t i = 0; i < n; ++i) {
      const auto value = static_cast<double>(i);
      const bool is_id = std::string(name) == "id";
      bulk.append(is_id ? reinterpret_cast<const char*>(&i) : reinterpret_cast<const char*>(&value), sizeof value);
    }
  return bulk;
}

Json push_of(std::int64_t step, const Json& more, std::uint64_t& n, Columns& columns) {
  Json json{{"command", "push"}, {"scene", "s"}, {"step", step}, {"attempt", 1}, {"n", n}};
  json.update(more);
  if (json["n"].is_number_unsigned() || json["n"].is_number_integer()) n = json["n"].get<std::uint64_t>();
  if (json.value("weights", false)) columns.emplace_back("w", "<f8");
  if (json.value("ids", false)) columns.emplace_back("id", "<i8");
  if (n == 0 || more.contains("way")) columns.clear();
  for (const auto& [name, dtype] : columns)
    json["arrays"].push_back({{"name", name}, {"dtype", dtype}, {"shape", {n}}});
  return json;
}

}  // namespace

std::string Client::push(std::int64_t step, std::uint64_t n, const Json& more, bool checked) {
  Columns columns = kAxes;
  const Json json = push_of(step, more, n, columns);
  const std::string bulk = bulk_of(columns, n);
  send(FrameType::request, json, bulk, checked);
  return bulk;
}

void Client::begin(std::int64_t step, std::uint64_t n, const Json& more) {
  Columns columns = kAxes;
  const Json json = push_of(step, more, n, columns);
  const std::string bulk = bulk_of(columns, n);
  const std::string whole = frame(FrameType::request, next_++, json.dump(), bulk);
  send_bytes(whole.substr(0, whole.size() - bulk.size()));
}

void Client::finish(std::uint64_t n) { send_bytes(bulk_of(kAxes, n)); }

void run_until(asio::io_context& context, const std::function<bool()>& holds) {
  const TimePoint late = now() + std::chrono::seconds(rcb::testing::kWaitSeconds);
  while (!holds() && now() < late) {
    context.restart();
    context.run_one_for(std::chrono::milliseconds(100));
  }
  EXPECT_TRUE(holds());
}

ControlOptions TestService::defaults() {
  ControlOptions options;
  options.version = "test";
  options.ranks = 4;
  options.credentials.token = std::string(64, 'a');
  options.bulk_bytes_max = std::uint64_t{64} << 20U;
  return options;
}

TestService::TestService(ControlOptions options)
    : control_(std::make_unique<Control>(loop_, std::move(options), engine_)) {
  EXPECT_TRUE(control_->listen_unix(path()).ok());
  const auto bound = control_->listen_tcp("127.0.0.1:0");
  EXPECT_TRUE(bound.ok());
  if (bound.ok()) tcp_ = *bound;
  control_->start();
  loop_.start();
}

TestService::TestService(const std::function<void(ControlOptions&)>& change)
    : TestService([&change] {
        ControlOptions options = defaults();
        change(options);
        return options;
      }()) {}

TestService::~TestService() {
  engine_.release();
  loop_.stop();
}

Client TestService::client(const std::string& name, const std::string& session) {
  Client client = connect();
  EXPECT_EQ(client.hello(name, session).type, FrameType::reply);
  return client;
}

}  // namespace rcb::net::testing
