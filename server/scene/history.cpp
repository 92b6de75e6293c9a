#include "server/scene/history.hpp"

#include <algorithm>
#include <iterator>
#include <mutex>
#include <utility>

#include <spdlog/spdlog.h>

namespace rcb::scene {
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

// The reports in the file. Those who hold it are the history and the jobs of the memory's thread.
class History::Older {
 public:
  Older(std::string scene, const std::string& directory)
      : scene_(std::move(scene)), file_(report_file_path(directory, scene_)) {}

  // On the memory's thread.
  void append(std::uint64_t first, const std::vector<std::string>& lines) {
    const std::uint64_t in_file = file_.count();
    if (const Status kept = file_.append(first, lines); !kept.ok())
      note_loss(kept);
    else if (file_.count() < in_file + lines.size())
      note_loss({Code::io_error, "the file of older reports was changed or removed, and is begun anew"});
  }

  // On the memory's thread.
  std::vector<wire::Json> read(std::uint64_t first, std::uint64_t last) {
    std::vector<wire::Json> found;
    const Status status = file_.read(first, last, [&](std::uint64_t, std::string_view line) {
      if (auto report = wire::parse_json(line); report.ok() && is_report(*report))
        found.push_back(std::move(report).value());
      else
        note_loss({Code::io_error, "the file of older reports was changed"});
    });
    if (!status.ok()) note_loss(status);
    return found;
  }

  // Any thread.
  void note_loss(const Status& why) {
    const std::lock_guard lock(mutex_);
    if (loss_ == why.message()) return;  // already logged
    loss_ = why.message();
    spdlog::warn("older step reports of scene '{}' are lost: {}", scene_, loss_);
  }
  std::string loss() const {
    const std::lock_guard lock(mutex_);
    return loss_;
  }

 private:
  std::string scene_;
  ReportFile file_;
  mutable std::mutex mutex_;
  std::string loss_;
};

HistoryMemory::HistoryMemory(std::size_t keep, std::string directory) : keep_(keep), directory_(std::move(directory)) {
  if (!directory_.empty()) thread_.emplace(kOnTheirWayBytesMax);
}

void HistoryMemory::make_room(const History* newest) {
  const auto spare = [newest](const History* one) { return one->recent_.size() - (one == newest ? 1 : 0); };
  while (held_ > keep_) {
    History* longest = *std::ranges::max_element(histories_, {}, spare);
    longest->spill(std::clamp<std::size_t>(longest->recent_.size() / 8, 1, kSpillMax));
  }
}

History::History(HistoryMemory& memory, std::string scene)
    : memory_(memory), older_(std::make_shared<Older>(std::move(scene), memory.directory_)) {
  memory_.histories_.insert(this);
}

History::~History() {
  memory_.histories_.erase(this);
  memory_.held_ -= recent_.size();
  // The end of the file takes the disk as well.
  if (memory_.thread_) memory_.thread_->post_surely([file = std::move(older_)] {});
}

void History::add(StepReport report) {
  recent_.push_back(std::move(report));
  ++total_;
  ++memory_.held_;
  memory_.make_room(this);
}

void History::spill(std::size_t count) {
  std::vector<std::string> lines;
  std::uint64_t bytes = 0;
  lines.reserve(count);
  for (std::size_t k = 0; k < count; ++k) {
    lines.push_back(wire::dump_json(to_json(recent_[k])) + "\n");
    bytes += lines.back().size();
  }
  Status posted(Code::io_error, "the service has no directory for them");
  if (memory_.thread_)
    posted = memory_.thread_->post(
        [older = older_, first = total_ - recent_.size(), lines = std::move(lines)] { older->append(first, lines); },
        {}, bytes);
  if (!posted.ok()) older_->note_loss(posted);
  recent_.erase(recent_.begin(), recent_.begin() + static_cast<std::ptrdiff_t>(count));
  memory_.held_ -= count;
}

FoundReports History::newest(std::uint64_t first, std::uint64_t last) const {
  RCB_CHECK(last <= total_, "reports that there are");
  const std::uint64_t recent = total_ - recent_.size();
  FoundReports found;
  for (std::uint64_t number = std::max(first, recent); number < last; ++number)
    found.reports.push_back(to_json(recent_[static_cast<std::size_t>(number - recent)]));
  found.loss = older_->loss();
  return found;
}

History::Reading History::reading(std::uint64_t first, std::uint64_t last) const {
  auto found = std::make_shared<FoundReports>(newest(first, last));
  const std::uint64_t upto = std::min(last, total_ - recent_.size());
  return [older = older_, thread = memory_.thread(), first, upto, found](auto take, auto then) -> Status {
    const auto read = [older, first, upto, found, take] {
      FoundReports all;
      if (first < upto) all.reports = older->read(first, upto);
      std::move(found->reports.begin(), found->reports.end(), std::back_inserter(all.reports));
      all.loss = older->loss();
      take(std::move(all));
    };
    if (thread != nullptr) return thread->post(read, std::move(then));
    take(std::move(*found));  // what isn't in memory is lost
    then();
    return {};
  };
}

}  // namespace rcb::scene
