// Session, part 1: hello, the commands that aren't pushes, waiting and answering.
#include "server/net/control/session.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "server/api/commands.hpp"
#include "server/api/ledger_answers.hpp"

namespace rcb::net {

using wire::FrameType;
using wire::Json;

namespace {

// Whether this is an unforced rebalance that changes the number of parts, on which clients with the scene open rely.
bool changes_parts(const std::string& command, const Json& request, const scene::Ledger* ledger) {
  if (command != "rebalance" || ledger == nullptr || wire::is_true(request, "force")) return false;
  const int now = ledger->now().options.parts;
  const auto parts = wire::integer_field_or(request, "parts", 1, wire::kPartsMax, now);
  return parts.ok() && *parts != now;
}

// Whether it is a question about positions, which takes those that are held if it says so.
bool takes_held(const api::CommandInfo& command) {
  return std::ranges::find(command.fields, "held") != command.fields.end();
}

constexpr std::chrono::milliseconds kLookEvery(500);  // how often to check that the waiting client is still there

}  // namespace

Session::Session(std::shared_ptr<Coordinator> coordinator, Socket socket, Entrance entrance)
    : coordinator_(std::move(coordinator)),
      connection_(std::make_shared<Connection>(std::move(socket), coordinator_->options().frame_seconds)),
      entrance_(std::move(entrance)) {}

Session::~Session() = default;

void Session::fail(std::uint64_t request, const Status& why) {
  Json json = wire::failure_json(why);
  if (why.code() == Code::unavailable && coordinator_->shutting_down()) json["failure"]["ending"] = true;
  connection_->send(FrameType::failure, request, json);
}

awaitable<void> Session::refuse(Status why) {
  fail(0, why);
  co_await connection_->end_gently();
}

awaitable<void> Session::run() {
  Status end = co_await hello();
  const bool silent = number_.empty() && end.code() != Code::not_authorised;
  while (end.ok()) {
    co_await connection_->flush();
    Result<Frame> frame = co_await connection_->read_frame(wire::kJsonBytesMax, coordinator_->options().bulk_bytes_max);
    if (frame.ok())
      end = co_await serve(std::move(*frame));
    else
      end = frame.status();
    if (end.ok() && goodbye_due_) say_goodbye();
  }
  coordinator_->leave(this);
  if (end.code() == Code::unavailable) {  // the peer is gone or said goodbye
    if (!end.message().empty()) spdlog::info("connection of {} lost: {}", client_, end.message());
    co_await connection_->flush();
    connection_->close();
    co_return;
  }
  spdlog::log(silent ? spdlog::level::debug : spdlog::level::info, "connection of {} ended: {}: {}", client_,
              code_name(end.code()), end.message());
  fail(0, end);
  co_await connection_->end_gently();
}

awaitable<Status> Session::hello() {
  const Result<Hello> hello = co_await entrance_.door->greet(connection_);
  if (!hello.ok()) co_return hello.status();
  client_ = hello->client;
  number_ = hello->session;
  coordinator_->join(this);
  if (!place_is_free()) late_.emplace(*entrance_.late, *connection_);
  const ControlOptions& options = coordinator_->options();
  Json reply{{"version", options.version},
             {"ranks", options.ranks},
             {"instance", coordinator_->instance()},
             {"limits",
              {{"json_bytes", wire::kJsonBytesMax},
               {"bulk_bytes", options.bulk_bytes_max},
               {"frame_seconds", options.frame_seconds},
               {"sessions", options.sessions_max}}}};
  if (const auto& data = coordinator_->data_addresses(entrance_.endpoint); !data.empty()) {
    reply["data"] = data;
    const auto is_unix = [](const std::string& address) { return address.starts_with("unix:"); };
    // Over a Unix socket the client is of the service's user, who may read the token anyway.
    if (is_unix(entrance_.endpoint) && !std::all_of(data.begin(), data.end(), is_unix))
      reply["data_token"] = options.credentials.token;
    if (!is_unix(entrance_.endpoint))  // else `data` has the Unix sockets of this machine's ranks
      for (const LocalAddress& local : coordinator_->local_addresses())
        reply["local"].push_back({{"address", local.address}, {"machine", local.machine}});
  }
  Door::let_in(*connection_, *hello, std::move(reply));
  co_return Status();
}

bool Session::place_is_free() const {
  return coordinator_->session_count() <= static_cast<std::size_t>(coordinator_->options().sessions_max);
}

Status Session::check_allowed(const Request& request) {
  if (late_ && place_is_free()) late_.reset();
  if (late_ && request.info->runs_on != api::RunsOn::session)
    return {Code::busy, fmt::format("{} sessions are open, which is the most", coordinator_->options().sessions_max),
            "try again later; status, scene.list and shutdown are answered meanwhile"};
  if (!entrance_.files && request.info->files)
    return {Code::not_authorised,
            fmt::format("'{}' uses files of the service, which no client over TCP may", request.command),
            "push the points instead, or start the service with --files-below DIR"};
  return {};
}

awaitable<Status> Session::serve(Frame frame) {
  if (frame.header.type == FrameType::goodbye) co_return Status(Code::unavailable, "");
  if (frame.header.type != FrameType::request)
    co_return Status(Code::protocol_error,
                     fmt::format("a client doesn't send frames of type {}", static_cast<int>(frame.header.type)));
  auto command = wire::string_field(frame.json, "command", 64);
  const bool checked = (frame.header.flags & wire::kFlagBulkChecksum) != 0;
  Result<wire::CountRecord> counted = wire::CountRecord{};
  const bool pushes = command.ok() && *command == "push";
  if (command.ok() && *command == "count") {
    if (const Status read = co_await read_record(frame, counted); !read.ok()) co_return read;
  } else if (frame.header.bulk_bytes > 0 || checked || pushes) {
    // A frame whose specs contradict its size ends the session. The bulk of a push is read when it is admitted; any
    // other is dropped, since no other command takes arrays.
    if (const auto specs = wire::array_specs(frame.json, frame.header.bulk_bytes); !specs.ok())
      co_return specs.status();
    Status status;
    if (!pushes) status = co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
    if (!status.ok()) co_return status;
  }
  const auto deadline = wire::number_field_or(frame.json, "deadline_seconds", 0, wire::kDeadlineSecondsMax,
                                              wire::kDeadlineSecondsDefault);
  const api::CommandInfo* info = command.ok() ? api::find_command(*command) : nullptr;
  if (info == nullptr || !deadline.ok()) {
    if (pushes) drop_slices(frame.json);
    fail(frame.header.request, !command.ok() ? command.status()
                               : info == nullptr
                                   ? Status(Code::unsupported, fmt::format("unknown command '{}'", *command),
                                            "the service may be older than the client: see 'status'")
                                   : deadline.status());
    if (pushes) co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
    co_return Status();
  }
  Request request{frame.header.request,  info,      std::move(*command),
                  std::move(frame.json), *deadline, now() + duration_of(*deadline)};
  request.counted = std::move(counted);
  if (pushes) request.unread = &frame;
  request.bytes = wire::kHeaderBytes + frame.header.json_bytes + frame.header.bulk_bytes;
  ++answering_;
  if (const Status admitted = admit_size(request, frame.header.json_bytes); admitted.ok())
    co_await dispatch(request);
  else
    fail(request.number, admitted);
  --answering_;
  if (pushes && !request.opened) drop_slices(request.json);
  if (!request.breach.ok()) co_return request.breach;
  if (request.unread != nullptr) co_return co_await connection_->skip_bulk(frame, frame.header.bulk_bytes);
  co_return Status();
}

void Session::drop_slices(const Json& push) {
  if (!may_bring_slices(push)) return;
  if (const Result<PushId> id = read_push_id(push, number_); id.ok() && !coordinator_->has_open(*id))
    coordinator_->refuse_directly(*id);
}

Status Session::admit_size(Request& request, std::size_t bytes) {
  api::keep_known_fields(request.json, *request.info);
  if (bytes < wire::kLargeRequest) return {};
  bytes = wire::dump_json(request.json).size();
  if (bytes < wire::kLargeRequest) return {};
  if (!request.info->large)
    return {Code::too_large, fmt::format("'{}' takes less than {} bytes of JSON, and this has {}", request.command,
                                         wire::kLargeRequest, bytes)};
  auto held = coordinator_->hold_request(bytes);
  if (held.ok()) request.held = std::move(*held);
  return held.status();
}

OrderOptions Session::options_of(const Request& request) const {
  OrderOptions order;
  order.deadline_seconds = request.deadline_seconds;
  order.cancelled = request.cancelled;
  order.held = request.held;
  return order;
}

awaitable<void> Session::dispatch(Request& request) {
  if (const Status allowed = check_allowed(request); !allowed.ok()) {
    fail(request.number, allowed);
    co_return;
  }
  // Requests that a client sent before it left still come in; those that only read are dropped.
  if (request.info->reads() && connection_->peer_is_lost()) co_return;
  if (request.command == "status") co_await coordinator_->look_at_log();
  if (answer_here(request)) co_return;
  if (request.command == "shutdown") co_return co_await shut_down(request);
  if (coordinator_->shutting_down()) {
    fail(request.number, {Code::unavailable, "the service is shutting down"});
    co_return;
  }
  if (request.command == "push") co_return co_await push(request);
  if (request.command == "scene.open") co_return co_await open_scene(request);
  if (request.command == "count") co_return co_await count(request);
  if (request.info->runs_on == api::RunsOn::ledger) co_return co_await answer_from_ledger(request);
  if (takes_held(*request.info))
    if (const Status status = co_await wait_for_positions(request); !status.ok()) {
      fail(request.number, status);
      co_return;
    }
  if (api::changes_scene(request.json, *request.info)) co_return co_await scene_change(request);
  co_await order_and_reply(request, options_of(request));
}

// Answers commands that need no engine. True if this was one.
bool Session::answer_here(const Request& request) {
  if (request.command == "status") {
    connection_->send(FrameType::reply, request.number, coordinator_->status_json());
  } else if (request.command == "scene.list") {
    connection_->send(FrameType::reply, request.number, {{"scenes", coordinator_->scenes_json()}});
  } else if (request.command == "scene.close") {
    const auto scene = wire::string_field(request.json, "scene", 256);
    if (!scene.ok())
      fail(request.number, scene.status());
    else if (open_.erase(*scene) == 0)
      fail(request.number, {Code::not_found, fmt::format("this connection doesn't have scene '{}' open", *scene)});
    else {
      coordinator_->groups().leave(*scene, connection_.get(), "has closed the scene");
      connection_->send(FrameType::reply, request.number, Json::object());
    }
  } else {
    return false;
  }
  return true;
}

awaitable<void> Session::shut_down(Request& request) {
  coordinator_->shut_down("asked by " + client_, [connection = connection_, number = request.number] {
    connection->send(FrameType::reply, number, Json::object());
  });
  co_return;
}

awaitable<void> Session::scene_change(Request& request) {
  const auto scene = wire::string_field(request.json, "scene", 256);
  const Status named = scene.ok() ? wire::check_scene_name(*scene) : scene.status();
  if (!named.ok()) {
    fail(request.number, named);
    co_return;
  }
  SceneGate& gate = coordinator_->gate(*scene);
  const bool drops = request.command == "scene.drop" || wire::is_true(request.json, "replace");
  const bool waits = request.command != "scene.create" || drops;
  Status turn = co_await wait_turn(request, *scene, [&gate, waits] { return !waits || !gate.step; });
  const bool changes = changes_parts(request.command, request.json, coordinator_->scenes().find(*scene));
  // A file's particles are a push, too: a first one, of which those who have the scene open would not know.
  const bool loads = request.command == "load";
  if (turn.ok() && loads) turn = coordinator_->groups().check_free(*scene);
  if (turn.ok() && (drops || changes || loads)) {
    const Holders holders = coordinator_->holders(*scene, number_);
    if (holders.count > 0)
      turn = Status(
          Code::busy, fmt::format("scene '{}' is held open by {}", *scene, holders.in_words()),
          changes ? "try again when it is closed; with \"force\" (--force) its parts change all the same, and the next "
                    "step's report tells"
                  : "try again when it is closed");
  }
  if (turn.ok() && request.command == "rebalance") turn = check_positions(*scene);
  if (!turn.ok()) {
    fail(request.number, turn);
    coordinator_->wake_queue(*scene);
    co_return;
  }
  OrderOptions order = options_of(request);
  order.changes = *scene;
  Result<std::shared_ptr<Pending>> pending = coordinator_->order(request.json, std::move(order));
  coordinator_->wake_queue(*scene);
  if (!pending.ok()) {
    fail(request.number, pending.status());
    co_return;
  }
  co_await reply_when_done(request, *pending);
}

// The scene counts as open as soon as this is ordered, so that a drop which another client orders next is refused.
awaitable<void> Session::open_scene(Request& request) {
  const auto scene = wire::string_field(request.json, "scene", 256);
  if (!scene.ok()) {
    fail(request.number, scene.status());
    co_return;
  }
  auto claim = read_claim(request.json);
  if (claim.ok() && *claim && !coordinator_->scenes().contains(*scene)) claim = coordinator_->unknown_scene(*scene);
  if (claim.ok() && *claim) {
    auto joined = coordinator_->groups().join(*scene, **claim, connection_.get(), client_);
    if (joined.ok())
      request.seat = *joined;
    else
      claim = joined.status();
  }
  if (!claim.ok()) {
    fail(request.number, claim.status());
    co_return;
  }
  const bool fresh = open_.insert(*scene).second;
  Status status = co_await wait_settled(request, *scene);
  const scene::Ledger* ledger = status.ok() ? coordinator_->scenes().find(*scene) : nullptr;
  if (status.ok() && ledger == nullptr) status = coordinator_->unknown_scene(*scene);
  if (ledger != nullptr) co_return reply(request, api::describe(*ledger, coordinator_->options().ranks));
  reply(request, api::failed(status));
  if (fresh) open_.erase(*scene);
  if (*claim) coordinator_->groups().give_back_seat(*scene, connection_.get());
}

awaitable<void> Session::order_and_reply(Request& request, OrderOptions order) {
  Result<std::shared_ptr<Pending>> pending = coordinator_->order(request.json, std::move(order));
  if (!pending.ok()) {
    fail(request.number, pending.status());
    co_return;
  }
  co_await reply_when_done(request, *pending);
}

awaitable<void> Session::reply_when_done(Request& request, std::shared_ptr<Pending> pending) {
  TimePoint notice_at = now() + duration_of(coordinator_->options().notice_seconds);
  ++answering_;
  while (!pending->answer && now() < request.end && !connection_->peer_is_lost())
    co_await nap(pending->signal, request, notice_at, coordinator_->engine_in_words());
  if (pending->answer) {
    Answer answer = std::move(*pending->answer);
    pending->answer.emplace();
    pending->answer->status = answer.status;
    reply(request, std::move(answer));
  } else {
    if (request.cancelled) coordinator_->cancel(*request.cancelled);
    fail(request.number,
         {Code::deadline_exceeded,
          fmt::format("'{}' wasn't done within {} s; {}", request.command, request.deadline_seconds,
                      request.info->reads() ? "it is given up" : "it goes on where it has begun to change the scene"),
          "ask again later, or give it a longer deadline"});
  }
  --answering_;
  if (goodbye_due_) say_goodbye();
}

void Session::reply(const Request& request, Answer answer) {
  if (!answer.status.ok()) {
    Status why = answer.status;
    const auto scene = wire::string_field(request.json, "scene", 256);
    if (why.code() == Code::not_found && scene.ok() && !coordinator_->scenes().contains(*scene))
      why = coordinator_->unknown_scene(*scene);
    spdlog::info("{} of {}: {}: {}", request.command, client_, code_name(why.code()), why.message());
    fail(request.number, why);
    return;
  }
  if (const scene::Ledger* ledger = coordinator_->scenes().find(request.json.value("scene", ""));
      request.command == "scene.create" && ledger != nullptr)
    answer = api::describe(*ledger, coordinator_->options().ranks);
  if (request.command == "scene.show" || request.command == "scene.open" || request.command == "scene.create") {
    const Holders holders = coordinator_->holders(request.json.value("scene", ""));
    answer.json.update({{"holders", holders.first}, {"holders_count", holders.count}});
  }
  if (request.seat) answer.json["seat"] = claim_json(*request.seat);
  std::shared_ptr<void> held;
  if (request.info->reads()) {  // the answer to a change is always sent, whatever its size
    std::uint64_t bytes = 0;
    for (const wire::Array& array : answer.arrays) bytes += array.bytes.size();
    auto room = coordinator_->hold_answer(bytes);
    if (!room.ok()) return fail(request.number, room.status());
    held = std::move(*room);
  }
  const Status sent = connection_->send_message(FrameType::reply, request.number, std::move(answer.json),
                                                std::move(answer.arrays), std::move(held));
  if (!sent.ok()) fail(request.number, sent);
}

awaitable<Status> Session::wait_turn(const Request& request, const std::string& scene, std::function<bool()> ready,
                                     std::function<bool()> overtake) {
  SceneGate& gate = coordinator_->gate(scene);
  if ((gate.queue.empty() && ready()) || overtake()) co_return Status();
  Place place(gate.queue, coordinator_->context());  // the gate isn't erased while this is in its queue
  TimePoint notice_at = now() + duration_of(coordinator_->options().notice_seconds);
  Status status;
  while (!(place.first() && ready()) && !overtake()) {
    if (coordinator_->shutting_down())
      status = Status(Code::unavailable, "the service is shutting down");
    else if (now() >= request.end)
      status = Status(Code::deadline_exceeded, fmt::format("'{}' waited {} s for its turn at scene '{}'",
                                                           request.command, request.deadline_seconds, scene));
    if (!status.ok()) break;
    co_await nap(place.timer(), request, notice_at, gate.step ? "a push of the scene to end" : "its turn at the scene");
  }
  co_return status;
}

awaitable<void> Session::nap(Timer& timer, const Request& request, TimePoint& notice_at, std::string what) {
  timer.expires_at(std::min({request.end, notice_at, now() + kLookEvery}));
  co_await timer.async_wait(kAwait);
  // A peer that has closed only its sending side still receives this notice; for any other the send breaks the
  // connection.
  if (connection_->peer_has_gone() && !connection_->broken() && !std::exchange(asked_whether_gone_, true))
    notice_at = now();
  if (now() < notice_at) co_return;
  const auto waited =
      static_cast<std::int64_t>(request.deadline_seconds - std::chrono::duration<double>(request.end - now()).count());
  connection_->send(FrameType::notice, request.number,
                    {{"notice", fmt::format("'{}' has waited {} s for {}", request.command, waited, what)}});
  notice_at = now() + duration_of(coordinator_->options().notice_seconds);
}

void Session::say_goodbye() {
  goodbye_due_ = answering_ > 0 || connection_->reading_message();
  if (goodbye_due_) return;
  connection_->send(FrameType::goodbye, 0, Json::object());
  asio::co_spawn(
      coordinator_->context(),
      [connection = connection_]() -> awaitable<void> {
        co_await connection->flush();
        connection->close();
      },
      asio::detached);
}

}  // namespace rcb::net
