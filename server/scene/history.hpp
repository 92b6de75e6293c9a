// History: the step reports of a scene, numbered from 0 in the order of the steps; on rank 0 only. The newest reports
// of all scenes together are kept in memory, up to a limit; older ones go to a file in the data directory.
//
// Invariants
// 1. The reports [total() - recent, total()) are in memory. Older ones that the file could not take (in time) or give
//    back are lost; a disk's fault has no other consequence.
// 2. All histories that share a HistoryMemory together have at most `keep` reports in memory, and kOnTheirWayBytesMax
//    bytes of those that the disk hasn't taken yet.
// 3. Files are touched on the HistoryMemory's own thread alone, so that no engine waits for a disk.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/files/side_thread.hpp"
#include "server/scene/report.hpp"
#include "server/scene/report_file.hpp"

namespace rcb::scene {

class History;

inline constexpr std::uint64_t kOnTheirWayBytesMax = std::uint64_t{8} << 20U;

// The memory shared by the histories of all scenes.
class HistoryMemory {
 public:
  // keep: at least 1. directory: for older reports (make_report_directory); empty: they are lost.
  HistoryMemory(std::size_t keep, std::string directory);
  HistoryMemory(const HistoryMemory&) = delete;
  HistoryMemory& operator=(const HistoryMemory&) = delete;

  std::size_t held() const { return held_; }  // reports in memory
  // That of the files; null if there is no directory.
  SideThread* thread() { return thread_ ? &*thread_ : nullptr; }

 private:
  friend class History;
  // Makes the longest histories move their oldest reports to their files until at most `keep` are in memory. `newest`
  // keeps its last report.
  void make_room(const History* newest);

  std::size_t keep_;
  std::string directory_;
  std::size_t held_ = 0;
  std::set<History*> histories_;
  std::optional<SideThread> thread_;  // of the files
};

// What was found of the reports that were asked for.
struct FoundReports {
  std::vector<wire::Json> reports;  // ascending
  std::string loss;                 // why reports were lost most recently; empty: none were
};

class History {
 public:
  // The memory must outlive it.
  History(HistoryMemory& memory, std::string scene);
  ~History();
  History(const History&) = delete;
  History& operator=(const History&) = delete;

  void add(StepReport report);
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
  Reading reading(std::uint64_t first, std::uint64_t last) const;

 private:
  friend class HistoryMemory;
  class Older;
  void spill(std::size_t count);

  HistoryMemory& memory_;
  std::shared_ptr<Older> older_;
  std::deque<StepReport> recent_;
  std::uint64_t total_ = 0;
};

}  // namespace rcb::scene
