// Key: the total order behind a cut. A particle's key at a node is its coordinates in the node's axis order,
// then its id, compared lexicographically; -0.0 equals 0.0. A component of the key, a coordinate or the id, is also
// called a key word.
#pragma once

#include <limits>

#include "common/geometry/axes.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

using geometry::AxisOrder;
using geometry::Point;
using particles::Id;

struct Key {
  Point at{};  // coordinates in the node's axis order (at[0] lies on the cut axis); entries >= dims are 0
  Id id = 0;

  bool operator==(const Key&) const = default;
};

// The key of a particle under `axes`. Negative zeros come out as 0.0.
inline Key key_of(const Point& position, Id id, const AxisOrder& axes, int dims) {
  Key key;
  for (std::size_t i = 0; i < key.at.size(); ++i)  // of known length: so the key stays in registers
    key.at[i] = i < static_cast<std::size_t>(dims) ? position[static_cast<std::size_t>(axes[i])] + 0.0 : 0.0;
  key.id = id;
  return key;
}

// Entries past `dims` are 0 on both sides, so all three may be compared.
inline bool operator<(const Key& a, const Key& b) {
  for (std::size_t i = 0; i < geometry::kDimsMax; ++i) {
    if (a.at[i] < b.at[i]) return true;
    if (a.at[i] > b.at[i]) return false;
  }
  return a.id < b.id;
}

// The least key with this first coordinate: for a cut between particles, where it is no particle's own key.
inline Key key_between(double first, int dims) {
  Key key;
  key.at[0] = first + 0.0;
  for (std::size_t i = 1; i < static_cast<std::size_t>(dims); ++i) key.at[i] = std::numeric_limits<double>::lowest();
  return key;
}

}  // namespace rcb::cuts
