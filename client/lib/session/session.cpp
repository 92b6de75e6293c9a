#include "client/lib/session/session.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <sys/random.h>

#include "client/lib/session/data_path.hpp"
#include "client/lib/session/push_source.hpp"
#include "common/base/text.hpp"
#include "common/files/endpoint_lock.hpp"
#include "common/files/paths.hpp"
#include "common/openssl/openssl.hpp"
#include "common/wire/frame.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr double kGoodbyeSeconds = 0.2;
constexpr std::size_t kMachineBytesMax = 1024;
constexpr std::string_view kEndpointListener = "endpoint";

// Not seeded from the clock: two clients that start at the same moment must differ.
std::string random_session() {
  std::uint64_t value = 0;
  if (::getrandom(&value, sizeof value, 0) != static_cast<ssize_t>(sizeof value)) {
    std::random_device device;
    value = std::uint64_t{device()} << 32U | device();
  }
  return wire::hex64(value);
}

std::string frame_of(wire::FrameType type, std::uint64_t request, const wire::Json& json) {
  wire::FrameHeader header;
  header.type = type;
  header.request = request;
  return wire::encode_frame(header, wire::dump_json(json));
}

// Reads the welcome. Returns the nonce that a proof of the token must answer; empty if none is required.
Result<std::string> read_welcome(Connection& link, const Endpoint& endpoint, const Deadline& deadline) {
  const auto frame = link.read(deadline);
  if (!frame) {
    if (frame.status().code() != Code::deadline_exceeded) return frame.status();
    return Status(Code::deadline_exceeded, fmt::format("{} takes connections but does not greet", endpoint.text()),
                  "the service may be stopped or busy; see its log");
  }
  const auto json = frame->json();
  if (!json) return json.status();
  if (frame->type == wire::FrameType::failure) return wire::status_from_failure(*json);
  if (frame->type != wire::FrameType::welcome)
    return Status(Code::protocol_error, fmt::format("{} does not begin with a welcome", endpoint.text()));
  if (auto protocol = wire::integer_field(*json, "protocol", wire::kProtocolVersion, wire::kProtocolVersion); !protocol)
    return Status(Code::protocol_error, fmt::format("{}: welcome: {}", endpoint.text(), protocol.status().message()));
  const auto method = wire::string_field(*json, "authentication", 64);
  const auto nonce = wire::string_field(*json, "nonce", 256);
  if (method && *method == auth::kMethod && nonce && auth::is_nonce(*nonce)) return *nonce;
  // On a Unix socket the kernel has told who serves it. Over TCP it may be anybody: a peer that asks for less than a
  // proof, perhaps for the token itself, isn't trusted.
  if (endpoint.is_unix && method && *method == "none") return std::string();
  return Status(
      Code::not_authorised,
      fmt::format("whoever listens at {} doesn't ask for a proof of the token, as the service does", endpoint.text()),
      "nothing was told to it; see who has taken the port, or start a service of this client's version");
}

std::string joined(const std::vector<Endpoint>& endpoints) {
  std::string text;
  for (const Endpoint& endpoint : endpoints) text += (text.empty() ? "" : " nor ") + endpoint.text();
  return text;
}

// What RCBD_PATH says, where the program leaves it open.
Status read_path(Path& path) {
  const char* const given = std::getenv("RCBD_PATH");
  const std::string_view name = given == nullptr ? "" : given;
  if (path != Path::automatic || name.empty()) return {};
  const auto found = path_from_name(name);
  path = found.value_or(path);
  if (found) return {};
  return {Code::invalid_argument, fmt::format("RCBD_PATH is '{}'", name), "auto, shared, direct or gateway"};
}

}  // namespace

std::optional<Path> path_from_name(std::string_view name) {
  constexpr std::pair<std::string_view, Path> kPaths[] = {
      {"auto", Path::automatic}, {"shared", Path::shared}, {"direct", Path::direct}, {"gateway", Path::gateway}};
  for (const auto& [known, path] : kPaths)
    if (known == name) return path;
  return std::nullopt;
}

std::string request_frame(std::uint64_t request, const wire::Json& json) {
  return frame_of(wire::FrameType::request, request, json);
}

Session::Session(ConnectOptions options) : options_(std::move(options)), number_(random_session()) {
  if (!options_.on_notice)
    options_.on_notice = [name = options_.name](const std::string& text) {
      fmt::print(stderr, "{}: {}\n", name, escape_controls(text));
    };
}

Session::~Session() {
  if (!connected()) return;
  const std::string goodbye = frame_of(wire::FrameType::goodbye, 0, wire::Json::object());
  static_cast<void>(connection_->write(goodbye, Deadline(kGoodbyeSeconds)));
}

Result<std::unique_ptr<Session>> Session::open(const ConnectOptions& options) {
  if (!(options.deadline_seconds > 0))
    return Status(Code::invalid_argument, fmt::format("a connection deadline of {} seconds", options.deadline_seconds),
                  "give a number above 0");
  std::unique_ptr<Session> session(new Session(options));
  if (Status status = read_path(session->options_.path); !status) return status;
  auto endpoints = endpoints_to_try(options.endpoint);
  if (!endpoints) return endpoints.status();
  session->endpoints_ = std::move(*endpoints);
  if (Status status = session->connect(Deadline(options.deadline_seconds)); !status) return status;
  return session;
}

Status Session::ensure(const Deadline& deadline) {
  // Unexpected frames are left over from an earlier call, or the service's goodbye: either way, connect anew.
  if (connected() && connection_->has_frame()) drop_connection();
  return connected() ? Status{} : connect(deadline.within(options_.deadline_seconds));
}

void Session::drop_connection() {
  told_goodbye_ = told_goodbye_ || connection_->said_goodbye();
  connection_.reset();
}

std::string Session::gone() const {
  return fmt::format("the service at {}, which {}", endpoint_text_,
                     told_goodbye_ ? "was stopped, to be started again" : "has gone");
}

void Session::notice(const std::string& text) const { options_.on_notice(text); }

void Session::tell_of_stop() {
  if (told_goodbye_ && options_.outlive && !std::exchange(told_caller_of_stop_, true))
    notice(fmt::format("the service at {} was stopped; calls wait until their deadlines for it to be started again",
                       endpoint_text_));
}

Status Session::wait(Retry& retry, const Status& why, const std::string& what) const {
  if (!options_.outlive && retry.failures() > 0) return why;
  if (why.code() == Code::interrupted) return why;
  if (options_.on_wait && !options_.on_wait())
    return {Code::interrupted, fmt::format("interrupted; {} was not waited for", what)};
  if (retry.wait(what, options_.on_notice)) return {};
  return {why.code(), fmt::format("{}; {}", why.message(), retry.tried()), why.hint()};
}

Status Session::connect(const Deadline& deadline) {
  if (!endpoints_.front().published.empty())  // started again, it may be elsewhere
    if (auto now = endpoints_to_try(options_.endpoint)) endpoints_ = std::move(*now);
  // A service that takes a connection and ends it may have too many: then once more. lost: how the last one ended.
  Status lost;
  bool taken = false;
  Retry retry(deadline.left_seconds());
  do {
    taken = false;
    for (const Endpoint& endpoint : endpoints_) {
      connection_.reset();
      const Status status = connect_to(endpoint, deadline);
      if (status) {
        endpoints_ = {Endpoint(endpoint)};
        ++generation_;
        told_goodbye_ = told_caller_of_stop_ = false;
        return {};
      }
      const bool was_taken = std::exchange(connection_, nullptr) != nullptr;
      if (status.code() == Code::deadline_exceeded && !lost.ok()) return lost;
      if (status.code() != Code::unavailable || status.hint() == kDescriptorsHint) return status;
      if (was_taken) lost = status;
      taken = taken || was_taken;
    }
  } while (taken && retry.wait(fmt::format("a connection to {}", joined(endpoints_)), options_.on_notice));
  if (taken) return lost;
  tell_of_stop();
  if (const std::string& published = endpoints_.front().published; !published.empty())
    return {Code::unavailable, fmt::format("{} no longer answers", published),
            fmt::format("it was at {}; one that is started elsewhere writes the file anew", endpoints_.front().text())};
  if (generation_ > 0)
    return {Code::unavailable,
            fmt::format("the service at {} {}", endpoint_text_, told_goodbye_ ? "was stopped" : "has gone"),
            told_goodbye_ ? "start it again: rcbctl up"
                          : "one that rcbctl up started comes back by itself: see rcbctl status, and its log"};
  const bool comes_back = std::any_of(endpoints_.begin(), endpoints_.end(), [](const Endpoint& endpoint) {
    return endpoint_holder(endpoint.text()).has_value();
  });
  return {Code::unavailable, fmt::format("no service answers at {}", joined(endpoints_)),
          comes_back ? "it is being started again: try again in a moment; rcbctl status says more"
                     : "start one: rcbctl up"};
}

Status Session::connect_to(const Endpoint& endpoint, const Deadline& deadline) {
  auto connection = Connection::open(endpoint, deadline, options_.on_notice, options_.on_wait);
  if (!connection) return connection.status();
  connection_ = std::move(*connection);
  process_ = ::getpid();
  endpoint_text_ = endpoint.text();
  data_.reset();
  data_addresses_.clear();
  local_addresses_.clear();
  data_tried_ = false;
  data_failures_ = 0;
  share_refused_ = false;
  const auto reply = greet(connection_, endpoint, std::string(kEndpointListener), deadline);
  if (!reply) return reply.status();
  const auto ranks = wire::integer_field(*reply, "ranks", 1, 1 << 20);
  if (!ranks) return {Code::protocol_error, fmt::format("answer to hello: {}", ranks.status().message())};
  ranks_ = static_cast<int>(*ranks);
  if (const auto token = reply->find("data_token"); endpoint.is_unix && token != reply->end() && token->is_string())
    token_ = token->get<std::string>();  // for ranks on other machines
  if (const auto data = reply->find("data"); data != reply->end() && data->is_array())
    for (const wire::Json& address : *data)
      data_addresses_.push_back(address.is_string() ? address.get<std::string>() : std::string());
  const auto local = reply->find("local");
  const std::string here = machine_key();
  for (std::size_t rank = 0; rank < data_addresses_.size(); ++rank) {
    const bool is_unix = data_addresses_[rank].starts_with("unix:");
    local_addresses_.push_back(is_unix ? data_addresses_[rank] : "");
    if (is_unix || local == reply->end() || !local->is_array() || rank >= local->size()) continue;
    const auto machine = wire::string_field((*local)[rank], "machine", kMachineBytesMax);
    const auto address = wire::string_field((*local)[rank], "address", kSocketPathMax + 5);
    if (machine && address && *machine == here && address->starts_with("unix:")) local_addresses_[rank] = *address;
  }
  return {};
}

Result<wire::Json> Session::greet(std::unique_ptr<Connection>& link, const Endpoint& endpoint,
                                  const std::string& listener, const Deadline& deadline) {
  std::vector<std::string> tokens;
  if (!endpoint.is_unix) {
    auto found = tokens_to_try(*link, endpoint, listener);
    if (!found) return found.status();
    tokens = std::move(*found);
  }
  for (std::size_t attempt = 0;; ++attempt) {
    auto reply = greet_once(*link, endpoint, listener, tokens.empty() ? "" : tokens[attempt], deadline);
    // A token that lies here from an earlier service may be unknown to this one, or call for TLS where it has none.
    const Code code = reply.status().code();
    const bool refused = code == Code::not_authorised || code == Code::protocol_error;
    if (!refused || attempt + 1 >= tokens.size()) return reply;
    auto connection = Connection::open(endpoint, deadline, options_.on_notice, options_.on_wait);
    if (!connection) return connection.status();
    link = std::move(*connection);
  }
}

Result<wire::Json> Session::greet_once(Connection& link, const Endpoint& endpoint, const std::string& listener,
                                       const std::string& token, const Deadline& deadline) {
  // The token has come to us by a way that nobody on the network controls; what is said on the network can't undo TLS.
  if (link.off_loopback() && !auth::trusts_network(token))
    if (Status encrypted = link.encrypt(deadline); !encrypted) return encrypted;
  const auto nonce = read_welcome(link, endpoint, deadline);
  if (!nonce) return nonce.status();
  if (nonce->empty()) return say_hello(link, wire::Json::object(), deadline);
  if (token.empty())
    return Status(Code::not_authorised, fmt::format("{} asks for a token and none was found", endpoint.text()),
                  "set RCBD_TOKEN_FILE to the file 'token' of the service's data directory");
  if (Status opened = open_openssl(); !opened) return opened;  // for the proof
  const auth::Opening opening{listener, *nonce, auth::random_nonce(), number_, link.certificate()};
  return prove_and_say_hello(link, token, opening, endpoint.text(), deadline);
}

Result<std::vector<std::string>> Session::tokens_to_try(const Connection& link, const Endpoint& endpoint,
                                                        const std::string& listener) const {
  // A rank's own listener accepts the token that the endpoint accepted.
  if (listener != kEndpointListener && !token_.empty()) return std::vector{token_};
  return tokens_for(endpoint, options_.token, link.this_machine());
}

Result<wire::Json> Session::prove_and_say_hello(Connection& link, const std::string& token, auth::Opening opening,
                                                const std::string& where, const Deadline& deadline) {
  auto reply = say_hello(
      link, {{"nonce", opening.client_nonce}, {"proof", auth::proof(auth::Role::client, token, opening)}}, deadline);
  if (!reply) return reply;
  const auto proof = wire::string_field(*reply, "proof", opening.client_nonce.size());
  if (!proof || !auth::same_secret(*proof, auth::proof(auth::Role::service, token, opening)))
    return Status(Code::not_authorised, fmt::format("whoever listens at {} doesn't know the token", where),
                  "it isn't the service that made the token, which was not told to it; see who has taken the port");
  token_ = token;
  return reply;
}

Result<wire::Json> Session::say_hello(Connection& link, wire::Json more, const Deadline& deadline) {
  wire::Json hello{{"protocol", wire::kProtocolVersion}, {"client", options_.name}, {"session", number_}};
  hello.update(more);
  const std::uint64_t request = next_request();
  // A failed write is reported by the read below.
  static_cast<void>(link.write(frame_of(wire::FrameType::hello, request, hello), deadline));
  const auto answer = await_answer(link, request, deadline);
  if (!answer) return answer.status();
  return answer->json();
}

// The answer to `request`; a failure with request number 0 concerns the connection, so it is returned, too.
Result<Frame> Session::await_answer(Connection& link, std::uint64_t request, const Deadline& deadline) {
  for (;;) {
    auto frame = link.read(deadline);
    if (!frame) return frame.status();
    const bool failure = frame->type == wire::FrameType::failure;
    if (frame->request != request && !(failure && frame->request == 0)) continue;
    if (!failure && frame->type != wire::FrameType::reply) continue;
    if (!failure) return frame;
    const auto json = frame->json();
    if (json && json->contains("failure") && wire::is_true(json->at("failure"), "ending")) told_goodbye_ = true;
    return json ? wire::status_from_failure(*json) : json.status();
  }
}

Result<Frame> Session::exchange(std::uint64_t request, PushSource& source, const std::string& what,
                                const Deadline& deadline) {
  if (!connection_) return lost_connection();  // by an earlier request of the same attempt
  for (auto bytes = source.next(); !bytes.empty() && connection_->write(bytes, deadline);) bytes = source.next();
  return await_answer_to(request, what, deadline);
}

Status Session::lost_connection() const {
  return {Code::unavailable, fmt::format("the connection to {} was lost", endpoint_text_), "see rcbctl status"};
}

Result<Frame> Session::exchange_frames(std::uint64_t request, const std::string& frames, const std::string& what,
                                       const Deadline& deadline) {
  if (!connection_) return lost_connection();
  static_cast<void>(connection_->write(frames, deadline));
  return await_answer_to(request, what, deadline);
}

Result<Frame> Session::await_answer_to(std::uint64_t request, const std::string& what, const Deadline& deadline) {
  auto answer = await_answer(*connection_, request, deadline);
  if (!connection_->lost() || told_goodbye_) drop_connection();
  if (!answer && answer.status().code() == Code::deadline_exceeded && !connection_)
    return Status(Code::deadline_exceeded, fmt::format("{} did not answer in time: {}", endpoint_text_, what),
                  "the service may be stopped or overloaded; see its log, or wait longer");
  return answer;
}

}  // namespace rcb::client
