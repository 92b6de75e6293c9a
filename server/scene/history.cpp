#include "server/scene/history.hpp"

#include <algorithm>
#include <iterator>
#include <memory>
#include <utility>

#include <spdlog/spdlog.h>

namespace rcb::scene {
namespace {

// Most reports forgotten at a time, so that a step is not delayed.
constexpr std::size_t kForgottenMax = 128;

}  // namespace

void HistoryMemory::make_room(const History* newest) {
  const auto spare = [newest](const History* one) { return one->recent_.size() - (one == newest ? 1 : 0); };
  while (held_ > keep_) {
    auto& reports = (*std::ranges::max_element(histories_, {}, spare))->recent_;
    const std::size_t count = std::clamp<std::size_t>(reports.size() / 8, 1, kForgottenMax);
    reports.erase(reports.begin(), reports.begin() + static_cast<std::ptrdiff_t>(count));
    held_ -= count;
  }
}

History::History(HistoryMemory& memory, std::string scene, std::uint64_t total, std::string loss)
    : memory_(memory), scene_(std::move(scene)), total_(total), loss_(std::move(loss)) {
  memory_.histories_.insert(this);
}

History::~History() {
  memory_.histories_.erase(this);
  memory_.held_ -= recent_.size();
}

void History::note_loss(const std::string& why) {
  if (std::exchange(loss_, why) != why) spdlog::warn("older step reports of scene '{}' will be lost: {}", scene_, why);
}

void History::add(StepReport report, std::string_view json, Journal* journal) {
  if (journal == nullptr && loss_.empty())
    loss_ = "the service has no data directory for them";
  else if (const Status kept = journal ? journal->append(total_, json) : Status(); !kept.ok())
    note_loss(kept.message());
  recent_.push_back(std::move(report));
  ++total_;
  ++memory_.held_;
  memory_.make_room(this);
}

FoundReports History::newest(std::uint64_t first, std::uint64_t last) const {
  RCB_CHECK(last <= total_, "reports that there are");
  const std::uint64_t recent = total_ - recent_.size();
  FoundReports found;
  for (std::uint64_t number = std::max(first, recent); number < last; ++number)
    found.reports.push_back(to_json(recent_[static_cast<std::size_t>(number - recent)]));
  found.loss = loss_;
  return found;
}

History::Reading History::reading(std::uint64_t first, std::uint64_t last, const Journal* journal) const {
  auto found = std::make_shared<FoundReports>(newest(first, last));
  const std::uint64_t upto = std::min(last, total_ - recent_.size());
  std::shared_ptr<JournalReports> reader;
  if (journal != nullptr) reader = std::make_shared<JournalReports>(journal->reader());
  return [reader, storage = memory_.storage_, thread = &memory_.thread_, first, upto, found](auto take,
                                                                                             auto then) -> Status {
    const auto read = [reader, storage, first, upto, found, take] {
      FoundReports all;
      all.loss = found->loss;
      const auto keep = [&all](std::uint64_t, std::string_view text) {
        if (auto report = wire::parse_json(text); report.ok()) all.reports.push_back(std::move(*report));
      };
      if (reader && first < upto)
        if (const Status status = reader->read(first, upto, keep); !status.ok()) all.loss = status.message();
      std::move(found->reports.begin(), found->reports.end(), std::back_inserter(all.reports));
      take(std::move(all));
    };
    return thread->post(read, std::move(then));
  };
}

}  // namespace rcb::scene
