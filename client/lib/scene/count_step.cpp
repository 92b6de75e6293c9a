#include "client/lib/scene/count_step.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "common/base/exact_scale.hpp"
#include "common/base/random.hpp"
#include "common/wire/count_record.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {
namespace {

std::uint64_t sum_of_rows(std::uint64_t n) {
  std::uint64_t sum = 0;
  for (std::uint64_t row = 0; row < n; ++row) sum += mix64(row);
  return sum;
}

// The request `count` with a record. Names of scenes need no quoting.
std::string count_frame(std::uint64_t request, const CountCall& call, double seconds, const std::string& record) {
  wire::FrameHeader header;
  header.request = request;
  header.bulk_bytes = record.size();
  return wire::encode_frame(
             header, fmt::format(R"({{"command":"count","scene":"{}","deadline_seconds":{}}})", call.scene, seconds)) +
         record;
}

// The same with a fault in its place.
std::string fault_frame(std::uint64_t request, const CountCall& call, double seconds, const Status& fault) {
  return request_frame(request, {{"command", "count"},
                                 {"scene", call.scene},
                                 {"deadline_seconds", seconds},
                                 {"step", call.step},
                                 {"fault", wire::failure_json(fault)["failure"]}});
}

}  // namespace

void CountStep::begin(bool others) {
  found_ = counted_ = false;
  if (!others) return;
  step_.reset();
  id_sum_.reset();
}

Status CountStep::pass(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last,
                       cuts::CountOptions options) {
  const bool known = holds(cuts);
  const bool same = part_.size() == rows.positions.count;
  const bool follows = !found_ && same && last && step_ == last && parts_by_ == name_of(cuts);
  found_ = false;
  step_.reset();
  options.ids = rows.ids;
  options.threads = rows.threads;
  part_.resize(rows.positions.count);
  if (same) options.last_part = part_;
  auto found = cuts::count(cuts, rows.positions, options, part_);
  if (!found) return found.status();
  count_ = std::move(*found);
  if (!known) drifted_ = follows ? std::optional(count_.drifted) : std::nullopt;
  parts_by_ = name_of(cuts);
  found_ = true;
  return {};
}

Status CountStep::find_parts(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last) {
  if (holds(cuts)) return {};
  counted_ = false;
  return pass(cuts, rows, last, {});
}

Status CountStep::count(const cuts::Cuts& cuts, const CountedRows& rows, std::optional<std::int64_t> last,
                        std::optional<int> scale) {
  if (counted_ && holds(cuts) && (!scale || scale == scale_)) return {};
  counted_ = false;
  cuts::CountOptions options;
  options.weights = rows.weights;
  options.scale = scale.value_or(scale_.value_or(0));
  scale_told_ = scale_told_ || scale;
  if (rows.id_sums.negative) options.id_key = 0;  // the pass says which
  for (bool again = false;; again = true) {
    if (Status status = pass(cuts, rows, last, options); !status) return status;
    const int due = count_.greatest > 0 ? ExactScale(count_.greatest, count_.n).exponent() : options.scale;
    if (again || scale || scale_told_ || due == options.scale) break;
    options.scale = due;  // most often it is that of the step before
  }
  if (!rows.ids.empty())
    id_sum_ = rows.id_sums.any_order;
  else if (!id_sum_)
    id_sum_ = sum_of_rows(count_.n);
  scale_ = options.scale;
  weighted_ = rows.weighted;
  counted_ = true;
  return {};
}

std::string CountStep::record(const CountCall& call) const {
  wire::CountRecord record;
  record.step = call.step;
  if (const auto incarnation = wire::parse_hex64(call.incarnation)) record.incarnation = *incarnation;
  record.epoch = parts_by_->epoch;
  record.hash = parts_by_->hash;
  record.n = count_.n;
  record.inserted = call.options.inserted;
  record.removed = call.options.removed;
  record.id_sum = id_sum_;
  record.drifted = drifted_;
  record.step_seconds = call.options.step_seconds;
  if (weighted_) record.weights = wire::WeightCount{*scale_, count_.least, count_.greatest, count_.weights_as_zero, {}};
  for (std::size_t p = 0; p < count_.counts.size(); ++p) {
    if (count_.counts[p] == 0) continue;
    record.parts.push_back(static_cast<std::int32_t>(p));
    record.counts.push_back(count_.counts[p]);
    if (weighted_) record.weights->loads.push_back(count_.loads.empty() ? 0 : count_.loads[p]);
  }
  return wire::encode(record);
}

Result<std::optional<Answer>> CountStep::ask(const CountCall& call, const CountedRows& rows, SceneCuts& cuts,
                                             const Retry& retry) {
  static constexpr int kTriesMax = 8;  // others may change the cuts, again and again
  const std::optional<Answer> send;
  const auto find_cuts = [&]() -> Status {
    auto found = SceneCuts::ask(call.session, call.scene, retry);
    if (found) cuts.known = std::move(*found);
    return found.status();
  };
  if (!cuts.known)
    if (Status status = find_cuts(); !status) return status;
  std::optional<int> scale;
  for (int tries = 0; tries < kTriesMax; ++tries) {
    const Status counted = count(*cuts.known, rows, call.last_step, scale);
    if (!counted && !call.of_seat) return counted;
    const std::uint64_t request = call.session.next_request();
    const double seconds = retry.seconds_left();
    const std::string sent =
        counted ? count_frame(request, call, seconds, record(call)) : fault_frame(request, call, seconds, counted);
    auto told = call.session.exchange_frames(
        request, sent, fmt::format("count of step {} of scene '{}'", call.step, call.scene), retry.deadline());
    if (!counted) return counted;  // the others have been told
    if (!told) return told.status();
    Answer answered(std::move(*told));
    const auto& answer = answered.json;
    if (!answer) return answer.status();
    if (answer->contains("report")) return std::optional(std::move(answered));
    const auto again = answer->find("again");
    if (again == answer->end()) return send;
    if (*again == "scale") {
      const auto due = wire::integer_field(*answer, "scale", -wire::kWeightScaleMost, wire::kWeightScaleMost);
      if (!due) return due.status();
      scale = static_cast<int>(*due);
    } else if (Status status = find_cuts(); !status) {
      return status;
    }
  }
  return send;
}

}  // namespace rcb::client
