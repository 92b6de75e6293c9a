// Near names, by distances counted by hand.
#include "common/base/nearest.hpp"

#include <gtest/gtest.h>

namespace rcb {
namespace {

TEST(Nearest, Distances) {
  EXPECT_EQ(edit_distance("", ""), 0U);
  EXPECT_EQ(edit_distance("jet", "jet"), 0U);
  EXPECT_EQ(edit_distance("", "jet"), 3U);
  EXPECT_EQ(edit_distance("jet", ""), 3U);
  EXPECT_EQ(edit_distance("jte", "jet"), 1U) << "neighbours swapped";
  EXPECT_EQ(edit_distance("jeet", "jet"), 1U);
  EXPECT_EQ(edit_distance("jt", "jet"), 1U);
  EXPECT_EQ(edit_distance("jat", "jet"), 1U);
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3U);
}

TEST(Nearest, OnlyWhatMayBeMeant) {
  const std::vector<std::string> scenes{"slope", "jet", "jets", "two_spheres"};
  EXPECT_EQ(names_like("jte", scenes), (std::vector<std::string>{"jet"}));
  EXPECT_EQ(names_like("jett", scenes), (std::vector<std::string>{"jet", "jets"}));
  EXPECT_EQ(names_like("two", scenes), (std::vector<std::string>{"two_spheres"})) << "its beginning";
  EXPECT_EQ(names_like("two_shperes", scenes), (std::vector<std::string>{"two_spheres"}));
  EXPECT_TRUE(names_like("column", scenes).empty());
  EXPECT_TRUE(names_like("", scenes).empty());
  EXPECT_TRUE(names_like("x", {"y"}).empty()) << "another name, not a mistyped one";
  EXPECT_EQ(names_like("slpoe", {"slopes", "slope"}), (std::vector<std::string>{"slope"})) << "2 of 5 are too many";
}

}  // namespace
}  // namespace rcb
