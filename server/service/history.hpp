// History: the step reports of a scene, numbered from 0 in the order of the steps. Rank 0's alone. Of all scenes
// together the newest are in memory, so many as the service was told; older ones go to a file of the data directory.
//
// Invariants
// 1. The reports [total() - recent, total()) are in memory. Of the older ones those are lost that the file could not
//    take or give back; nothing else comes of a disk's fault.
// 2. All histories of a room together have at most `keep` reports in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <set>
#include <string>

#include "server/service/report.hpp"
#include "server/service/report_file.hpp"

namespace rcb::service {

class History;

// The memory that the histories of all scenes share.
class HistoryRoom {
 public:
  // directory: for the older ones (make_report_directory); empty: they are lost.
  HistoryRoom(std::size_t keep, std::string directory) : keep_(keep), directory_(std::move(directory)) {}
  HistoryRoom(const HistoryRoom&) = delete;
  HistoryRoom& operator=(const HistoryRoom&) = delete;

  std::size_t held() const { return held_; }  // reports in memory

 private:
  friend class History;
  // Lets the longest histories move their oldest reports to their files until there is room.
  void make_room();

  std::size_t keep_;
  std::string directory_;
  std::size_t held_ = 0;
  std::set<History*> histories_;
};

class History {
 public:
  // The room must outlive it.
  History(HistoryRoom& room, std::string scene);
  ~History();
  History(const History&) = delete;
  History& operator=(const History&) = delete;

  void add(StepReport report);
  std::uint64_t total() const { return total_; }
  // Why reports were lost, the last time that some were; empty: none were.
  const std::string& loss() const { return loss_; }
  // Those of the reports [first, last) that are there, ascending, last <= total().
  void read(std::uint64_t first, std::uint64_t last, const std::function<void(wire::Json report)>& take);

 private:
  friend class HistoryRoom;
  void spill(std::size_t count);
  void note_loss(const Status& why);

  HistoryRoom& room_;
  std::string scene_;
  ReportFile file_;
  std::deque<StepReport> recent_;
  std::uint64_t total_ = 0;
  std::string loss_;
};

}  // namespace rcb::service
