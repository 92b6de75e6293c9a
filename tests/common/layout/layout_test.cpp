// The plan as the client holds it against a simulated service whose ranks know only their own arrays: after any
// history both list the same ids in the same slots, with the same version and checksum.
#include "common/layout/layout.hpp"

#include <limits>
#include <map>
#include <numeric>
#include <set>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::layout {
namespace {

// The protocol's sentence about free slots, word for word, with no care for cost.
std::vector<Id> naive_edit(std::span<const Id> held, const std::vector<std::uint64_t>& leaving,
                           const std::vector<Id>& arriving) {
  constexpr Id kFree = -1;
  std::vector<Id> now(held.begin(), held.end());
  for (const std::uint64_t slot : leaving) now[slot] = kFree;
  for (const Id id : arriving) {
    const auto hole = std::find(now.begin(), now.end(), kFree);
    if (hole == now.end()) {
      now.push_back(id);
    } else {
      *hole = id;
    }
  }
  const std::size_t count = held.size() - leaving.size() + arriving.size();
  for (std::size_t slot = count; slot < now.size(); ++slot) {
    if (now[slot] != kFree) *std::find(now.begin(), now.end(), kFree) = now[slot];
  }
  now.resize(count);
  return now;
}

// A service of R ranks by the text of PROTOCOL.md; a rank sees its own ids and those that arrive.
class Service {
 public:
  Service(const std::vector<Id>& ids, int ranks) : held_(static_cast<std::size_t>(ranks)), count_(ids.size()) {
    for (int r = 0; r < ranks; ++r) {
      const std::size_t begin = ids.size() * static_cast<std::size_t>(r) / static_cast<std::size_t>(ranks);
      const std::size_t end = ids.size() * static_cast<std::size_t>(r + 1) / static_cast<std::size_t>(ranks);
      held_[static_cast<std::size_t>(r)].assign(std::span(ids).subspan(begin, end - begin));
    }
    for (int r = 0; r < ranks; ++r) checksum_ += checksum_of_rank(r, held_[static_cast<std::size_t>(r)].span());
  }

  void commit(const std::map<Id, std::int32_t>& new_rank, bool first) {
    std::vector<std::vector<std::uint64_t>> leaving(held_.size());
    std::vector<std::vector<Id>> arriving(held_.size());
    std::uint64_t movers = 0;
    for (std::size_t r = 0; r < held_.size(); ++r) {
      for (std::size_t slot = 0; slot < held_[r].size(); ++slot) {
        const auto found = new_rank.find(held_[r][slot]);
        if (found == new_rank.end() || found->second == static_cast<std::int32_t>(r)) continue;
        leaving[r].push_back(slot);
        arriving[static_cast<std::size_t>(found->second)].push_back(found->first);
        ++movers;
      }
    }
    if (movers == 0 && !first) return;
    ++version_;
    const bool full = first || 16 * movers > count_;
    fulls_ += full && !first ? 1 : 0;
    fews_ += full ? 0 : 1;
    for (std::size_t r = 0; r < held_.size(); ++r) {
      const int rank = static_cast<int>(r);
      std::sort(arriving[r].begin(), arriving[r].end());
      if (full) {
        std::vector<Id> now;
        for (std::size_t slot = 0; slot < held_[r].size(); ++slot) {
          if (!std::binary_search(leaving[r].begin(), leaving[r].end(), slot)) now.push_back(held_[r][slot]);
        }
        now.insert(now.end(), arriving[r].begin(), arriving[r].end());
        std::sort(now.begin(), now.end());
        checksum_ += checksum_of_rank(rank, now) - checksum_of_rank(rank, held_[r].span());
        held_[r].assign(now);
      } else {
        const SlotEdit edit = edit_of_rank(held_[r].size(), leaving[r], arriving[r].size());
        checksum_ += checksum_change(edit, rank, held_[r].span(), leaving[r], arriving[r]);
        const std::vector<Id> expected = naive_edit(held_[r].span(), leaving[r], arriving[r]);
        apply_edit<Id>(edit, held_[r], arriving[r]);
        EXPECT_EQ(std::vector<Id>(held_[r].begin(), held_[r].end()), expected);
      }
    }
  }

  // The protocol's words on removals and insertions: those that go leave free slots, those that come arrive.
  void edit(const std::set<Id>& removed, const std::map<Id, std::int32_t>& inserted) {
    if (removed.empty() && inserted.empty()) return;
    ++version_;
    count_ = count_ - removed.size() + inserted.size();
    for (std::size_t r = 0; r < held_.size(); ++r) {
      std::vector<std::uint64_t> leaving;
      std::vector<Id> arriving;
      for (std::size_t slot = 0; slot < held_[r].size(); ++slot)
        if (removed.contains(held_[r][slot])) leaving.push_back(slot);
      for (const auto& [id, rank] : inserted)
        if (rank == static_cast<std::int32_t>(r)) arriving.push_back(id);
      const std::vector<Id> now = naive_edit(held_[r].span(), leaving, arriving);
      const int rank = static_cast<int>(r);
      checksum_ += checksum_of_rank(rank, now) - checksum_of_rank(rank, held_[r].span());
      held_[r].assign(now);
    }
  }

  std::vector<Buffer<Id>> held_;
  std::uint64_t count_;
  std::uint64_t version_ = 0;
  std::uint64_t checksum_ = 0;
  int fulls_ = 0, fews_ = 0;
};

void expect_same(const Layout& plan, const Service& service) {
  ASSERT_EQ(static_cast<std::size_t>(plan.ranks()), service.held_.size());
  EXPECT_EQ(plan.version(), service.version_);
  EXPECT_EQ(plan.checksum(), service.checksum_);
  std::uint64_t scratch = 0;
  for (int r = 0; r < plan.ranks(); ++r) {
    const Buffer<Id>& held = service.held_[static_cast<std::size_t>(r)];
    const auto rows = plan.rows(r);
    ASSERT_EQ(rows.size(), held.size()) << "rank " << r;
    for (std::size_t slot = 0; slot < held.size(); ++slot) {
      ASSERT_EQ(plan.id_of_row(rows[slot]), held[slot]) << "rank " << r << " slot " << slot;
      ASSERT_EQ(plan.rank_of_row(rows[slot]), r);
      scratch += mix64(static_cast<std::uint64_t>(held[slot]) +
                       mix64(static_cast<std::uint64_t>(r) * (std::uint64_t{1} << 40U) + slot));
    }
  }
  EXPECT_EQ(plan.checksum(), scratch);
}

std::vector<Id> some_ids(Random& random, std::size_t count, int kind) {
  std::vector<Id> ids(count);
  std::iota(ids.begin(), ids.end(), 0);
  if (kind == 0) return ids;
  std::set<Id> distinct;
  if (count > 0) distinct.insert(std::numeric_limits<Id>::max());
  while (distinct.size() < count) distinct.insert(static_cast<Id>(random.next() >> (random.below(2) == 0 ? 1U : 40U)));
  ids.assign(distinct.begin(), distinct.end());
  if (kind == 2) {
    for (std::size_t i = count; i > 1; --i) std::swap(ids[i - 1], ids[random.below(i)]);
  }
  return ids;
}

struct Moves {
  std::vector<std::uint64_t> rows;
  std::vector<std::int32_t> ranks;
  std::map<Id, std::int32_t> by_id;
};

// At most `most` distinct rows, in any order; to: -1 for any rank.
Moves some_moves(Random& random, const Layout& plan, std::uint64_t most, std::int32_t to) {
  Moves moves;
  std::set<std::uint64_t> rows;
  for (std::uint64_t i = 0; i < most && plan.count() > 0; ++i) rows.insert(random.below(plan.count()));
  moves.rows.assign(rows.begin(), rows.end());
  for (std::size_t i = moves.rows.size(); i > 1; --i) std::swap(moves.rows[i - 1], moves.rows[random.below(i)]);
  for (const std::uint64_t row : moves.rows) {
    moves.ranks.push_back(to >= 0 ? to
                                  : static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(plan.ranks()))));
    moves.by_id[plan.id_of_row(row)] = moves.ranks.back();
  }
  return moves;
}

TEST(Layout, ClientAndServiceDeriveTheSame) {
  int fulls = 0, fews = 0;
  for (std::uint64_t seed = 1; seed <= 120; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const std::size_t count = random.below(4) == 0 ? random.below(5) : random.below(600);
    const int ranks = 1 + static_cast<int>(random.below(9));
    const std::vector<Id> ids = some_ids(random, count, static_cast<int>(seed % 3));
    Layout plan = Layout::blocks(count, ranks, seed % 3 == 0 && seed % 2 == 0 ? std::span<const Id>{} : std::span(ids));
    Service service(ids, ranks);
    expect_same(plan, service);
    for (int step = 0; step < 25; ++step) {
      const bool first = step == 0;
      const std::uint64_t most = first                  ? count
                                 : random.below(3) == 0 ? random.below(count + 1)
                                                        : random.below(count / 16 + 2);
      const bool to_one = random.below(4) == 0;
      const auto to = to_one ? static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(ranks))) : -1;
      const Moves moves = some_moves(random, plan, most, to);
      ASSERT_TRUE(plan.apply(moves.rows, moves.ranks, first).ok());
      service.commit(moves.by_id, first);
      expect_same(plan, service);
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
    fulls += service.fulls_;
    fews += service.fews_;
    // A client that comes anew learns the whole plan.
    std::vector<std::uint64_t> counts;
    std::vector<Id> slots;
    for (const auto& held : service.held_) {
      counts.push_back(held.size());
      slots.insert(slots.end(), held.begin(), held.end());
    }
    const auto fetched = Layout::full(counts, slots, ids, service.version_);
    ASSERT_TRUE(fetched.ok()) << fetched.status().message();
    expect_same(*fetched, service);
  }
  EXPECT_GT(fulls, 100);
  EXPECT_GT(fews, 100);
}

// Rows as PROTOCOL.md's rule for slots has them.
std::vector<Id> ids_of(const Layout& plan) {
  std::vector<Id> ids;
  for (std::uint64_t row = 0; row < plan.count(); ++row) ids.push_back(plan.id_of_row(row));
  return ids;
}

TEST(Layout, EditsAndChangesOfRankInTurn) {
  for (std::uint64_t seed = 1; seed <= 90; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Random random(seed);
    const std::size_t count = random.below(4) == 0 ? random.below(5) : random.below(300);
    const int ranks = 1 + static_cast<int>(random.below(6));
    const std::vector<Id> ids = some_ids(random, count, static_cast<int>(seed % 3));
    Layout plan = Layout::blocks(count, ranks, ids);
    Service service(ids, ranks);
    for (int step = 0; step < 25; ++step) {
      std::vector<std::uint64_t> removed;
      std::set<Id> removed_ids;
      const std::uint64_t share = 1 + random.below(20);
      for (std::uint64_t row = 0; row < plan.count(); ++row)
        if (random.below(share + 1) == 0 && random.below(2) == 0) {
          removed.push_back(row);
          removed_ids.insert(plan.id_of_row(row));
        }
      std::vector<Id> inserted;
      std::vector<std::int32_t> inserted_ranks;
      std::map<Id, std::int32_t> inserted_rank;
      for (std::uint64_t k = random.below(3) == 0 ? 0 : random.below(20); k > 0; --k) {
        const auto id = random.below(3) == 0 ? static_cast<Id>(plan.count() + inserted.size())
                                             : static_cast<Id>(random.next() >> 1U);
        if (plan.row_of_id(id) || inserted_rank.contains(id)) continue;
        inserted.push_back(id);
        inserted_ranks.push_back(static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(ranks))));
        inserted_rank[id] = inserted_ranks.back();
      }
      const std::vector<Id> rows = naive_edit(ids_of(plan), removed, inserted);
      const auto edited = plan.edit(removed, inserted, inserted_ranks);
      ASSERT_TRUE(edited.ok()) << edited.status().message();
      service.edit(removed_ids, inserted_rank);
      ASSERT_EQ(ids_of(plan), rows);
      expect_same(plan, service);
      for (std::uint64_t row = 0; row < plan.count(); ++row) ASSERT_EQ(plan.row_of_id(rows[row]), row);
      const Moves moves = some_moves(random, plan, random.below(plan.count() / 8 + 2), -1);
      ASSERT_TRUE(plan.apply(moves.rows, moves.ranks, false).ok());
      service.commit(moves.by_id, false);
      expect_same(plan, service);
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
  }
}

TEST(Layout, AnEditThatCannotBeChangesNothing) {
  Layout plan = Layout::blocks(10, 2, {});
  const std::uint64_t before = plan.checksum();
  const auto refuse = [&](std::vector<std::uint64_t> rows, std::vector<Id> ids, std::vector<std::int32_t> ranks) {
    EXPECT_EQ(plan.edit(rows, ids, ranks).status().code(), Code::protocol_error);
    EXPECT_EQ(plan.checksum(), before);
    EXPECT_EQ(plan.count(), 10U);
  };
  refuse({10}, {}, {});
  refuse({3, 3}, {}, {});
  refuse({}, {9}, {0});
  refuse({9}, {9}, {0});
  refuse({}, {12, 12}, {0, 0});
  refuse({}, {12}, {2});
  refuse({}, {12}, {});
}

TEST(Layout, BlocksAreByRowEvenWithoutOrder) {
  const std::vector<Id> ids{70, 10, 90, 5, 30};
  const Layout plan = Layout::blocks(5, 2, ids);
  EXPECT_EQ(std::vector<std::uint64_t>(plan.rows(0).begin(), plan.rows(0).end()), (std::vector<std::uint64_t>{0, 1}));
  EXPECT_EQ(std::vector<std::uint64_t>(plan.rows(1).begin(), plan.rows(1).end()),
            (std::vector<std::uint64_t>{2, 3, 4}));
  EXPECT_EQ(plan.version(), 0U);
}

TEST(Layout, FirstPartitionAlwaysRaisesTheVersionAndSorts) {
  const std::vector<Id> ids{70, 10, 90, 5, 30};
  Layout plan = Layout::blocks(5, 2, ids);
  ASSERT_TRUE(plan.apply({}, {}, true).ok());
  EXPECT_EQ(plan.version(), 1U);
  EXPECT_EQ(std::vector<std::uint64_t>(plan.rows(1).begin(), plan.rows(1).end()),
            (std::vector<std::uint64_t>{3, 4, 2}));
  const std::uint64_t before = plan.checksum();
  ASSERT_TRUE(plan.apply({}, {}, false).ok());
  const std::vector<std::uint64_t> rows{0};
  const std::vector<std::int32_t> stays{0};
  ASSERT_TRUE(plan.apply(rows, stays, false).ok());
  EXPECT_EQ(plan.version(), 1U);
  EXPECT_EQ(plan.checksum(), before);
}

TEST(Layout, NoParticlesAndMoreRanksThanParticles) {
  Layout none = Layout::blocks(0, 3, {});
  EXPECT_EQ(none.checksum(), 0U);
  ASSERT_TRUE(none.apply({}, {}, true).ok());
  EXPECT_EQ(none.version(), 1U);
  const Layout few = Layout::blocks(2, 5, {});
  std::uint64_t total = 0;
  for (int r = 0; r < 5; ++r) total += few.rows(r).size();
  EXPECT_EQ(total, 2U);
  EXPECT_EQ(few.rows(2).size(), 1U);  // [floor(2*2/5), floor(3*2/5)) = [0, 1)
}

TEST(Layout, EverythingMovesToOneRank) {
  Layout plan = Layout::blocks(100, 4, {});
  std::vector<std::uint64_t> rows(100);
  std::iota(rows.begin(), rows.end(), 0U);
  const std::vector<std::int32_t> ranks(100, 2);
  ASSERT_TRUE(plan.apply(rows, ranks, false).ok());
  EXPECT_EQ(plan.rows(2).size(), 100U);
  EXPECT_EQ(plan.rows(0).size(), 0U);
  std::vector<Id> ids(100);
  std::iota(ids.begin(), ids.end(), 0);
  EXPECT_EQ(plan.checksum(), checksum_of_rank(2, ids));
}

TEST(Layout, FullChangeBeginsAboveOneInSixteen) {
  EXPECT_FALSE(is_full_change(2, 32));
  EXPECT_TRUE(is_full_change(3, 32));
  EXPECT_FALSE(is_full_change(1, 16));
  EXPECT_TRUE(is_full_change(1, 15));
  EXPECT_TRUE(is_full_change(2, 31));
  EXPECT_FALSE(is_full_change(0, 0));
  EXPECT_TRUE(is_full_change(std::uint64_t{1} << 63U, std::uint64_t{1} << 48U));
}

TEST(Layout, EditByHand) {
  // Exports 1, 4, 5 of 6, one arrival: it takes slot 1; slots 4 and 5 are both gone and behind the end.
  const std::vector<std::uint64_t> leaving{1, 4, 5};
  SlotEdit edit = edit_of_rank(6, leaving, 1);
  EXPECT_EQ(edit.new_count, 4U);
  ASSERT_EQ(edit.moves.size(), 1U);
  EXPECT_EQ(edit.moves[0].to, 1U);
  EXPECT_TRUE(edit.moves[0].arrival);
  // No arrival and exports 0 and 2 of 5: slots 3 and 4 fill them in order.
  const std::vector<std::uint64_t> holes{0, 2};
  edit = edit_of_rank(5, holes, 0);
  ASSERT_EQ(edit.moves.size(), 2U);
  EXPECT_EQ(edit.moves[0].from, 3U);
  EXPECT_EQ(edit.moves[0].to, 0U);
  EXPECT_EQ(edit.moves[1].from, 4U);
  EXPECT_EQ(edit.moves[1].to, 2U);
  // More arrivals than holes: the rest are appended.
  edit = edit_of_rank(5, holes, 4);
  EXPECT_EQ(edit.new_count, 7U);
  EXPECT_EQ(edit.moves[2].to, 5U);
  EXPECT_EQ(edit.moves[3].to, 6U);
}

TEST(Layout, PartsOfRanks) {
  for (int parts = 1; parts <= 20; ++parts) {
    for (int ranks = 1; ranks <= 20; ++ranks) {
      EXPECT_EQ(part_begin(0, parts, ranks), 0);
      EXPECT_EQ(part_begin(ranks, parts, ranks), parts);
      for (int part = 0; part < parts; ++part) {
        const int rank = rank_of_part(part, parts, ranks);
        EXPECT_LE(part_begin(rank, parts, ranks), part);
        EXPECT_LT(part, part_begin(rank + 1, parts, ranks));
      }
    }
  }
  EXPECT_EQ(rank_of_part(1048575, 1048576, 1000000), 999999);
  EXPECT_EQ(row_begin(999999, std::uint64_t{1} << 60U, 1000000), 1152920351685342369U);
}

TEST(Layout, RefusesWhatCannotBeAndStaysAsItWas) {
  Layout plan = Layout::blocks(64, 4, {});
  const std::uint64_t before = plan.checksum();
  const auto refuse = [&](std::vector<std::uint64_t> rows, std::vector<std::int32_t> ranks) {
    EXPECT_EQ(plan.apply(rows, ranks, false).code(), Code::protocol_error);
    EXPECT_EQ(plan.checksum(), before);
    EXPECT_EQ(plan.version(), 0U);
    EXPECT_EQ(plan.rank_of_row(0), 0);
  };
  refuse({64}, {0});
  refuse({0}, {4});
  refuse({0}, {-1});
  refuse({0, 0}, {1, 2});
  refuse({0, 1, 2, 3, 4, 5, 0}, {1, 1, 1, 1, 1, 1, 2});
  refuse({0}, {});

  const std::vector<Id> ids{4, 2};
  EXPECT_FALSE(Layout::full({1, 1}, std::vector<Id>{4, 4}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({1, 1}, std::vector<Id>{4, 3}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({1, 2}, std::vector<Id>{4, 2}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({1, 0}, std::vector<Id>{4, 2}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({~std::uint64_t{0}, 3}, std::vector<Id>{4, 2}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({3}, std::vector<Id>{0, 1, 2}, ids, 1).ok());
  EXPECT_FALSE(Layout::full({3}, std::vector<Id>{0, 1, 3}, {}, 1).ok());
  EXPECT_FALSE(Layout::full({}, std::vector<Id>{}, {}, 1).ok());
  EXPECT_TRUE(Layout::full({1, 1}, std::vector<Id>{2, 4}, ids, 1).ok());
}

TEST(Layout, ChecksumIsTheOneOfTheProtocol) {
  // Computed from PROTOCOL.md's words by an independent program: ids 7 and 9 on rank 0, id 2^63-1 on rank 3, slot 0.
  const std::vector<Id> two{7, 9};
  EXPECT_EQ(checksum_of_rank(0, two) + place_mix(std::numeric_limits<Id>::max(), 3, 0), 0x90916E4E71348355U);
}

}  // namespace
}  // namespace rcb::layout
