// MemberPlaces against the plain answer: a map from id to place.
#include "client/lib/member/member_places.hpp"

#include <algorithm>
#include <map>
#include <numeric>
#include <set>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::client {
namespace {

constexpr std::uint64_t kSeed = 20261122;
constexpr int kRanks = 3;

struct Place {
  std::int32_t rank;
  std::uint64_t slot;
};

// What a member holds, and the rows in which its caller has it.
class Caller {
 public:
  explicit Caller(std::uint64_t seed) : random_(seed) {}

  std::size_t below(std::size_t n) { return static_cast<std::size_t>(random_.uniform() * static_cast<double>(n)); }
  // Slots of a rank are shared with others, so they have gaps.
  Place free_place() {
    for (;;) {
      const Place place{static_cast<std::int32_t>(below(kRanks)), below(4000)};
      if (taken_.emplace(place.rank, place.slot).second) return place;
    }
  }
  void put(std::int64_t id) {
    if (const auto found = held.find(id); found != held.end()) taken_.erase({found->second.rank, found->second.slot});
    held[id] = free_place();
  }
  void drop(std::int64_t id) {
    taken_.erase({held.at(id).rank, held.at(id).slot});
    held.erase(id);
  }
  std::int64_t new_id() {
    for (;;) {
      const auto id = static_cast<std::int64_t>(random_.uniform() * 1e15);
      if (!held.contains(id)) return id;
    }
  }

  std::map<std::int64_t, Place> held;
  std::vector<std::int64_t> ids;

 private:
  Random random_;
  std::set<std::pair<int, std::uint64_t>> taken_;
};

struct Lists {
  std::vector<std::int64_t> id;
  std::vector<std::int32_t> rank;
  std::vector<std::uint64_t> slot;
  MemberPlaces::List view() const { return {id, rank, slot}; }
};

template <typename Ids>
Lists lists_of(const Caller& caller, const Ids& ids) {
  Lists lists;
  for (const std::int64_t id : ids) {
    lists.id.push_back(id);
    lists.rank.push_back(caller.held.at(id).rank);
    lists.slot.push_back(caller.held.at(id).slot);
  }
  return lists;
}

std::set<std::int64_t> ids_of(const Caller& caller) {
  std::set<std::int64_t> ids;
  for (const auto& [id, place] : caller.held) ids.insert(id);
  return ids;
}

void expect_rows(MemberPlaces& places, const Caller& caller, const std::string& when) {
  const auto* rows = places.rows(caller.ids);
  ASSERT_NE(rows, nullptr) << when;
  std::vector<std::map<std::uint64_t, std::uint64_t>> expected(kRanks);  // row by slot
  for (std::size_t row = 0; row < caller.ids.size(); ++row) {
    const Place& place = caller.held.at(caller.ids[row]);
    expected[static_cast<std::size_t>(place.rank)][place.slot] = row;
  }
  for (std::size_t rank = 0; rank < kRanks; ++rank) {
    std::vector<std::uint64_t> in_order;
    for (const auto& [slot, row] : expected[rank]) in_order.push_back(row);
    EXPECT_EQ((*rows)[rank], in_order) << when << ", rank " << rank;
  }
}

// How a caller's rows change when particles leave and come.
enum class Keeps { order, holes_filled, nothing };

void hand_over(Caller& caller, const std::vector<std::int64_t>& left, const std::vector<std::int64_t>& came,
               Keeps keeps) {
  for (const std::int64_t id : left) {
    const auto found = std::find(caller.ids.begin(), caller.ids.end(), id);
    if (keeps == Keeps::order) {
      caller.ids.erase(found);
    } else {
      *found = caller.ids.back();
      caller.ids.pop_back();
    }
  }
  for (const std::int64_t id : came) caller.ids.push_back(id);
  if (keeps == Keeps::nothing)
    for (std::size_t k = caller.ids.size(); k > 1; --k) std::swap(caller.ids[k - 1], caller.ids[caller.below(k)]);
}

TEST(MemberPlaces, FollowsWhatLeavesComesAndMoves) {
  for (const Keeps keeps : {Keeps::order, Keeps::holes_filled, Keeps::nothing}) {
    Caller caller(kSeed + static_cast<std::uint64_t>(keeps));
    for (int k = 0; k < 500; ++k) caller.put(caller.new_id());
    for (const auto& [id, place] : caller.held) caller.ids.push_back(id);
    std::reverse(caller.ids.begin(), caller.ids.end());
    MemberPlaces places;
    EXPECT_EQ(places.rows(caller.ids), nullptr);
    places.take_all(lists_of(caller, ids_of(caller)).view(), kRanks);
    expect_rows(places, caller, "at first");
    for (int step = 0; step < 30; ++step) {
      std::set<std::int64_t> left, placed;
      std::vector<std::int64_t> came;
      for (std::size_t k = caller.below(20); k > 0; --k) left.insert(caller.ids[caller.below(caller.ids.size())]);
      for (const std::int64_t id : left) caller.drop(id);
      for (const auto& [id, place] : caller.held)
        if (caller.below(30) == 0) placed.insert(id);  // gets another slot, or rank
      for (const std::int64_t id : placed) caller.put(id);
      for (std::size_t k = caller.below(20); k > 0; --k) {
        came.push_back(caller.new_id());
        caller.put(came.back());
        placed.insert(came.back());
      }
      places.change(std::vector(left.begin(), left.end()), lists_of(caller, placed).view());
      hand_over(caller, {left.begin(), left.end()}, came, keeps);
      expect_rows(places, caller, "seed " + std::to_string(kSeed) + ", step " + std::to_string(step));
      expect_rows(places, caller, "asked again");
    }
  }
}

TEST(MemberPlaces, RefusesParticlesOtherThanThoseHeld) {
  Caller caller(kSeed);
  for (const std::int64_t id : {10, 20, 30, 40, 50}) caller.put(id);
  caller.ids = {30, 10, 50, 20, 40};
  MemberPlaces places;
  places.take_all(lists_of(caller, ids_of(caller)).view(), kRanks);
  const auto refuses = [&places](std::vector<std::int64_t> ids) { return places.rows(ids) == nullptr; };
  EXPECT_TRUE(refuses({30, 10, 50, 20}));
  EXPECT_TRUE(refuses({30, 10, 50, 20, 40, 60}));
  EXPECT_TRUE(refuses({30, 10, 50, 20, 60}));
  EXPECT_TRUE(refuses({30, 10, 50, 20, 20}));
  expect_rows(places, caller, "after refusals");
  // 20 leaves, 60 comes, 30 gets another place.
  caller.drop(20);
  caller.put(30);
  caller.put(60);
  places.change(std::vector<std::int64_t>{20}, lists_of(caller, std::vector<std::int64_t>{30, 60}).view());
  EXPECT_TRUE(refuses({30, 10, 50, 20, 40})) << "nothing was handed over";
  EXPECT_TRUE(refuses({30, 10, 50, 40})) << "the new one is missing";
  EXPECT_TRUE(refuses({30, 10, 50, 20, 40, 60})) << "one too many";
  EXPECT_TRUE(refuses({30, 10, 50, 40, 40}));
  EXPECT_TRUE(refuses({60, 10, 50, 40, 60}));
  caller.ids = {60, 30, 10, 50, 40};
  expect_rows(places, caller, "handed over");
  places.forget();
  EXPECT_TRUE(refuses(caller.ids));
}

TEST(MemberPlaces, OfNoParticlesAtAll) {
  MemberPlaces places;
  places.take_all({}, kRanks);
  const auto* rows = places.rows({});
  ASSERT_NE(rows, nullptr);
  for (const auto& of_rank : *rows) EXPECT_TRUE(of_rank.empty());
}

TEST(Ascending, SortsNumbersOfAnySize) {
  Random random(kSeed);
  for (const double most : {1.0, 300.0, 5e6, 9e18}) {
    std::vector<std::int64_t> keys(3000);
    for (auto& key : keys) key = static_cast<std::int64_t>(random.uniform() * most);
    const auto order = ascending(keys);
    std::vector<std::uint32_t> expected(keys.size());
    std::iota(expected.begin(), expected.end(), 0U);
    std::stable_sort(expected.begin(), expected.end(), [&](auto a, auto b) { return keys[a] < keys[b]; });
    EXPECT_TRUE(std::equal(expected.begin(), expected.end(), order.begin())) << most;
  }
}

}  // namespace
}  // namespace rcb::client
