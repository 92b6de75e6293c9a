// What isn't skipped changes no answer, and the report says what was done.
#include "server/service/scene/no_skip.hpp"

#include <algorithm>

#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using service::NoSkip;

// A report without what tells of the work alone.
Json outcome(Json report) {
  for (const char* name : {"seconds", "skipped", "searched", "rounds", "reductions"}) report.erase(name);
  return report;
}

bool skips(const Json& report, const char* name) {
  const Json& skipped = report["skipped"];
  return std::find(skipped.begin(), skipped.end(), name) != skipped.end();
}

TEST(NoSkip, IsParsed) {
  const auto none = NoSkip::parse("");
  ASSERT_TRUE(none.ok());
  EXPECT_FALSE(none->exchange || none->search);
  const auto both = NoSkip::parse("search,exchange");
  ASSERT_TRUE(both.ok());
  EXPECT_TRUE(both->exchange && both->search);
  EXPECT_FALSE(NoSkip::parse("exchange")->search);
  EXPECT_TRUE(NoSkip::parse("warm")->full_search);
  for (const char* names : {"everything", ",", "search,exchange,x", "Search", " search"})
    EXPECT_FALSE(NoSkip::parse(names).ok()) << names;
  EXPECT_NE(NoSkip::parse("x").status().hint().find("exchange, search"), std::string::npos);
}

TEST(NoSkip, ChangesNoAnswer) {
  on_ranks([](comm::Comm& comm) {
    for (const auto& [weighted, path] : {std::pair(false, Path::held), {true, Path::held}, {true, Path::gateway}}) {
      Service plain(comm, kClock);
      Service busy(comm, kClock, {.no_skip = NoSkip::parse("exchange,search").value()});
      Driver a(comm, plain, "a");
      Driver b(comm, busy, "a");
      const Json options{{"parts", 7}, {"tolerance", 0.1}};
      a.path = b.path = path;
      a.create(options);
      b.create(options);
      Particles particles = random_particles(11, 900, 3);
      Random random(5);
      for (std::size_t k = 0; k < 900 && weighted; ++k) particles.weights.push_back(random.uniform(0, 3));
      int quiet = 0;
      for (int step = 0; step < 25; ++step) {
        const Response skipping = a.push(particles, step);
        const Response forced = b.push(particles, step);
        if (comm.rank() == 0) {
          ASSERT_TRUE(forced.status.ok()) << forced.status.message();
          const Json& plain_report = skipping.json["report"];
          const Json& busy_report = forced.json["report"];
          EXPECT_EQ(outcome(plain_report), outcome(busy_report));
          EXPECT_FALSE(skips(busy_report, "search"));
          EXPECT_TRUE(step == 0 || !skips(busy_report, "exchange"));
          EXPECT_GT(busy_report["reductions"], 0);
          EXPECT_EQ(skips(plain_report, "search"), plain_report["reductions"] == 0);
          EXPECT_TRUE(!skips(plain_report, "exchange") || plain_report["migrated"] == 0);
          quiet += skips(plain_report, "search") && skips(plain_report, "exchange") ? 1 : 0;
        }
        if (step % 5 != 4) drift(particles, 300 + static_cast<std::uint64_t>(step), 0.01);  // else none moves
      }
      EXPECT_TRUE(comm.rank() != 0 || path == Path::gateway || quiet > 2) << quiet;
      const Response one = a.ask("assign", {{"checksum", true}});
      const Response other = b.ask("assign", {{"checksum", true}});
      EXPECT_EQ(one.json, other.json);
    }
  });
}

TEST(NoSkip, QuestionsAreCounted) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 4}, {"tolerance", "inf"}});
    const Particles particles = random_particles(1, 200, 3);
    for (int step = 0; step < 4; ++step) {
      driver.push(particles, step);
      if (step == 0) driver.ask("error");  // costs nothing
      if (step == 1) driver.ask("quality");
      if (step == 2) driver.ask("quality", {{"ghost_width", "wide"}});  // refused
    }
    const Response stats = driver.ask("stats");
    if (comm.rank() != 0) return;
    EXPECT_EQ(stats.json["skipped"]["questions"], 3);
    EXPECT_EQ(stats.json["asked"], (Json{{"quality", 1}}));
    EXPECT_EQ(stats.json["scanned"], 4 * 200);
    EXPECT_GT(stats.json["reductions"], 0);
  });
}

}  // namespace
}  // namespace rcb::testing
