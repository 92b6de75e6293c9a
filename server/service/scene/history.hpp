// History: the step reports of a scene, numbered from 0 in the order of the steps; on rank 0 only. The newest reports
// of all scenes together are kept in memory, up to a limit; older ones go to a file in the data directory.
//
// Invariants
// 1. The reports [total() - recent, total()) are in memory. Older ones that the file could not take or give back are
//    lost; a disk's fault has no other consequence.
// 2. All histories of a room together have at most `keep` reports in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <set>
#include <string>

#include "server/service/scene/report.hpp"
#include "server/service/scene/report_file.hpp"

namespace rcb::service {

class History;

// The memory shared by the histories of all scenes.
class HistoryMemory {
 public:
  // directory: for older reports (make_report_directory); empty: they are lost.
  HistoryMemory(std::size_t keep, std::string directory) : keep_(keep), directory_(std::move(directory)) {}
  HistoryMemory(const HistoryMemory&) = delete;
  HistoryMemory& operator=(const HistoryMemory&) = delete;

  std::size_t held() const { return held_; }  // reports in memory

 private:
  friend class History;
  // Makes the longest histories move their oldest reports to their files until at most `keep` are in memory.
  void make_room();

  std::size_t keep_;
  std::string directory_;
  std::size_t held_ = 0;
  std::set<History*> histories_;
};

class History {
 public:
  // The room must outlive it.
  History(HistoryMemory& room, std::string scene);
  ~History();
  History(const History&) = delete;
  History& operator=(const History&) = delete;

  void add(StepReport report);
  std::uint64_t total() const { return total_; }
  // Why reports were lost most recently; empty if none were.
  const std::string& loss() const { return loss_; }
  // Calls take() for those of the reports [first, last) that are not lost, ascending; last <= total().
  void read(std::uint64_t first, std::uint64_t last, const std::function<void(wire::Json report)>& take);

 private:
  friend class HistoryMemory;
  void spill(std::size_t count);
  void note_loss(const Status& why);

  HistoryMemory& room_;
  std::string scene_;
  ReportFile file_;
  std::deque<StepReport> recent_;
  std::uint64_t total_ = 0;
  std::string loss_;
};

}  // namespace rcb::service
