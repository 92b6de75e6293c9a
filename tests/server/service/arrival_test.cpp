// The pass at arrival: what it marks, when it tells nothing, and that a step comes out as if it hadn't been made.
#include "server/service/arrival.hpp"

#include <functional>
#include <limits>
#include <utility>

#include <gtest/gtest.h>

#include "server/service/scan.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using particles::kBlock;
using service::Arrival;
using service::Loan;
using service::Loans;
using service::Scene;
using service::Service;

const SteadyClock kClock;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Three blocks and a bit; parts 4 and 5 lie side by side along x, and from slot 100 on they take turns.
class ArrivalTest : public ::testing::Test {
 protected:
  static constexpr std::size_t kCount = 3 * kBlock + 5;

  ArrivalTest() {
    scene_ = Scene::create("s", {.parts = 8, .dims = 2});
    scene_.part.resize(kCount);
    for (std::size_t i = 0; i < kCount; ++i) scene_.part[i] = i < 100 || i % 2 == 0 ? 4 : 5;
    const std::vector<geometry::Box> boxes{{{-kInfinity, -1, 0}, {1, kInfinity, 0}},
                                           {{1, -1, 0}, {kInfinity, kInfinity, 0}}};
    scene_.regions = service::Regions(4, boxes);
    for (std::size_t i = 0; i < kCount; ++i) {
      values_[0].push_back(scene_.part[i] == 4 ? 0.5 : 1.5);
      values_[1].push_back(2);
    }
    loans_.lend(scene_);
  }
  // In pieces of this many particles, axis after axis.
  std::shared_ptr<Arrival> arrive(std::size_t piece) {
    auto arrival = loans_.begin("s", 2, kCount);
    for (std::size_t axis = 0; axis < 2; ++axis)
      for (std::size_t at = 0; at < kCount; at += piece)
        arrival->add(axis, at, std::span(values_[axis]).subspan(at, std::min(piece, kCount - at)));
    return arrival;
  }
  // What it tells at the order that ends the loan.
  std::vector<int> marks(const Arrival& arrival) {
    std::vector<int> list;
    if (arrival.holds(loans_.take_back("s").get())) list.assign(arrival.marks().begin(), arrival.marks().end());
    loans_.lend(scene_);
    return list;
  }

  Scene scene_;
  Loans loans_;
  std::array<std::vector<double>, 2> values_;
};

TEST_F(ArrivalTest, MarksTheBlocksOfWhatMayBeOutside) {
  const std::vector<int> none(4, 0);
  for (const std::size_t piece : {kCount, kBlock, kBlock + 1, std::size_t{7}, std::size_t{1}}) {
    // Each slot, beyond its part by one axis alone, at its bound, or not a number.
    struct Case {
      std::size_t slot, axis;
      double value;
    };
    std::vector<Case> cases;
    for (const std::size_t slot : {std::size_t{0}, kBlock - 1, kBlock, std::size_t{99}, std::size_t{100},
                                   std::size_t{101}, 3 * kBlock - 1, 3 * kBlock, kCount - 1}) {
      cases.push_back({slot, 0, scene_.part[slot] == 4 ? 1.25 : 0.75});
      cases.push_back({slot, 0, 1});
      cases.push_back({slot, 1, -1});
      cases.push_back({slot, 1, -5});
      cases.push_back({slot, 0, kNan});
      cases.push_back({slot, 1, kInfinity});
    }
    for (const Case& c : cases) {
      std::vector<int> expected = none;
      expected[c.slot / kBlock] = 1;
      const double kept = std::exchange(values_[c.axis][c.slot], c.value);
      EXPECT_EQ(marks(*arrive(piece)), expected)
          << "slot " << c.slot << " axis " << c.axis << " value " << c.value << " pieces of " << piece;
      values_[c.axis][c.slot] = kept;
    }
    EXPECT_EQ(marks(*arrive(piece)), none);
  }
}

TEST_F(ArrivalTest, TellsWhereTheBlocksOfOnePartAre) {
  values_[0][3] = 0.25;
  values_[0][kBlock - 1] = 0.75;
  values_[1][kBlock - 1] = -0.5;
  for (const std::size_t piece : {kCount, kBlock + 1, std::size_t{7}}) {
    const auto arrival = arrive(piece);
    const auto& of = arrival->ranges().of;
    EXPECT_EQ(of[0][0].lo, 0.25);
    EXPECT_EQ(of[0][0].hi, 0.75);
    EXPECT_EQ(of[1][0].lo, -0.5);
    EXPECT_EQ(of[1][0].hi, 2);
    EXPECT_EQ(of[0][1].lo, -kInfinity);  // of two parts
    EXPECT_EQ(of[1][1].hi, kInfinity);
  }
}

TEST_F(ArrivalTest, TellsNothingOfPiecesThatAreMissingOrOutOfOrder) {
  const std::span<const double> x(values_[0]);
  const std::span<const double> y(values_[1]);
  const auto told = [&](const std::function<void(Arrival&)>& fill) {
    const auto arrival = loans_.begin("s", 2, kCount);
    fill(*arrival);
    return !marks(*arrival).empty();
  };
  EXPECT_TRUE(told([&](Arrival& a) { a.add(0, 0, x), a.add(1, 0, y); }));
  EXPECT_FALSE(told([&](Arrival&) {}));
  EXPECT_FALSE(told([&](Arrival& a) { a.add(0, 0, x); }));
  EXPECT_FALSE(told([&](Arrival& a) { a.add(0, 0, x), a.add(1, 0, y.first(kCount - 1)); }));
  EXPECT_FALSE(told([&](Arrival& a) { a.add(0, 0, x), a.add(1, 1, y.subspan(1)); }));
  EXPECT_FALSE(told([&](Arrival& a) { a.add(0, 0, x), a.add(0, 0, x), a.add(1, 0, y); }));
  EXPECT_FALSE(told([&](Arrival& a) { a.add(0, 0, x), a.add(1, 0, y), a.add(2, 0, y); }));
}

TEST_F(ArrivalTest, WhatWasTakenBackIsNotReadAnyMore) {
  const auto arrival = loans_.begin("s", 2, kCount);
  arrival->add(0, 0, values_[0]);
  const auto loan = loans_.take_back("s");
  scene_.part = {};
  scene_.regions = {};
  arrival->add(1, 0, values_[1]);
  EXPECT_FALSE(arrival->holds(loan.get()));
  EXPECT_EQ(loans_.begin("s", 2, kCount), nullptr);
  EXPECT_EQ(loans_.take_back("s"), nullptr);
}

TEST_F(ArrivalTest, IsBegunForSlicesOfTheSceneAlone) {
  EXPECT_NE(loans_.begin("s", 2, kCount), nullptr);
  EXPECT_EQ(loans_.begin("s", 3, kCount), nullptr);
  EXPECT_EQ(loans_.begin("s", 2, kCount + 1), nullptr);
  EXPECT_EQ(loans_.begin("t", 2, kCount), nullptr);
  loans_.take_back_all();
  EXPECT_EQ(loans_.begin("s", 2, kCount), nullptr);
}

// A slice seen in pieces, as a port hands it on.
std::shared_ptr<Arrival> see(Loans& loans, const PushSlice& slice, std::size_t dims, std::size_t piece) {
  auto arrival = loans.begin("a", static_cast<int>(dims), slice.count);
  if (!arrival) return nullptr;
  for (std::size_t a = 0; a < dims; ++a) {
    const std::span<const double> values(reinterpret_cast<const double*>(slice.arrays[a].bytes.data()), slice.count);
    for (std::size_t at = 0; at < slice.count; at += piece)
      arrival->add(a, at, values.subspan(at, std::min<std::size_t>(piece, slice.count - at)));
  }
  return arrival;
}

TEST(Arrival, AStepIsAsIfItHadNotBeenSeen) {
  on_ranks([](partition::Comm& comm) {
    for (const int dims : {1, 2, 3}) {
      Loans loans;
      Service seen(comm, kClock, {.loans = &loans});
      Service plain(comm, kClock);
      Driver arriving(comm, seen, "a");
      Driver staying(comm, plain, "a");
      const Json options{{"parts", 11}, {"dims", dims}, {"tolerance", 0.1}};
      arriving.create(options);
      staying.create(options);
      Particles particles = random_particles(3, 1500, dims);
      std::size_t piece = 1;
      std::uint64_t begun = 0;
      arriving.arrive = [&](const PushSlice& slice) {
        auto arrival = see(loans, slice, static_cast<std::size_t>(dims), piece);
        begun += arrival ? 1U : 0U;
        return arrival;
      };
      for (int step = 0; step < 20; ++step) {
        const Response one = arriving.push(particles, step);
        const Response other = staying.push(particles, step);
        if (comm.rank() == 0) {
          EXPECT_TRUE(one.status.ok()) << one.status.message();
          for (const char* name : {"drifted", "moved", "migrated", "error_before", "error", "epoch", "reason"})
            EXPECT_EQ(one.json["report"][name], other.json["report"][name]) << name << " of step " << step;
          EXPECT_EQ(one.json["plan"], other.json["plan"]);
        }
        piece = piece * 3 % 101 + 1;
        drift(particles, 50 + static_cast<std::uint64_t>(step), 0.01);
      }
      const Response one = arriving.ask("assign", {{"checksum", true}});
      const Response other = staying.ask("assign", {{"checksum", true}});
      EXPECT_GT(begun, 0U);
      if (comm.rank() != 0) continue;
      EXPECT_EQ(one.json["hash"], other.json["hash"]);
      EXPECT_EQ(one.json["checksum"], other.json["checksum"]);
    }
  });
}

// That the marks are used shows where they were made of other values than those that are pushed.
TEST(Arrival, ItsMarksHoldUntilTheSceneChanges) {
  on_ranks([](partition::Comm& comm) {
    Loans loans;
    Service service(comm, kClock, {.loans = &loans});
    Driver driver(comm, service, "a");
    driver.create({{"parts", 8}, {"tolerance", "inf"}});
    const Particles particles = random_particles(5, 20000, 3);
    Particles mirrored = particles;
    for (double& x : mirrored.position[0]) x = 1 - x;
    driver.push(particles, 0);
    const auto push = [&](const Particles& positions, int step) {
      const Response pushed = driver.push(positions, step);
      if (comm.rank() != 0) return std::uint64_t{0};
      EXPECT_TRUE(pushed.status.ok()) << pushed.status.message();
      return pushed.json["report"]["drifted"].get<std::uint64_t>();
    };
    PushSlice slice;
    std::shared_ptr<const Arrival> arrival;
    driver.arrive = [&](const PushSlice& sent) {
      slice = sent;
      return arrival = see(loans, sent, 3, 100);
    };
    EXPECT_EQ(push(particles, 1), 0U);
    driver.arrive = [&](const PushSlice&) { return arrival; };  // seen before the last step
    const std::uint64_t all = push(mirrored, 2);
    EXPECT_EQ(push(particles, 3), all);
    driver.arrive = [&](const PushSlice& sent) {
      slice = sent;
      return see(loans, sent, 3, 100);
    };
    EXPECT_EQ(push(particles, 4), 0U);
    driver.arrive = [&](const PushSlice&) { return see(loans, slice, 3, 100); };  // of where they stood
    const std::uint64_t marked = push(mirrored, 5);
    if (comm.rank() != 0) return;
    EXPECT_GT(all, 10000U);
    EXPECT_LT(marked, all / 2);
  });
}

TEST(Arrival, ANanInTheLastElementIsNamedAndTheNextPushIsGood) {
  on_ranks([](partition::Comm& comm) {
    Loans loans;
    Service service(comm, kClock, {.loans = &loans});
    Driver driver(comm, service, "a");
    driver.create({{"parts", 5}});
    Particles particles = random_particles(9, 800, 3);
    driver.push(particles, 0);
    driver.arrive = [&](const PushSlice& slice) { return see(loans, slice, 3, 33); };
    const auto rows = driver.plan().rows(comm.size() - 1);
    Particles bad = particles;
    bad.position[2][rows.back()] = kNan;
    const Response refused = driver.push(bad, 1);
    const Response taken = driver.push(particles, 1);
    if (comm.rank() != 0) return;
    EXPECT_EQ(refused.status.code(), Code::not_finite);
    EXPECT_NE(refused.status.message().find(std::to_string(rows.back())), std::string::npos)
        << refused.status.message();
    EXPECT_TRUE(taken.status.ok()) << taken.status.message();
    EXPECT_EQ(taken.json["report"]["drifted"], 0);
  });
}

}  // namespace
}  // namespace rcb::testing
