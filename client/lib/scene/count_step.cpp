#include "client/lib/scene/count_step.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "client/lib/scene/scene.hpp"
#include "common/base/exact_scale.hpp"
#include "common/base/random.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

std::uint64_t sum_of_rows(std::uint64_t n) {
  std::uint64_t sum = 0;
  for (std::uint64_t row = 0; row < n; ++row) sum += mix64(row);
  return sum;
}

template <typename T>
void add_array(wire::Json& described, std::string& bytes, const char* name, const char* dtype,
               const std::vector<T>& values, std::size_t columns) {
  wire::Json shape{values.size() / columns};
  if (columns > 1) shape.push_back(columns);
  described.push_back({{"name", name}, {"dtype", dtype}, {"shape", std::move(shape)}});
  bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

std::string fault_frame(std::uint64_t request, wire::Json json, const Status& fault) {
  json["command"] = "count";
  json["fault"] = wire::failure_json(fault)["failure"];
  wire::FrameHeader header;
  header.request = request;
  return wire::encode_frame(header, wire::dump_json(json));
}

}  // namespace

Status CountStep::count(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last,
                        std::optional<int> scale) {
  if (by_ == name_of(cuts) && (!scale || scale == scale_)) return {};
  const bool follows = last && step_ == last && parts_by_ == name_of(cuts) && part_.size() == rows.positions.count;
  const bool counted = by_ == name_of(cuts);  // only the scale is another
  by_.reset();
  step_.reset();
  cuts::CountOptions options;
  options.ids = rows.ids;
  options.weights = rows.weights;
  options.threads = rows.threads;
  options.sum_ids = !id_sum_;
  options.scale = scale.value_or(scale_.value_or(0));
  scale_told_ = scale_told_ || scale;
  const bool hinted = part_.size() == rows.positions.count;
  part_.resize(rows.positions.count);
  for (bool again = false;; again = true) {
    if (hinted || again) options.last_part = part_;
    auto found = cuts::count(cuts, rows.positions, options, part_);
    if (!found) return found.status();
    if (!counted && !again) drifted_ = follows ? std::optional(found->drifted) : std::nullopt;
    count_ = std::move(*found);
    if (!id_sum_) id_sum_ = rows.ids.empty() ? sum_of_rows(count_.n) : count_.id_sum;
    options.sum_ids = false;
    const int due = count_.greatest > 0 ? ExactScale(count_.greatest, count_.n).exponent() : options.scale;
    if (again || scale || scale_told_ || due == options.scale) break;
    options.scale = due;  // most often it is that of the step before
  }
  scale_ = options.scale;
  weighted_ = rows.weighted;
  by_ = parts_by_ = name_of(cuts);
  return {};
}

std::string CountStep::frame(std::uint64_t request, wire::Json json) const {
  json["command"] = "count";
  json["epoch"] = by_->epoch;
  json["hash"] = wire::hex64(by_->hash);
  json["n"] = count_.n;
  json["id_sum"] = wire::hex64(*id_sum_);
  json["drifted"] = drifted_ ? wire::Json(*drifted_) : wire::Json();
  std::vector<std::int32_t> parts;
  std::vector<std::uint64_t> counts, loads;
  for (std::size_t p = 0; p < count_.counts.size(); ++p) {
    if (count_.counts[p] == 0) continue;
    parts.push_back(static_cast<std::int32_t>(p));
    counts.push_back(count_.counts[p]);
    if (count_.loads.empty()) continue;
    loads.push_back(static_cast<std::uint64_t>(count_.loads[p]));
    loads.push_back(static_cast<std::uint64_t>(count_.loads[p] >> 64U));
  }
  if (weighted_)
    json.update({{"scale", *scale_},
                 {"least", count_.least},
                 {"greatest", count_.greatest},
                 {"weights_as_zero", count_.weights_as_zero}});
  std::string bytes;
  wire::Json& arrays = json["arrays"] = wire::Json::array();
  add_array(arrays, bytes, "part", "<i4", parts, 1);
  add_array(arrays, bytes, "count", "<u8", counts, 1);
  if (weighted_) add_array(arrays, bytes, "load", "<u8", loads, 2);
  wire::FrameHeader header;
  header.request = request;
  header.bulk_bytes = bytes.size();
  return wire::encode_frame(header, wire::dump_json(json)) + bytes;
}

Result<std::optional<Frame>> CountStep::ask(const CountCall& call, const std::optional<CountedRows>& rows,
                                            SceneCuts& cuts, const Retry& retry) {
  static constexpr int kTriesMax = 8;  // others may change the cuts, again and again
  const std::optional<Frame> send;
  const auto find_cuts = [&]() -> Status {
    auto found = SceneCuts::ask(call.session, call.scene, retry);
    if (found) cuts.known = std::move(*found);
    return found.status();
  };
  if (!cuts.known)
    if (Status status = find_cuts(); !status) return status;
  std::optional<int> scale;
  for (int tries = 0; tries < kTriesMax; ++tries) {
    const Status counted = rows ? count(*cuts.known, *rows, call.last_step, scale) : Status();
    if (!counted && !call.of_member) return counted;
    wire::Json json{{"scene", call.scene},
                    {"session", call.session.number()},
                    {"step", call.step},
                    {"incarnation", call.incarnation},
                    {"deadline_seconds", retry.seconds_left()}};
    if (call.step_seconds) json["step_seconds"] = *call.step_seconds;
    const std::uint64_t request = call.session.next_request();
    const std::string sent = counted ? frame(request, std::move(json)) : fault_frame(request, std::move(json), counted);
    auto told = call.session.exchange_frames(
        request, sent, fmt::format("count of step {} of scene '{}'", call.step, call.scene), retry.deadline());
    if (!counted) return counted;  // the others have been told
    if (!told) return told.status();
    const auto answer = told->json();
    if (!answer) return answer.status();
    if (answer->contains("report")) return std::optional(std::move(*told));
    const auto again = answer->find("again");
    if (!rows || again == answer->end()) return send;
    if (*again == "scale") {
      const auto due = wire::integer_field(*answer, "scale", -kScaleMost, kScaleMost);
      if (!due) return due.status();
      scale = static_cast<int>(*due);
    } else if (Status status = find_cuts(); !status) {
      return status;
    }
  }
  return send;
}

bool Scene::State::can_count(const StepRequest& ask) const {
  const bool weighted = has_weights_ || !ask.options.weights.empty();
  return when_needed_ && ask.whole() && !ask.edits() &&
         (!weighted || !ask.options.weights.empty() || weights_.size() == ask.positions.count);
}

CountedRows Scene::State::rows_of(const StepRequest& ask) const {
  const bool given = !ask.options.weights.empty();
  const bool weighted = has_weights_ || given;
  return {ask.positions, ids_of_rows(ask),
          given      ? ask.options.weights
          : weighted ? std::span<const double>(weights_)
                     : std::span<const double>(),
          weighted, std::max(ask.options.threads, scene_.threads)};
}

Result<std::optional<Frame>> Scene::State::step_by_count(const StepRequest& ask, std::int64_t step,
                                                         const Retry& retry) {
  const bool still = ask.moved == StepRequest::Moved::none && !ask.edits();
  const bool counts = still ? when_needed_ && cuts_.known && counted_.holds(last_step_, *cuts_.known) : can_count(ask);
  if (!pushed_ || !counts) return std::optional<Frame>();
  if (still) counted_.nothing_moved();
  const std::optional<CountedRows> rows = still ? std::nullopt : std::optional(rows_of(ask));
  return counted_.ask({session(), name_, incarnation_, step, last_step_, ask.options.step_seconds, false}, rows, cuts_,
                      retry);
}

}  // namespace rcb::client
