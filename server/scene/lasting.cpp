#include "server/scene/lasting.hpp"

#include <cstring>
#include <limits>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::scene {
namespace {

using wire::Json;

template <typename T>
Json packed(const std::vector<T>& values) {
  std::vector<std::uint8_t> bytes(values.size() * sizeof(T));
  if (!bytes.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return Json::binary(std::move(bytes));
}

template <typename T>
std::vector<T> unpacked(const Json& json) {
  const auto& bytes = json.get_binary();
  std::vector<T> values(bytes.size() / sizeof(T));
  if (!values.empty()) std::memcpy(values.data(), bytes.data(), values.size() * sizeof(T));
  return values;
}

template <typename T>
Json or_null(const std::optional<T>& value) {
  return value ? Json(*value) : Json();
}

template <typename T>
std::optional<T> maybe(const Json& json) {
  return json.is_null() ? std::nullopt : std::optional(json.get<T>());
}

std::string bytes_of(const Json& json) {
  std::string bytes;
  Json::to_cbor(json, bytes);
  return bytes;
}

SceneOptions options_from(const Json& json) {
  SceneOptions options;
  options.parts = json.at("parts").get<int>();
  options.dims = json.at("dims").get<int>();
  options.method = cuts::method_from_name(json.at("method").get<std::string>()).value();
  const Json& tolerance = json.at("tolerance");
  options.tolerance = tolerance.is_string() ? std::numeric_limits<double>::infinity() : tolerance.get<double>();
  options.axis_hysteresis = json.at("axis_hysteresis").get<double>();
  options.cut_tolerance = json.at("cut_tolerance").get<double>();
  options.policy = policy_from_name(json.at("policy").get<std::string>()).value();
  options.positions = travel_from_name(json.at("positions").get<std::string>()).value();
  options.part_sizes = json.at("part_sizes").get<std::vector<double>>();
  if (options.parts < 1 || options.parts > wire::kPartsMax || options.dims < 1 || options.dims > 3 ||
      (!options.part_sizes.empty() && options.part_sizes.size() != static_cast<std::size_t>(options.parts)))
    throw std::out_of_range("options");
  return options;
}

Json loads_json(const partition::LoadSummary* loads) {
  if (loads == nullptr) return nullptr;
  Json json{{"counts", packed(loads->counts)}};
  if (loads->weighted)
    json.update(
        {{"loads", packed(loads->loads)}, {"scale", loads->scale_exponent}, {"as_zero", loads->weights_as_zero}});
  return json;
}

std::shared_ptr<const partition::LoadSummary> loads_from(const Json& json, const SceneOptions& options) {
  if (json.is_null()) return nullptr;
  auto counts = unpacked<std::uint64_t>(json.at("counts"));
  if (counts.size() != static_cast<std::size_t>(options.parts)) throw std::out_of_range("counts");
  if (!json.contains("loads"))
    return std::make_shared<const partition::LoadSummary>(
        partition::summarise_counts(std::move(counts), options.part_sizes));
  auto loads = unpacked<u128>(json["loads"]);
  if (loads.size() != counts.size()) throw std::out_of_range("loads");
  return std::make_shared<const partition::LoadSummary>(
      partition::summarise_weighted(std::move(counts), std::move(loads), json.at("scale").get<int>(),
                                    json.at("as_zero").get<std::uint64_t>(), options.part_sizes));
}

Json totals_json(const SceneTotals& totals) {
  Json json = to_json(static_cast<const StepCounts&>(totals));
  json.update({{"steps", totals.steps},
               {"repartitions", totals.repartitions},
               {"skipped", totals.skipped},
               {"asked", totals.asked}});
  return json;
}

SceneTotals totals_from(const Json& json) {
  SceneTotals totals;
  const auto number = [&json](const char* name) { return json.at(name).get<std::uint64_t>(); };
  totals.bytes = number("bytes");
  totals.drifted = number("drifted");
  totals.moved = number("moved");
  totals.migrated = number("migrated");
  totals.scanned = number("scanned");
  totals.searched = number("searched");
  totals.rounds = number("rounds");
  totals.reductions = number("reductions");
  const Json& seconds = json.at("seconds");
  totals.seconds = {seconds.at("receive").get<double>(), seconds.at("exchange").get<double>(),
                    seconds.at("search").get<double>(), seconds.at("migrate").get<double>(),
                    seconds.at("total").get<double>()};
  totals.steps = number("steps");
  totals.repartitions = number("repartitions");
  totals.skipped = json.at("skipped").get<std::map<std::string, std::uint64_t>>();
  totals.asked = json.at("asked").get<std::map<std::string, std::uint64_t>>();
  return totals;
}

Status damaged(const char* what, const std::exception& why) {
  return {Code::io_error, fmt::format("the {} kept can't be read: {}", what, why.what())};
}

}  // namespace

Json to_json(const SceneOptions& options) {
  return {{"parts", options.parts},
          {"dims", options.dims},
          {"method", cuts::method_name(options.method)},
          {"tolerance", wire::number_json(options.tolerance)},
          {"axis_hysteresis", options.axis_hysteresis},
          {"cut_tolerance", options.cut_tolerance},
          {"policy", policy_name(options.policy)},
          {"positions", travel_name(options.positions)},
          {"part_sizes", options.part_sizes}};
}

std::string encode(const Lasting& lasting) {
  const SceneState& now = lasting.now;
  return bytes_of({{"options", to_json(now.options)},
                   {"n", now.n},
                   {"weights", now.weights},
                   {"ids", now.ids},
                   {"epoch", now.epoch},
                   {"hash", now.hash},
                   {"loads", loads_json(now.loads.get())},
                   {"rounds", now.search_rounds},
                   {"reductions", now.search_reductions},
                   {"step", or_null(now.step)},
                   {"id_sum", or_null(now.id_sum)},
                   {"id_next", or_null(now.id_next)},
                   {"totals", totals_json(lasting.totals)},
                   {"costs", lasting.costs.to_json()},
                   {"not_adopted", or_null(lasting.error_when_not_adopted)},
                   {"last_session", lasting.last_session},
                   {"last_members", packed(lasting.last_members)},
                   {"last_report", lasting.last_report}});
}

// nlohmann's exceptions and those above say what is wrong.
Result<Lasting> decode_lasting(std::string_view bytes, std::uint64_t incarnation) try {
  const Json json = Json::from_cbor(bytes);
  Lasting lasting;
  SceneState& now = lasting.now;
  now.options = options_from(json.at("options"));
  now.incarnation = incarnation;
  now.n = json.at("n").get<std::uint64_t>();
  now.weights = json.at("weights").get<bool>();
  now.ids = json.at("ids").get<bool>();
  now.epoch = json.at("epoch").get<std::uint64_t>();
  now.hash = json.at("hash").get<std::uint64_t>();
  now.loads = loads_from(json.at("loads"), now.options);
  now.search_rounds = json.at("rounds").get<std::uint64_t>();
  now.search_reductions = json.at("reductions").get<std::uint64_t>();
  now.step = maybe<std::int64_t>(json.at("step"));
  now.id_sum = maybe<std::uint64_t>(json.at("id_sum"));
  now.id_next = maybe<std::uint64_t>(json.at("id_next"));
  lasting.totals = totals_from(json.at("totals"));
  lasting.costs = CostAccount::from_json(json.at("costs"));
  lasting.error_when_not_adopted = maybe<double>(json.at("not_adopted"));
  lasting.last_session = json.at("last_session").get<std::uint64_t>();
  lasting.last_members = unpacked<MemberShare>(json.at("last_members"));
  lasting.last_report = json.at("last_report");
  if (now.step.has_value() != (now.loads != nullptr) || now.step.has_value() != (now.epoch > 0) ||
      now.step.has_value() != lasting.last_report.is_object())
    throw std::out_of_range("steps");
  return lasting;
} catch (const std::exception& why) {
  return damaged("state", why);
}

std::string encode(const cuts::CutTree& tree) {
  const cuts::CutArrays arrays = cuts::arrays_of(tree);
  return bytes_of({{"dims", arrays.dims},
                   {"method", cuts::method_name(arrays.method)},
                   {"parts", arrays.parts},
                   {"part_sizes", packed(arrays.part_sizes)},
                   {"axes", packed(arrays.axes)},
                   {"at", packed(arrays.at)},
                   {"id", packed(arrays.id)}});
}

Result<cuts::CutTree> decode_tree(std::string_view bytes) try {
  const Json json = Json::from_cbor(bytes);
  cuts::CutArrays arrays;
  arrays.dims = json.at("dims").get<int>();
  arrays.method = cuts::method_from_name(json.at("method").get<std::string>()).value();
  arrays.parts = json.at("parts").get<int>();
  arrays.part_sizes = unpacked<double>(json.at("part_sizes"));
  arrays.axes = unpacked<std::int32_t>(json.at("axes"));
  arrays.at = unpacked<double>(json.at("at"));
  arrays.id = unpacked<cuts::Id>(json.at("id"));
  return cuts::tree_of(arrays);
} catch (const std::exception& why) {
  return damaged("cuts", why);
}

}  // namespace rcb::scene
