// Tally: the counts of one step by the seats of a scene, which are the processes of its solver, until all are there.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "server/scene/count.hpp"

namespace rcb::scene {

class Tally {
 public:
  explicit Tally(std::size_t seats) : records_(seats) {}

  // In place of what the seat has brought before, if anything.
  void put(std::size_t seat, CountRecord record) {
    if (!has(seat)) ++have_;
    records_[seat] = std::move(record);
  }
  bool has(std::size_t seat) const { return records_.at(seat).has_value(); }
  bool whole() const { return have_ == records_.size(); }
  // The counts of all seats together. Where they weigh in different scales, `weights->scale` is one that isn't due
  // (scale_due), and the loads mean nothing. Where they were counted by different cuts, `epoch` is 0, that of none.
  // scene_parts: seat k of M has those from floor(k scene_parts / M) on, up to the next seat's; `strangers` are in
  // others. Errors: invalid_argument, naming the seat.
  Result<CountRecord> sum(int scene_parts) const;

 private:
  std::vector<std::optional<CountRecord>> records_;  // by seat
  std::size_t have_ = 0;
};

}  // namespace rcb::scene
