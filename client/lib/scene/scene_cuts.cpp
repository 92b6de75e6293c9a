#include "client/lib/scene/scene_cuts.hpp"

#include <fmt/format.h>

#include "common/cuts/cut_arrays.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

template <typename T>
bool take_array(const Frame& answer, const char* name, std::vector<T>& into) {
  const auto values = answer.array<T>(name);
  if (values) into.assign(values->begin(), values->end());
  return values.has_value();
}

// json: what the answer says of the cuts beside their arrays.
Result<cuts::Cuts> read_cuts(const Frame& answer, const wire::Json& json) {
  const auto odd = [](const std::string& why) {
    return Status(Code::protocol_error, "the service's cuts: " + why, "use a client and a service of the same version");
  };
  if (!json.is_object()) return odd("not an object");
  cuts::CutArrays arrays;
  wire::FieldReader fields(json);
  arrays.dims = static_cast<int>(fields.integer("dims", 1, geometry::kDimsMax));
  arrays.parts = static_cast<int>(fields.integer("parts", 1, wire::kPartsMax));
  const auto epoch = static_cast<std::uint64_t>(fields.integer("epoch", 0, kLarge));
  const auto method = cuts::method_from_name(fields.text("method", 16));
  const std::string hash = fields.text("hash", 16);
  if (!fields.ok()) return odd(fields.status().message());
  if (!method || !take_array(answer, "axes", arrays.axes) || !take_array(answer, "at", arrays.at) ||
      !take_array(answer, "id", arrays.id))
    return odd("an unknown method, or not their arrays");
  arrays.method = *method;
  take_array(answer, "part_sizes", arrays.part_sizes);
  auto tree = cuts::tree_of(arrays);
  if (!tree) return tree.status();
  cuts::Cuts found(std::move(*tree), epoch);
  if (wire::hex64(found.hash()) != hash)
    return odd(fmt::format("their hash is {}, not {}", wire::hex64(found.hash()), hash));
  return found;
}

}  // namespace

Result<cuts::Cuts> SceneCuts::ask(Session& session, const std::string& scene, const Retry& retry) {
  const auto answer = session.call_once({{"command", "cuts"}, {"scene", scene}, {"list", "arrays"}}, retry);
  if (!answer) return answer.status();
  const auto json = answer->json();
  return json ? read_cuts(*answer, *json) : json.status();
}

wire::Json SceneCuts::known_json() const {
  if (!known) return wire::Json::object();
  return {{"epoch", known->epoch()}, {"hash", wire::hex64(known->hash())}};
}

Result<std::optional<cuts::Cuts>> SceneCuts::after_step(const Frame& answer, const wire::Json& json,
                                                        std::uint64_t epoch) const {
  const auto told = json.find("cuts");
  if (told == json.end()) return known && known->epoch() == epoch ? known : std::nullopt;
  auto found = read_cuts(answer, *told);
  if (!found) return found.status();
  return std::optional(std::move(*found));
}

Result<cuts::Cuts> SceneCuts::current(std::uint64_t epoch, Session& session, const std::string& scene,
                                      double deadline_seconds, const std::function<Status(const Retry&)>& hold) {
  if (known && known->epoch() >= epoch) return *known;
  Retry retry(deadline_seconds);
  auto found = session.retry_until_deadline(retry, [&]() -> Result<cuts::Cuts> {
    if (Status status = hold(retry); !status) return status;
    return ask(session, scene, retry);
  });
  if (found) known = *found;
  return found;
}

}  // namespace rcb::client
