// IdSum tells two sets of ids apart, whatever their order: their number and the sum of a hash of each.
#pragma once

#include <cstdint>
#include <span>

#include "common/base/random.hpp"

namespace rcb::client {

class IdSum {
 public:
  explicit IdSum(std::span<const std::int64_t> ids) {
    for (const std::int64_t id : ids) add(id);
  }
  void add(std::int64_t id) {
    ++count_;
    sum_ += mix64(static_cast<std::uint64_t>(id));
  }
  void take(std::int64_t id) {
    --count_;
    sum_ -= mix64(static_cast<std::uint64_t>(id));
  }
  bool operator==(const IdSum&) const = default;

 private:
  std::uint64_t count_ = 0;
  std::uint64_t sum_ = 0;
};

}  // namespace rcb::client
