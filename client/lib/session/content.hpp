// Content: a checksum of what a push brings. A step whose answer did not come may have been committed; by this it is
// told whether the caller pushes the same once more, or something else.
#pragma once

#include <cstdint>
#include <span>

#include "client/lib/client.hpp"
#include "common/wire/frame.hpp"

namespace rcb::client {

class Content {
 public:
  void add(const Positions& positions);
  template <typename T>
  void add(std::span<const T> values) {
    add(static_cast<std::uint64_t>(values.size()));
    sum_.add(std::as_bytes(values));
  }
  void add(std::uint64_t value) { sum_.add(std::as_bytes(std::span(&value, 1))); }
  std::uint64_t value() const { return sum_.value(); }

 private:
  wire::BulkChecksum sum_;
};

}  // namespace rcb::client
