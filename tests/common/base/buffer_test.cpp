#include "common/base/buffer.hpp"

#include <cstdint>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb {
namespace {

std::vector<int> listed(const Buffer<int>& buffer) { return {buffer.begin(), buffer.end()}; }

TEST(Buffer, IsWhatAVectorWouldBe) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    Buffer<int> buffer;
    std::vector<int> model;
    for (int step = 0; step < 300; ++step) {
      const int value = static_cast<int>(random.below(1000));
      switch (random.below(6)) {
        case 0: {
          const std::size_t size = random.below(200);
          const std::size_t old = buffer.size();
          buffer.resize(size);
          for (std::size_t i = old; i < size; ++i) buffer[i] = value;
          model.resize(size, value);
          break;
        }
        case 1: {
          std::vector<int> more(random.below(50));
          std::iota(more.begin(), more.end(), value);
          buffer.append(more);
          model.insert(model.end(), more.begin(), more.end());
          break;
        }
        case 2: {
          Buffer<int> copy(buffer);
          EXPECT_TRUE(copy.empty() || copy.data() != buffer.data());
          buffer = std::move(copy);
          break;
        }
        case 3: {
          Buffer<int> other;
          other.push_back(1);
          other = buffer;
          buffer.swap(other);
          break;
        }
        default:
          buffer.push_back(value);
          model.push_back(value);
      }
      ASSERT_EQ(listed(buffer), model);
      ASSERT_GE(buffer.capacity(), buffer.size());
    }
  }
}

TEST(Buffer, KeepsItsMemoryUntilReleased) {
  Buffer<double> buffer(100);
  const double* data = buffer.data();
  buffer.clear();
  buffer.resize(100);
  EXPECT_EQ(buffer.data(), data);
  buffer.release();
  EXPECT_EQ(buffer.capacity(), 0U);
  EXPECT_EQ(buffer.data(), nullptr);
}

TEST(Buffer, MovedFromIsEmpty) {
  Buffer<int> a(3);
  const Buffer<int> b(std::move(a));
  EXPECT_EQ(b.size(), 3U);
  EXPECT_TRUE(a.empty());  // NOLINT(bugprone-use-after-move): that is the promise
  Buffer<int>& alias = a;
  a = alias;
  EXPECT_TRUE(a.empty());
}

TEST(Buffer, RefusesWhatNoMemoryHolds) {
  Buffer<std::uint64_t> buffer(2);
  buffer[0] = 5;
  EXPECT_FALSE(buffer.try_reserve(static_cast<std::size_t>(-1) / 8 + 1));  // the product would wrap
#ifndef __SANITIZE_ADDRESS__  // which ends the process instead of returning null
  EXPECT_FALSE(buffer.try_reserve(std::size_t{1} << 58U));
#endif
  EXPECT_EQ(buffer.size(), 2U);
  EXPECT_EQ(buffer[0], 5U);
  EXPECT_TRUE(buffer.try_reserve(0));
}

}  // namespace
}  // namespace rcb
