// NoSkip: work that a service does although no step needs it, to measure what skipping it saves. The results are
// dropped: no answer depends on them.
#pragma once

#include <string>

#include "common/base/status.hpp"

namespace rcb::service {

struct NoSkip {
  bool exchange = false;     // an exchange takes place even if there are no exports
  bool search = false;       // cuts are searched at every step
  bool full_search = false;  // a search looks at all particles, not only at those near the cuts in force ("warm")

  // names: "exchange", "search" and "warm", separated by commas; may be empty.
  // Errors: usage.
  static Result<NoSkip> parse(const std::string& names);
};

}  // namespace rcb::service
