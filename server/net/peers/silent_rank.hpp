// What the control side is told about silent ranks.
#pragma once

namespace rcb::net {

// A rank that has missed more than two heartbeats, and for how long it has been silent.
struct SilentRank {
  int rank;
  double seconds;
};

}  // namespace rcb::net
