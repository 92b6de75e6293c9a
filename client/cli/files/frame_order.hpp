// The order of the files of a trajectory.
#pragma once

#include <string>
#include <vector>

namespace rcb::cli {

struct FrameOrder {
  std::vector<std::string> files;
  std::string changed;  // what was put in order, for people; empty: nothing
};

// A shell gives the files that a pattern names in alphabetical order: step.100 before step.20. So files that stand one
// behind the other, differ only in numbers and are in alphabetical order are put in the order of these numbers; a point
// between digits is a decimal one. Files in any other order stay as they are given.
FrameOrder in_frame_order(const std::vector<std::string>& files);

}  // namespace rcb::cli
