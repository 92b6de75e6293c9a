// Credits: limits how far the slowest rank may fall behind the orders that rank 0 has sent, so that no rank's queue
// overflows, however long the rank is held up.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <vector>

#include "common/base/status.hpp"

namespace rcb::net {

class Credits {
 public:
  // others: the number of ranks besides rank 0. At most `orders_max` orders are sent and not yet executed everywhere,
  // and their requests have at most `bytes_max` bytes together (a single larger one may go alone).
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
  // Rank `rank` (from 1) reports the total of orders it has executed. A report that isn't above its last one changes
  // nothing, and more than were sent can't count.
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
  std::vector<std::uint64_t> executed_;  // total by rank; [0] is rank 1
  std::uint64_t everywhere_ = 0;         // orders that every rank has executed
  std::deque<std::uint64_t> sizes_;      // request sizes of the sent orders that some rank hasn't executed
  std::uint64_t bytes_ = 0;              // sum of `sizes_`
  std::uint64_t orders_max_;
  std::uint64_t bytes_max_;
};

}  // namespace rcb::net
