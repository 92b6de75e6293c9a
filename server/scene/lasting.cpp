#include "server/scene/lasting.hpp"

#include <cmath>
#include <cstring>
#include <iterator>
#include <numeric>
#include <stdexcept>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::scene {
namespace {

using wire::Json;
using wire::or_null;

// Reading throws, as nlohmann's functions do; decode_lasting() and decode_tree() catch it.
void need(bool holds, const char* what) {
  if (!holds) throw std::out_of_range(what);
}

template <typename T>
T valid(Result<T> read) {
  if (!read.ok()) throw std::out_of_range(read.status().message());
  return std::move(read).value();
}

std::uint64_t whole(const Json& json, std::uint64_t most = ~std::uint64_t{0}) {
  need(json.is_number_unsigned() && json.get<std::uint64_t>() <= most, "a number");
  return json.get<std::uint64_t>();
}

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

std::string bytes_of(const Json& json) {
  std::string bytes;
  Json::to_msgpack(json, bytes);
  return bytes;
}

Json loads_json(const partition::LoadSummary* loads) {
  if (loads == nullptr) return nullptr;
  Json json{{"counts", packed(loads->counts)}};
  if (loads->weighted)
    json.update(
        {{"loads", packed(loads->loads)}, {"scale", loads->scale_exponent}, {"as_zero", loads->weights_as_zero}});
  return json;
}

std::shared_ptr<const partition::LoadSummary> loads_from(const Json& json, const SceneState& now) {
  if (json.is_null()) return nullptr;
  auto counts = unpacked<std::uint64_t>(json.at("counts"));
  need(counts.size() == static_cast<std::size_t>(now.options.parts), "a count of each part");
  need(std::accumulate(counts.begin(), counts.end(), u128{0}) == now.n, "counts of all particles");
  if (!json.contains("loads"))
    return std::make_shared<const partition::LoadSummary>(
        partition::summarise_counts(std::move(counts), now.options.part_sizes));
  auto loads = unpacked<u128>(json["loads"]);
  need(loads.size() == counts.size() && sum_fits(loads), "a load of each part");
  const Json& scale = json.at("scale");
  need(scale.is_number_integer() && scale >= -wire::kWeightScaleMost && scale <= wire::kWeightScaleMost, "a scale");
  return std::make_shared<const partition::LoadSummary>(partition::summarise_weighted(
      std::move(counts), std::move(loads), scale.get<int>(), whole(json.at("as_zero"), now.n), now.options.part_sizes));
}

// Of the numbers, in order.
constexpr std::uint64_t StepCounts::*kCounts[] = {&StepCounts::bytes,    &StepCounts::drifted,   &StepCounts::moved,
                                                  &StepCounts::migrated, &StepCounts::scanned,   &StepCounts::searched,
                                                  &StepCounts::rounds,   &StepCounts::reductions};
constexpr double StepSeconds::*kSeconds[] = {&StepSeconds::receive, &StepSeconds::exchange, &StepSeconds::search,
                                             &StepSeconds::migrate, &StepSeconds::total};

Json totals_json(const SceneTotals& totals) {
  std::vector<std::uint64_t> counts{totals.steps, totals.repartitions};
  for (const auto of : kCounts) counts.push_back(totals.*of);
  std::vector<double> seconds;
  for (const auto of : kSeconds) seconds.push_back(totals.seconds.*of);
  Json json = Json::object();
  json["counts"] = packed(counts);
  json["seconds"] = packed(seconds);
  json["skipped"] = totals.skipped;
  json["asked"] = totals.asked;
  return json;
}

SceneTotals totals_from(const Json& json) {
  SceneTotals totals;
  const auto counts = unpacked<std::uint64_t>(json.at("counts"));
  const auto seconds = unpacked<double>(json.at("seconds"));
  need(counts.size() == 2 + std::size(kCounts) && seconds.size() == std::size(kSeconds), "all totals");
  totals.steps = counts[0];
  totals.repartitions = counts[1];
  for (std::size_t k = 0; k < std::size(kCounts); ++k) totals.*kCounts[k] = counts[2 + k];
  for (std::size_t k = 0; k < std::size(kSeconds); ++k) {
    need(std::isfinite(seconds[k]), "finite seconds");
    totals.seconds.*kSeconds[k] = seconds[k];
  }
  for (const auto& [name, into] : {std::pair{"skipped", &totals.skipped}, {"asked", &totals.asked}})
    for (const auto& [of, count] : json.at(name).get_ref<const Json::object_t&>()) (*into)[of] = whole(count);
  return totals;
}

Status damaged(const char* what, const std::exception& why) {
  return {Code::io_error, fmt::format("the {} kept can't be read: {}", what, why.what())};
}

}  // namespace

std::string encode_frame(const SceneState& now) {
  return bytes_of({{"options", to_json(now.options)},
                   {"part_sizes", packed(now.options.part_sizes)},
                   {"n", now.n},
                   {"weights", now.weights},
                   {"ids", now.ids},
                   {"epoch", now.epoch},
                   {"hash", now.hash},
                   {"rounds", now.search_rounds},
                   {"reductions", now.search_reductions}});
}

// Field by field, since a list of all would be copied: it is done at each step.
std::string encode(const Lasting& lasting, const std::string& frame) {
  const SceneState& now = lasting.now;
  Json json = Json::object();
  json["frame"] = Json::binary(std::vector<std::uint8_t>(frame.begin(), frame.end()));
  json["loads"] = loads_json(now.loads.get());
  json["step"] = or_null(now.step);
  json["id_sum"] = or_null(now.id_sum);
  json["totals"] = totals_json(lasting.totals);
  json["costs"] = lasting.costs.to_json();
  json["not_adopted"] = or_null(lasting.error_when_not_adopted);
  json["last_sessions"] = packed(lasting.last_sessions);
  json["last_report"] = lasting.last_report;
  return bytes_of(json);
}

Result<Lasting> decode_lasting(std::string_view bytes, std::uint64_t incarnation) try {
  const Json json = valid(wire::parse_msgpack(bytes));
  Lasting lasting;
  SceneState& now = lasting.now;
  const auto& frame_bytes = json.at("frame").get_binary();
  const Json frame =
      valid(wire::parse_msgpack({reinterpret_cast<const char*>(frame_bytes.data()), frame_bytes.size()}));
  Json options = frame.at("options");
  options["part_sizes"] = unpacked<double>(frame.at("part_sizes"));
  now.options = valid(read_options(options));
  now.incarnation = incarnation;
  now.n = whole(frame.at("n"), wire::kParticlesMax);
  now.weights = frame.at("weights").get<bool>();
  now.ids = frame.at("ids").get<bool>();
  now.epoch = whole(frame.at("epoch"));
  now.hash = whole(frame.at("hash"));
  now.search_rounds = whole(frame.at("rounds"));
  now.search_reductions = whole(frame.at("reductions"));
  now.loads = loads_from(json.at("loads"), now);
  if (const Json& step = json.at("step"); !step.is_null())
    now.step = static_cast<std::int64_t>(whole(step, wire::kStepMax));
  if (const Json& sum = json.at("id_sum"); !sum.is_null()) now.id_sum = whole(sum);
  lasting.totals = totals_from(json.at("totals"));
  lasting.costs = CostAccount::from_json(json.at("costs"));
  if (const Json& error = json.at("not_adopted"); !error.is_null()) lasting.error_when_not_adopted = finite_from(error);
  lasting.last_sessions = unpacked<std::uint64_t>(json.at("last_sessions"));
  lasting.last_report = json.at("last_report").get<std::string>();
  if (!lasting.last_report.empty()) need(valid(wire::parse_json(lasting.last_report)).is_object(), "a report");
  const bool stepped = now.step.has_value();
  need((now.loads != nullptr) == stepped && (now.epoch > 0) == stepped && (lasting.totals.steps > 0) == stepped &&
           !lasting.last_report.empty() == stepped,
       "all that a step leaves, or nothing of it");
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
  const Json json = valid(wire::parse_msgpack(bytes));
  cuts::CutArrays arrays;
  arrays.dims = static_cast<int>(whole(json.at("dims"), 3));
  arrays.method = cuts::method_from_name(json.at("method").get<std::string>()).value();
  arrays.parts = static_cast<int>(whole(json.at("parts"), wire::kPartsMax));
  arrays.part_sizes = unpacked<double>(json.at("part_sizes"));
  arrays.axes = unpacked<std::int32_t>(json.at("axes"));
  arrays.at = unpacked<double>(json.at("at"));
  arrays.id = unpacked<cuts::Id>(json.at("id"));
  return valid(cuts::tree_of(arrays));
} catch (const std::exception& why) {
  return damaged("cuts", why);
}

}  // namespace rcb::scene
