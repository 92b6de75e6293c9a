// NoSkip: what a service does although no step needs it, so that what the skip saves can be measured. Its results are
// dropped: no answer depends on it.
#pragma once

#include <string>

#include "common/base/status.hpp"

namespace rcb::service {

struct NoSkip {
  bool exchange = false;  // leavers are exchanged where there are none, too
  bool search = false;    // cuts are searched at every step
  bool warm = false;      // a search looks at all particles, not only at those near the cuts in force

  // names: "exchange", "search", "warm", with commas between; empty: none. Errors: usage.
  static Result<NoSkip> parse(const std::string& names);
};

}  // namespace rcb::service
