// The whole service on threads and on MPI: pushes, reports, refusals that change nothing, one answer on any rank count.
#include "server/service/service.hpp"

#include <cmath>
#include <limits>
#include <set>

#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

// What must not depend on the rank count.
Json comparable(Json report) {
  for (const char* name : {"seconds", "migrated", "skipped", "searched", "rounds", "reductions"}) report.erase(name);
  return report;
}

TEST(Service, FirstPushIsPartitioned) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 8}});
    const Response pushed = driver.push(random_particles(1, 1001, 3), 0);
    const Response counts = driver.ask("counts");
    if (comm.rank() != 0) return;
    ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
    const Json report = pushed.json["report"];
    EXPECT_TRUE(report["repartitioned"]);
    EXPECT_EQ(report["epoch"], 1);
    EXPECT_EQ(report["reason"], "first positions");
    EXPECT_TRUE(report["error_before"].is_null());
    for (const char* name : {"drifted", "moved", "migrated"}) EXPECT_EQ(report[name], 0);
    EXPECT_EQ(counts.json["counts"], Json({125, 125, 125, 125, 125, 125, 125, 126}));
  });
}

TEST(Service, ReportsAreTheSameOnAnyNumberOfRanks) {
  Reference reference;
  on_ranks([&](comm::Comm& comm) {
    for (const int dims : {1, 2, 3}) {
      OwnDriver driver(comm, "walk", {{"parts", 7}, {"dims", dims}, {"tolerance", 0.08}});
      Particles particles = random_particles(7, 700, dims);
      for (int step = 0; step < 25; ++step) {
        const Response pushed = driver.push(particles, step);
        if (comm.rank() == 0) {
          ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
          reference.check(std::to_string(dims) + "/" + std::to_string(step), comparable(pushed.json["report"]));
        }
        drift(particles, 100 + static_cast<std::uint64_t>(step), 0.02);
      }
      const Response assigned = driver.ask("assign", {{"checksum", true}});
      if (comm.rank() == 0) {
        reference.check("hash" + std::to_string(dims), assigned.json["hash"]);
        reference.check("checksum" + std::to_string(dims), assigned.json["checksum"]);
      }
    }
  });
}

TEST(Service, IdsOfTheSolversOwnAndWeights) {
  Reference reference;
  on_ranks([&](comm::Comm& comm) {
    OwnDriver driver(comm, "w", {{"parts", 5}, {"tolerance", 0.2}});
    Particles particles = random_particles(3, 300, 3);
    Random random(9);
    for (int k = 0; k < 300; ++k) {
      particles.ids.push_back(std::numeric_limits<std::int64_t>::max() - 7 * ((k * 37) % 300));
      particles.weights.push_back(random.uniform(0, 3));
    }
    for (int step = 0; step < 12; ++step) {
      const Response pushed = driver.push(particles, step);
      if (comm.rank() == 0) {
        ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
        reference.check(std::to_string(step), comparable(pushed.json["report"]));
      }
      drift(particles, 40 + static_cast<std::uint64_t>(step), 0.05);
    }
    const Response counts = driver.ask("counts");
    if (comm.rank() == 0) reference.check("loads", counts.json["loads"]);
  });
}

TEST(Service, ARefusedPushChangesNothing) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 3}});
    const Particles good = random_particles(1, 50, 3);
    driver.push(good, 4);
    const Response before = driver.ask("assign", {{"checksum", true}});
    const Response shown = driver.ask("scene.show");

    Particles nan = good;
    nan.position[1][31] = std::nan("");
    nan.position[0][12] = std::numeric_limits<double>::infinity();
    const Response not_finite = driver.push(nan, 5);
    const Response repeated = driver.push(good, 4);
    const Response after = driver.ask("assign", {{"checksum", true}});
    const Response shown_after = driver.ask("scene.show");
    const Response works = driver.push(good, 5);
    if (comm.rank() != 0) return;
    EXPECT_EQ(not_finite.status.code(), Code::not_finite);
    EXPECT_NE(not_finite.status.message().find("particle 12 (index, from 0): x is inf"), std::string::npos)
        << not_finite.status.message();
    EXPECT_TRUE(repeated.status.ok());
    EXPECT_TRUE(repeated.json["repeated"]);
    EXPECT_EQ(repeated.json["report"]["step"], 4);
    EXPECT_EQ(before.json, after.json);
    EXPECT_EQ(shown.json, shown_after.json);
    EXPECT_TRUE(works.status.ok()) << works.status.message();
  });
}

TEST(Service, AnyWeightBelowZeroIsRefusedAtALaterPushToo) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 3}});
    Particles particles = random_particles(1, 50, 3);
    particles.weights.assign(50, 2);
    driver.push(particles, 0);
    particles.weights[31] = -1e-300;
    const Response refused = driver.push(particles, 1);
    if (comm.rank() != 0) return;
    EXPECT_EQ(refused.status.code(), Code::invalid_argument);
    EXPECT_NE(refused.status.message().find("particle 31 (index, from 0): weight is -1e-300"), std::string::npos)
        << refused.status.message();
  });
}

TEST(Service, RebalanceByThePureRule) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 8}, {"tolerance", "inf"}});
    Particles particles = random_particles(5, 500, 3);
    driver.push(particles, 0);
    drift(particles, 6, 0.3);
    driver.push(particles, 1);
    const Response dry = driver.ask("rebalance", {{"dry_run", true}});
    const Response untouched = driver.ask("scene.show");
    const Response wet = driver.ask("rebalance", {{"parts", 5}, {"method", "bands-y"}});
    const Response counts = driver.ask("counts");
    const Response history = driver.ask("history");
    const Response assigned = driver.ask("assign");
    if (comm.rank() != 0) return;
    EXPECT_FALSE(dry.json["adopted"]);
    EXPECT_EQ(untouched.json["epoch"], 1);
    EXPECT_GT(dry.json["moved"], 0);
    EXPECT_EQ(wet.json["epoch"], 2);
    EXPECT_EQ(counts.json["counts"], Json({100, 100, 100, 100, 100}));
    EXPECT_EQ(history.json["history"].size(), 2U);
    const auto ids = values_of<std::int64_t>(assigned, "id");
    EXPECT_EQ(std::set(ids.begin(), ids.end()).size(), 500U);
  });
}

TEST(Service, NoAndFewParticles) {
  on_ranks([](comm::Comm& comm) {
    for (const std::size_t n : {std::size_t{0}, std::size_t{1}, std::size_t{5}}) {
      OwnDriver driver(comm, "a", {{"parts", 8}});
      Particles particles = random_particles(5, n, 3);
      driver.push(particles, 0);
      drift(particles, 6, 5);
      const Response pushed = driver.push(particles, 1);
      const Response counts = driver.ask("counts");
      if (comm.rank() != 0) continue;
      ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
      std::uint64_t total = 0;
      for (const auto& count : counts.json["counts"]) total += count.get<std::uint64_t>();
      EXPECT_EQ(total, n);
      if (n > 0) continue;
      EXPECT_EQ(pushed.json["report"]["error"], 0);
      EXPECT_EQ(pushed.json["report"]["imbalance"], 1);
    }
  });
}

TEST(Service, BadRequests) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Driver driver(comm, service, "a");
    const std::vector<std::pair<Response, Code>> answers{
        {driver.ask("error"), Code::not_found},
        {driver.ask("nonsense"), Code::unsupported},
        {driver.create({{"parts", 0}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"dims", 4}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"tolerance", -1}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"axis_hysteresis", 0.5}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"method", "magic"}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"dims", 2}, {"method", "bands-z"}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"part_sizes", {1, 0}}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"part_sizes", {1, 2, 3}}}), Code::invalid_argument},
        {driver.create({{"parts", 2}, {"part_sizes", {1e300, 1}}}), Code::invalid_argument},
        {driver.create({{"parts", 2}}), Code::ok},
        {driver.create({{"parts", 2}}), Code::already_exists},
        {driver.ask("counts"), Code::not_found},
    };
    if (comm.rank() != 0) return;
    for (std::size_t k = 0; k < answers.size(); ++k)
      EXPECT_EQ(answers[k].first.status.code(), answers[k].second) << k << ": " << answers[k].first.status.message();
  });
}

}  // namespace
}  // namespace rcb::testing
