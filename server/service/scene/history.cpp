#include "server/service/scene/history.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

namespace rcb::service {
namespace {

// Most reports moved to the file at a time: enough to make the cost of opening it negligible, few enough not to delay a
// step.
constexpr std::size_t kSpillMax = 128;

// Whether a line of the file is a report: others may have written there.
bool is_report(const wire::Json& json) {
  return json.is_object() && wire::string_field(json, "scene", 256).ok() &&
         wire::integer_field(json, "step", 0, wire::kStepMax).ok();
}

}  // namespace

void HistoryMemory::make_room() {
  while (held_ > keep_) {
    History* longest = *std::max_element(histories_.begin(), histories_.end(), [](const History* a, const History* b) {
      return a->recent_.size() < b->recent_.size();
    });
    longest->spill(std::clamp<std::size_t>(longest->recent_.size() / 8, 1, kSpillMax));
  }
}

History::History(HistoryMemory& room, std::string scene)
    : room_(room), scene_(std::move(scene)), file_(report_file_path(room.directory_, scene_)) {
  room_.histories_.insert(this);
}

History::~History() {
  room_.histories_.erase(this);
  room_.held_ -= recent_.size();
}

void History::add(StepReport report) {
  recent_.push_back(std::move(report));
  ++total_;
  ++room_.held_;
  room_.make_room();
}

void History::spill(std::size_t count) {
  std::vector<std::string> lines;
  lines.reserve(count);
  for (std::size_t k = 0; k < count; ++k) lines.push_back(wire::dump_json(to_json(recent_[k])) + "\n");
  const std::uint64_t in_file = file_.count();
  const Status kept = room_.directory_.empty() ? Status(Code::io_error, "the service has no directory for them")
                                               : file_.append(total_ - recent_.size(), lines);
  if (!kept.ok())
    note_loss(kept);
  else if (file_.count() < in_file + count)
    note_loss({Code::io_error, "the file of older reports was changed or removed, and is begun anew"});
  recent_.erase(recent_.begin(), recent_.begin() + static_cast<std::ptrdiff_t>(count));
  room_.held_ -= count;
}

void History::note_loss(const Status& why) {
  if (loss_ == why.message()) return;  // already logged
  loss_ = why.message();
  spdlog::warn("older step reports of scene '{}' are lost: {}", scene_, loss_);
}

void History::read(std::uint64_t first, std::uint64_t last, const std::function<void(wire::Json report)>& take) {
  CHECK(last <= total_, "reports that there are");
  const std::uint64_t recent = total_ - recent_.size();
  if (first < recent) {
    const Status status = file_.read(first, std::min(last, recent), [&](std::uint64_t, std::string_view line) {
      if (auto report = wire::parse_json(line); report.ok() && is_report(*report))
        take(std::move(report).value());
      else
        note_loss({Code::io_error, "the file of older reports was changed"});
    });
    if (!status.ok()) note_loss(status);
  }
  for (std::uint64_t number = std::max(first, recent); number < last; ++number)
    take(to_json(recent_[static_cast<std::size_t>(number - recent)]));
}

}  // namespace rcb::service
