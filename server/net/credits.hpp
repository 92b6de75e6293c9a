// Credits: how far the slowest rank is behind the orders that rank 0 has sent, so that no queue of a rank overflows,
// however long that rank is held up.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::net {

class Credits {
 public:
  // others: the ranks besides rank 0. At most so many orders, and (but for a single one) bytes of requests, are sent
  // and not yet executed.
  Credits(int others, std::uint64_t orders_max, std::uint64_t bytes_max)
      : executed_(static_cast<std::size_t>(others), 0), orders_max_(orders_max), bytes_max_(bytes_max) {}

  bool room(std::uint64_t bytes) const {
    if (executed_.empty() || sizes_.empty()) return true;
    return sizes_.size() < orders_max_ && bytes_ + bytes <= bytes_max_;
  }
  void sent(std::uint64_t bytes) {
    if (executed_.empty()) return;
    sizes_.push_back(bytes);
    bytes_ += bytes;
  }
  // rank (from 1) has executed so many orders in all. What is not above its last word, or was never sent, is ignored.
  void executed(int rank, std::uint64_t orders) {
    std::uint64_t& of_rank = executed_[static_cast<std::size_t>(rank - 1)];
    of_rank = std::max(of_rank, std::min(orders, everywhere_ + sizes_.size()));
    const std::uint64_t everywhere = *std::min_element(executed_.begin(), executed_.end());
    for (; everywhere_ < everywhere; ++everywhere_) {
      bytes_ -= sizes_.front();
      sizes_.pop_front();
    }
  }

 private:
  std::vector<std::uint64_t> executed_;  // by rank, from rank 1
  std::uint64_t everywhere_ = 0;         // orders that every rank has executed
  std::deque<std::uint64_t> sizes_;      // of the orders after those
  std::uint64_t bytes_ = 0;              // their sum
  std::uint64_t orders_max_;
  std::uint64_t bytes_max_;
};

}  // namespace rcb::net
