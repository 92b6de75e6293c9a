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
  static constexpr int kTriesMax = 8;  // others may change the cuts, again and again
  const std::optional<Frame> send;
  const bool still = ask.moved == StepRequest::Moved::none && !ask.edits();
  if (!pushed_ || !(still ? when_needed_ : can_count(ask))) return send;
  if (still && !(cuts_.known && counted_.holds(last_step_, *cuts_.known))) return send;
  if (still) counted_.nothing_moved();
  if (!cuts_.known) {
    auto found = cuts_.ask(session(), name_, retry);
    if (!found) return found.status();
    cuts_.known = std::move(*found);
  }
  std::optional<int> scale;
  for (int tries = 0; tries < kTriesMax; ++tries) {
    if (!still)
      if (Status status = counted_.count(*cuts_.known, rows_of(ask), last_step_, scale); !status) return status;
    wire::Json json{{"scene", name_},
                    {"session", session().number()},
                    {"step", step},
                    {"incarnation", incarnation_},
                    {"deadline_seconds", retry.seconds_left()}};
    if (ask.options.step_seconds) json["step_seconds"] = *ask.options.step_seconds;
    const std::uint64_t request = session().next_request();
    auto frame =
        session().exchange_frames(request, counted_.frame(request, std::move(json)),
                                  fmt::format("count of step {} of scene '{}'", step, name_), retry.deadline());
    if (!frame) return frame.status();
    const auto answer = frame->json();
    if (!answer) return answer.status();
    if (answer->contains("report")) return std::optional(std::move(*frame));
    const auto again = answer->find("again");
    if (still || again == answer->end()) return send;
    if (*again == "scale") {
      const auto due = wire::integer_field(*answer, "scale", -kScaleMost, kScaleMost);
      if (!due) return due.status();
      scale = static_cast<int>(*due);
      continue;
    }
    auto others = cuts_.told_or_asked(*frame, *answer, session(), name_, retry);
    if (!others) return others.status();
    cuts_.known = std::move(*others);
  }
  return send;
}

}  // namespace rcb::client
