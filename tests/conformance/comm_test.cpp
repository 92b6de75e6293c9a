// One suite for every Comm: SelfComm, threads, MPI, and MPI in small pieces.
#include "common/comm/comm.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>
#include <thread>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "common/comm/tree.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::partition {
namespace {

void on_every_comm(const std::function<void(comm::Comm&)>& body) {
  testing::SelfComm self;
  body(self);
  testing::on_every_comm(body);
}

constexpr std::uint64_t kMax = std::numeric_limits<std::uint64_t>::max();

// Sizes are uneven and some are 0.
std::size_t share_size(int rank, int round) { return static_cast<std::size_t>((rank * 5 + round * 3) % 7) * 13; }

std::vector<std::byte> bytes_of(std::uint64_t seed, std::size_t size) {
  Random random(mix64(seed));
  std::vector<std::byte> bytes(size);
  for (std::byte& byte : bytes) byte = static_cast<std::byte>(random.next());
  return bytes;
}

std::uint64_t seed_of(int from, int to, int round) {
  return static_cast<std::uint64_t>((round * 100 + from) * 100 + to);
}

TEST(Comm, RankAndSize) {
  on_every_comm([](comm::Comm& comm) {
    EXPECT_GE(comm.rank(), 0);
    EXPECT_LT(comm.rank(), comm.size());
    comm.barrier();
  });
}

TEST(Comm, ReducesSumsMinimaMaxima) {
  on_every_comm([](comm::Comm& comm) {
    const auto rank = static_cast<std::uint64_t>(comm.rank());
    const auto ranks = static_cast<std::uint64_t>(comm.size());
    for (const std::size_t count : {0U, 1U, 3U, 4096U, 10001U}) {
      std::vector<std::uint64_t> sum(count);
      std::vector<std::uint64_t> least(count);
      std::vector<std::uint64_t> most(count);
      for (std::size_t i = 0; i < count; ++i) {
        sum[i] = i + rank;
        least[i] = kMax - (rank + i) % ranks;
        most[i] = (rank + i) % ranks + 10;
      }
      comm.all_sum(sum);
      comm.all_min(least);
      comm.all_max(most);
      for (std::size_t i = 0; i < count; ++i) {
        ASSERT_EQ(sum[i], i * ranks + ranks * (ranks - 1) / 2);
        ASSERT_EQ(least[i], kMax - (ranks - 1));
        ASSERT_EQ(most[i], ranks + 9);
      }
    }
  });
}

TEST(Comm, SumsWrap) {
  on_every_comm([](comm::Comm& comm) {
    std::vector<std::uint64_t> values{kMax};
    comm.all_sum(values);
    EXPECT_EQ(values[0], std::uint64_t{0} - static_cast<std::uint64_t>(comm.size()));
  });
}

void expect_gathered(comm::Comm& comm, int round, const Buffer<std::byte>& all, const std::vector<std::size_t>& sizes) {
  std::vector<std::byte> expected;
  ASSERT_EQ(sizes.size(), static_cast<std::size_t>(comm.size()));
  for (int r = 0; r < comm.size(); ++r) {
    const std::vector<std::byte> bytes = bytes_of(seed_of(r, 0, round), share_size(r, round));
    EXPECT_EQ(sizes[static_cast<std::size_t>(r)], bytes.size());
    expected.insert(expected.end(), bytes.begin(), bytes.end());
  }
  EXPECT_EQ(std::vector(all.begin(), all.end()), expected);
}

TEST(Comm, GathersUnevenAndEmptyShares) {
  on_every_comm([](comm::Comm& comm) {
    Buffer<std::byte> all(3);  // what is there before must not stay
    std::vector<std::size_t> sizes(9);
    for (int round = 0; round < 7; ++round) {
      const std::vector<std::byte> mine = bytes_of(seed_of(comm.rank(), 0, round), share_size(comm.rank(), round));
      comm.all_gather(mine, all, sizes);
      expect_gathered(comm, round, all, sizes);
      const int root = round % comm.size();
      comm.gather(mine, root, all, sizes);
      if (comm.rank() == root) {
        expect_gathered(comm, round, all, sizes);
      } else {
        EXPECT_TRUE(all.empty());
        EXPECT_TRUE(sizes.empty());
      }
    }
    comm.all_gather({}, all, sizes);
    EXPECT_TRUE(all.empty());
    EXPECT_EQ(sizes, std::vector<std::size_t>(static_cast<std::size_t>(comm.size()), 0));
  });
}

// More than fits into one message or into the memory that ranks share, and on one rank only, on all, or on none.
TEST(Comm, GathersMuch) {
  on_every_comm([](comm::Comm& comm) {
    constexpr std::size_t kMuch = (std::size_t{32} << 10U) - 8;
    Buffer<std::byte> all;
    std::vector<std::size_t> sizes;
    for (const std::size_t size :
         {kMuch - 1, kMuch, kMuch + 1, 2 * kMuch, std::size_t{100'001}, std::size_t{1'200'001}})
      for (int much = 0; much <= comm.size(); ++much) {  // on the ranks before it
        const auto bytes = [&](int r) { return bytes_of(seed_of(r, much, 1), r < much ? size : share_size(r, much)); };
        std::vector<std::byte> expected;
        for (int r = 0; r < comm.size(); ++r) {
          const std::vector<std::byte> theirs = bytes(r);
          expected.insert(expected.end(), theirs.begin(), theirs.end());
        }
        const std::vector<std::byte> mine = bytes(comm.rank());
        comm.all_gather(mine, all, sizes);
        EXPECT_TRUE(std::ranges::equal(all, expected));
        const int root = much % comm.size();
        comm.gather(mine, root, all, sizes);
        EXPECT_TRUE(std::ranges::equal(all, comm.rank() == root ? expected : std::vector<std::byte>()));
      }
  });
}

// Ranks that are late, each in turn, and collectives of all kinds after each other.
TEST(Comm, NobodyOverwritesWhatOthersHaveNotRead) {
  on_every_comm([](comm::Comm& comm) {
    Random random(mix64(static_cast<std::uint64_t>(comm.rank())));
    const auto ranks = static_cast<std::uint64_t>(comm.size());
    Buffer<std::byte> all;
    std::vector<std::size_t> sizes;
    for (int round = 0; round < 200; ++round) {
      if (random.below(4) == 0) std::this_thread::sleep_for(std::chrono::microseconds(random.below(300)));
      const auto number = static_cast<std::uint64_t>(round);
      std::vector<std::uint64_t> values(1 + number % 3, number + static_cast<std::uint64_t>(comm.rank()));
      if (round % 5 < 3) {
        comm.all_sum(values);
        EXPECT_EQ(values.back(), ranks * number + ranks * (ranks - 1) / 2);
      } else if (round % 5 == 3) {
        comm.all_min(values);
        EXPECT_EQ(values.back(), number);
      } else {
        const std::vector<std::byte> mine = bytes_of(seed_of(comm.rank(), 0, round), share_size(comm.rank(), round));
        comm.all_gather(mine, all, sizes);
        expect_gathered(comm, round, all, sizes);
      }
    }
  });
}

TEST(Comm, GathersFewInTheOrderOfTheRanks) {
  on_every_comm([](comm::Comm& comm) {
    Buffer<std::byte> all(3);
    for (int round = 0; round < 7; ++round) {
      std::vector<std::byte> expected;
      for (int r = 0; r < comm.size(); ++r) {
        const std::vector<std::byte> bytes = bytes_of(seed_of(r, 0, round), share_size(r, round));
        expected.insert(expected.end(), bytes.begin(), bytes.end());
      }
      comm.all_gather_few(bytes_of(seed_of(comm.rank(), 0, round), share_size(comm.rank(), round)), all);
      EXPECT_EQ(std::vector(all.begin(), all.end()), expected);
    }
    comm.all_gather_few({}, all);
    EXPECT_TRUE(all.empty());
  });
}

// Every rank once, below its parent, in ascending order, and few messages wait for each other.
TEST(Tree, HoldsEveryRankOnceInFewLevels) {
  for (const int size : {1, 2, 3, 17, 18, 1000, 10'000, 1'000'000})
    for (const int fan_out : {2, 16}) {
      std::vector<int> level(static_cast<std::size_t>(size), 0);
      int last = 0;
      int levels = 0;
      std::uint64_t messages = 0;
      for (int rank = 0; rank < size; ++rank) {
        const comm::TreePlace place = comm::place_in_tree(rank, size, fan_out);
        ASSERT_LE(place.children.size(), static_cast<std::size_t>(fan_out));
        ASSERT_TRUE(std::is_sorted(place.children.begin(), place.children.end()));
        if (!place.children.empty()) {
          ASSERT_EQ(place.children.front(), rank + 1);
        }
        ASSERT_EQ(place.parent < 0, rank == 0);
        for (const int child : place.children) {
          ASSERT_GT(child, rank);
          ASSERT_EQ(comm::place_in_tree(child, size, fan_out).parent, rank);
          level[static_cast<std::size_t>(child)] = level[static_cast<std::size_t>(rank)] + 1;
          last = std::max(last, child);
          ++messages;
        }
        levels = std::max(levels, level[static_cast<std::size_t>(rank)]);
      }
      EXPECT_EQ(messages, static_cast<std::uint64_t>(size) - 1);
      EXPECT_EQ(last, size - 1);
      EXPECT_LE(levels, 1 + std::ceil(std::log(size) / std::log(fan_out)));
    }
}

TEST(Comm, BroadcastsFromAnyRoot) {
  on_every_comm([](comm::Comm& comm) {
    for (int root = 0; root < comm.size(); ++root)
      for (const std::size_t size : {0U, 1U, 1000U}) {
        const std::vector<std::byte> expected = bytes_of(seed_of(root, 1, 0), size);
        std::vector<std::byte> bytes = comm.rank() == root ? expected : std::vector<std::byte>(size);
        comm.broadcast(bytes, root);
        EXPECT_EQ(bytes, expected);
      }
  });
}

TEST(Comm, ExchangesWhatOneRankAloneSends) {
  on_every_comm([](comm::Comm& comm) {
    for (int round = 0; round < 7; ++round) {
      const int root = round % comm.size();
      std::vector<std::vector<std::byte>> pieces;
      for (int r = 0; r < comm.size() && comm.rank() == root; ++r)
        pieces.push_back(bytes_of(seed_of(root, r, round), share_size(r, round)));
      std::vector<std::span<const std::byte>> send(pieces.begin(), pieces.end());
      send.resize(static_cast<std::size_t>(comm.size()));
      std::vector<std::byte> mine(share_size(comm.rank(), round));
      std::vector<std::span<std::byte>> receive(send.size());
      receive[static_cast<std::size_t>(root)] = mine;
      comm.exchange(send, receive);
      EXPECT_EQ(mine, bytes_of(seed_of(root, comm.rank(), round), mine.size()));
    }
  });
}

TEST(Comm, ExchangesEveryPair) {
  on_every_comm([](comm::Comm& comm) {
    for (int round = 0; round < 7; ++round) {
      std::vector<std::vector<std::byte>> out;
      std::vector<std::vector<std::byte>> in;
      for (int r = 0; r < comm.size(); ++r) {
        out.push_back(bytes_of(seed_of(comm.rank(), r, round), share_size(comm.rank() + 2 * r, round)));
        in.emplace_back(share_size(r + 2 * comm.rank(), round));
      }
      const std::vector<std::span<const std::byte>> send(out.begin(), out.end());
      const std::vector<std::span<std::byte>> receive(in.begin(), in.end());
      comm.exchange(send, receive);
      for (int r = 0; r < comm.size(); ++r)
        EXPECT_EQ(in[static_cast<std::size_t>(r)],
                  bytes_of(seed_of(r, comm.rank(), round), share_size(r + 2 * comm.rank(), round)));
    }
  });
}

TEST(Comm, ExchangesCounts) {
  on_every_comm([](comm::Comm& comm) {
    const auto ranks = static_cast<std::size_t>(comm.size());
    std::vector<std::uint64_t> to(ranks);
    std::vector<std::uint64_t> from(ranks);
    for (std::size_t r = 0; r < ranks; ++r) to[r] = static_cast<std::uint64_t>(comm.rank()) * 1000 + r;
    comm::exchange_counts(comm, to, from);
    for (std::size_t r = 0; r < ranks; ++r) EXPECT_EQ(from[r], r * 1000 + static_cast<std::uint64_t>(comm.rank()));
  });
}

TEST(Comm, AgreesOnlyIfAllDo) {
  on_every_comm([](comm::Comm& comm) {
    EXPECT_TRUE(comm::agree(comm, true));
    EXPECT_FALSE(comm::agree(comm, false));
    EXPECT_FALSE(comm::agree(comm, comm.rank() != comm.size() - 1));
  });
}

}  // namespace
}  // namespace rcb::partition
