// History: the step reports of a scene, numbered from 0 in the order of the steps. The newest reports of all scenes
// together are kept in memory, up to a limit; the others are read from the scene's journal.
//
// Invariants
// 1. The reports [total() - recent, total()) are in memory. Older ones that the journal could not take or give back are
//    lost; a disk's fault has no other consequence.
// 2. All histories that share a HistoryMemory together have at most `keep` reports in memory.
// 3. Reports are read on the HistoryMemory's own thread alone, so that nobody waits for a disk.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "common/files/side_thread.hpp"
#include "server/scene/journal.hpp"
#include "server/scene/report.hpp"

namespace rcb::scene {

class History;

// The memory shared by the histories of all scenes.
class HistoryMemory {
 public:
  // keep: at least 1. storage: what journals read from; a read that hangs may keep it beyond this object.
  explicit HistoryMemory(std::size_t keep, std::shared_ptr<const Storage> storage = nullptr)
      : keep_(keep), storage_(std::move(storage)), thread_(kReadBytesMax) {}
  HistoryMemory(const HistoryMemory&) = delete;
  HistoryMemory& operator=(const HistoryMemory&) = delete;

  std::size_t held() const { return held_; }  // reports in memory
  // On the thread for files, where a disk that stands still holds up nobody.
  void run_beside(SideThread::Job job) { thread_.post_surely(std::move(job)); }

 private:
  friend class History;
  static constexpr std::uint64_t kReadBytesMax = std::uint64_t{8} << 20U;
  // Lets the longest histories forget their oldest reports until at most `keep` are in memory. `newest` keeps its last
  // report.
  void make_room(const History* newest);

  std::size_t keep_;
  std::size_t held_ = 0;
  std::set<History*> histories_;
  std::shared_ptr<const Storage> storage_;
  SideThread thread_;
};

// What was found of the reports that were asked for.
struct FoundReports {
  std::vector<wire::Json> reports;  // ascending
  std::string loss;                 // why reports were lost most recently; empty: none were
};

class History {
 public:
  // The memory must outlive it. total: reports of an earlier service, which are in the journal but for a loss.
  History(HistoryMemory& memory, std::string scene, std::uint64_t total = 0, std::string loss = {});
  ~History();
  History(const History&) = delete;
  History& operator=(const History&) = delete;

  // journal: null where nothing lasts. json: the report as it is told to clients.
  void add(StepReport report, std::string_view json, Journal* journal);
  const StepReport& last() const { return recent_.back(); }  // just added
  std::uint64_t total() const { return total_; }
  // Whether none of the reports from this one on has left the memory.
  bool in_memory(std::uint64_t first) const { return first >= total_ - recent_.size(); }
  // Those of the reports [first, last) that are in memory; last <= total().
  FoundReports newest(std::uint64_t first, std::uint64_t last) const;
  // Reads reports on the thread for files, where it gives those that aren't lost to `take`; `then` is called
  // afterwards, as SideThread::post() does. Errors: those of SideThread::post(); then neither is called.
  using Reading = std::function<Status(std::function<void(FoundReports found)> take, SideThread::Job then)>;
  // To read the reports [first, last) of this moment, at once or later, while the memory is still there; last is at
  // most total().
  Reading reading(std::uint64_t first, std::uint64_t last, const Journal* journal) const;

 private:
  friend class HistoryMemory;
  void note_loss(const std::string& why);

  HistoryMemory& memory_;
  std::string scene_;
  std::deque<StepReport> recent_;
  std::uint64_t total_ = 0;
  std::string loss_;
};

}  // namespace rcb::scene
