// The changes of all ranks on rank 0: all of them, once, in ascending id, and in windows that keep their size.
#include "server/service/step/gather_changes.hpp"

#include <algorithm>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/support/forwarding_comm.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using namespace service;

// Notes how many changes came in the largest gather, and how many gathers there were.
class NotingComm final : public ForwardingComm {
 public:
  using ForwardingComm::ForwardingComm;
  void gather(std::span<const std::byte> local, int root, Buffer<std::byte>& all,
              std::vector<std::size_t>& sizes) override {
    comm_.gather(local, root, all, sizes);
    most = std::max<std::uint64_t>(most, all.size() / 12);
    ++gathers;
  }
  std::uint64_t most = 0;
  std::uint64_t gathers = 0;
};

// How ids lie on ranks.
enum class Deal { mixed, blocks, one_rank };

std::uint64_t id_of(std::uint64_t k) { return k * k + 5 * k; }  // ever further apart
std::int32_t part_of(std::uint64_t k) { return static_cast<std::int32_t>(mix64(k) % 1000); }

PartChanges deal(const comm::Comm& comm, std::uint64_t count, Deal how, bool ascending) {
  PartChanges local;
  const auto ranks = static_cast<std::uint64_t>(comm.size());
  for (std::uint64_t i = 0; i < count; ++i) {
    const std::uint64_t k = ascending ? i : count - 1 - i;
    const std::uint64_t rank = how == Deal::mixed ? mix64(k + 7) % ranks : how == Deal::blocks ? k * ranks / count : 0;
    if (rank != static_cast<std::uint64_t>(comm.rank())) continue;
    local.id.push_back(static_cast<particles::Id>(id_of(k)));
    local.part.push_back(part_of(k));
  }
  return local;
}

TEST(GatherChanges, all_come_once_in_ascending_id_and_no_window_is_larger_than_asked) {
  on_ranks([](comm::Comm& comm) {
    for (const std::uint64_t count : {0U, 1U, 5000U})
      for (const Deal how : {Deal::mixed, Deal::blocks, Deal::one_rank})
        for (const std::uint64_t at_once : {std::uint64_t{1} << 20U, std::uint64_t{1000}, std::uint64_t{100}}) {
          PartChanges local = deal(comm, count, how, at_once == 1000);
          PartChanges all;
          NotingComm noting(comm);
          gather_changes(noting, local, count, all, at_once);
          EXPECT_TRUE(local.id.empty());
          EXPECT_LE(noting.most, at_once);
          EXPECT_LE(noting.gathers, 1 + 4 * count / at_once);
          EXPECT_EQ(all.id.size(), comm.rank() == 0 ? count : 0);
          EXPECT_EQ(all.part.size(), all.id.size());
          std::uint64_t wrong = 0;
          for (std::uint64_t k = 0; k < std::min<std::uint64_t>(all.id.size(), count); ++k)
            wrong += all.id[k] == static_cast<particles::Id>(id_of(k)) && all.part[k] == part_of(k) ? 0U : 1U;
          EXPECT_EQ(wrong, 0U);
        }
  });
}

}  // namespace
}  // namespace rcb::testing
