#include "common/base/byte_size.hpp"

#include <gtest/gtest.h>

namespace rcb {
namespace {

TEST(MemorySize, UnitsArePowersOf1024) {
  EXPECT_EQ(*read_memory_size("1"), 1U);
  EXPECT_EQ(*read_memory_size("65536b"), 65536U);
  EXPECT_EQ(*read_memory_size("3kb"), 3072U);
  EXPECT_EQ(*read_memory_size("2MiB"), std::uint64_t{2} << 20U);
  EXPECT_EQ(*read_memory_size("1Gb"), std::uint64_t{1} << 30U);
}

TEST(MemorySize, EverythingElseIsRefused) {
  for (const char* text : {"", "-1", "0", "0kb", "1.5gb", "1e3", " 1", "1 mb", "gb", "12xb", "1kk", "99999tb", "16eb",
                           "18446744073709551615", "18446744073709551616", "17179869184gb", "1e30"})
    EXPECT_EQ(read_memory_size(text).status().code(), Code::invalid_argument) << text;
}

}  // namespace
}  // namespace rcb
