#include "client/lib/client.hpp"

#include <cmath>
#include <utility>

#include <fmt/format.h>

#include "client/lib/scene/client_state.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

template <typename T>
std::span<const T> elements(const Array& array) {
  if (array.dtype != wire::dtype_of<T>()) return {};
  return {reinterpret_cast<const T*>(array.bytes.data()), array.bytes.size() / sizeof(T)};
}

}  // namespace

Result<wire::Json> described(Session& session, wire::Json request, const Retry& retry) {
  const auto answer = session.call_once(std::move(request), retry);
  return answer ? answer->json() : answer.status();
}

std::span<const double> Array::f8() const { return elements<double>(*this); }
std::span<const std::int64_t> Array::i8() const { return elements<std::int64_t>(*this); }
std::span<const std::int32_t> Array::i4() const { return elements<std::int32_t>(*this); }

const Array* Reply::find(const std::string& name) const {
  for (const Array& array : arrays)
    if (array.name == name) return &array;
  return nullptr;
}

Client::Client(std::shared_ptr<State> state) : state_(std::move(state)) {}
Client::Client(Client&&) noexcept = default;
Client& Client::operator=(Client&&) noexcept = default;
Client::~Client() = default;

Result<Client> Client::connect(const ConnectOptions& options) {
  auto session = Session::open(options);
  if (!session) return session.status();
  auto state = std::make_shared<State>();
  state->session = std::move(*session);
  return Client(std::move(state));
}

Status Client::create_scene(const std::string& name, const SceneOptions& options, double deadline_seconds) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  for (const auto& [option, value] :
       {std::pair("tolerance", options.tolerance), std::pair("axis_hysteresis", options.axis_hysteresis),
        std::pair("cut_tolerance", options.cut_tolerance)})
    if (std::isnan(value))
      return {Code::invalid_argument, fmt::format("{} is not a number", option), "give a number >= 0"};
  if (options.threads < 1)
    return {Code::invalid_argument, fmt::format("{} threads", options.threads), "give 1 or more"};
  wire::Json request{{"command", "scene.create"},
                     {"scene", name},
                     {"parts", options.parts},
                     {"dims", options.dims},
                     {"method", options.method},
                     {"tolerance", wire::number_json(options.tolerance)},
                     {"axis_hysteresis", wire::number_json(options.axis_hysteresis)},
                     {"cut_tolerance", wire::number_json(options.cut_tolerance)},
                     {"policy", options.policy},
                     {"positions", options.positions},
                     {"replace", options.replace}};
  if (!options.part_sizes.empty()) {
    request["part_sizes"] = wire::Json::array();
    for (const double size : options.part_sizes) request["part_sizes"].push_back(wire::number_json(size));
  }
  if (const auto made = state_->session->call(std::move(request), deadline_seconds); !made) return made.status();
  state_->threads[name] = options.threads;
  return {};
}

Status Client::drop_scene(const std::string& name, double deadline_seconds) {
  if (Status status = wire::check_scene_name(name); !status) return status;
  return state_->session->call({{"command", "scene.drop"}, {"scene", name}}, deadline_seconds).status();
}

Status Client::shutdown_service() {
  return state_->session->call({{"command", "shutdown"}}, wire::kDeadlineSecondsDefault).status();
}

Result<Reply> Client::call(const std::string& command, const std::string& arguments_json, double deadline_seconds) {
  if (command == "push" || command.empty())
    return Status(Code::unsupported, fmt::format("the command '{}' can't be called so", command), "use Scene::step");
  if (!(deadline_seconds >= 0))
    return Status(Code::invalid_argument, fmt::format("a deadline of {} seconds", deadline_seconds), "give 0 or more");
  auto request = wire::parse_json(arguments_json.empty() ? "{}" : arguments_json);
  if (!request)
    return Status(Code::invalid_argument, fmt::format("arguments of '{}': {}", command, request.status().message()));
  (*request)["command"] = command;
  auto frame = state_->session->call(std::move(*request), deadline_seconds);
  if (!frame) return frame.status();
  Reply reply{std::move(frame->text), {}};
  reply.arrays.reserve(frame->arrays.size());
  for (wire::Array& array : frame->arrays)
    reply.arrays.push_back(
        {std::move(array.name), std::move(array.dtype), std::move(array.shape), std::move(array.bytes)});
  return reply;
}

int Client::ranks() const { return state_->session->ranks(); }
const std::string& Client::endpoint() const { return state_->session->endpoint(); }

}  // namespace rcb::client
