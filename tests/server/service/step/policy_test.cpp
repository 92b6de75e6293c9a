// The service deciding by its policy when it repartitions, with clocks that differ from rank to rank.
#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

// A clock of each rank's own, that runs on at every look.
class RankClock final : public Clock {
 public:
  explicit RankClock(int rank) : tick_(1e-3 * (1 + 7 * rank)) {}
  double seconds() const override { return now_ += tick_; }

 private:
  double tick_;
  mutable double now_ = 0;
};

// The rule once more, from the reports alone.
TEST(ServicePolicy, CostDecidesTheSameOnAllRanks) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver driver(comm, service, "a");
    driver.create({{"parts", 6}, {"policy", "cost"}, {"tolerance", 0}});
    Particles particles = random_particles(5, 600, 3);
    double best = 1, lost = 0, imbalance = 1;
    std::vector<double> costs;
    int repartitions = 0;
    for (int step = 0; step < 60; ++step) {
      const double solver_seconds = 1e-3 * (1 + step % 3);
      driver.step_seconds = solver_seconds;
      const Response pushed = driver.push(particles, step);
      drift(particles, 300 + static_cast<std::uint64_t>(step), 0.02);
      if (comm.rank() != 0) continue;
      EXPECT_TRUE(pushed.status.ok()) << pushed.status.message();
      const Json& report = pushed.json["report"];
      const double seconds = report["seconds"]["search"].get<double>() + report["seconds"]["migrate"].get<double>();
      if (step > 0) {
        if (imbalance > best) lost += solver_seconds * (1 - best / imbalance);
        std::vector<double> last(costs.end() - std::min<std::ptrdiff_t>(5, std::ssize(costs)), costs.end());
        std::sort(last.begin(), last.end());
        const double cost = (last[(last.size() - 1) / 2] + last[last.size() / 2]) / 2;
        const std::string reason = report["reason"];
        ASSERT_NE(reason.find("imbalance has cost"), std::string::npos);
        const std::string word = "would cost ";
        const double all = lost + std::stod(reason.substr(reason.find(word) + word.size()));  // of three digits
        if (std::abs(all - cost) > 0.01 * cost) {
          EXPECT_EQ(report["repartitioned"].get<bool>(), all > cost) << reason;
        }
      }
      imbalance = report["imbalance"];
      if (!report["repartitioned"]) continue;
      if (step > 0 && ++repartitions == 1) costs.clear();  // the first partition's
      costs.push_back(seconds);
      lost = 0;
      best = imbalance;
    }
    if (comm.rank() == 0) {
      EXPECT_GT(repartitions, 2);
      EXPECT_LT(repartitions, 40);
    }
  });
}

// The first push's time counts for nothing. A rebalance by hand begins the sum anew, and is none of the repartitions
// whose times are remembered.
TEST(ServicePolicy, WhatAFirstPushAndARebalanceDoToTheSum) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver driver(comm, service, "a");
    driver.create({{"parts", 3}, {"policy", "cost"}, {"tolerance", 0}});
    Particles particles = random_particles(3, 300, 3);
    std::vector<std::string> reasons;
    const auto push = [&](double step_seconds) {
      driver.step_seconds = step_seconds;
      const Response pushed = driver.push(particles, std::ssize(reasons));
      reasons.push_back(comm.rank() == 0 ? pushed.json["report"]["reason"].get<std::string>() : "");
      drift(particles, 77 + reasons.size(), 0.05);
    };
    push(1e6);
    push(0);
    push(1e-9);  // by now there is an imbalance
    driver.ask("rebalance", {{"dry_run", true}});
    push(0);
    driver.ask("rebalance", {});
    push(0);
    if (comm.rank() != 0) return;
    EXPECT_EQ(reasons[0], "first positions");
    EXPECT_NE(reasons[1].find("has cost 0 s since step 0"), std::string::npos) << reasons[1];
    EXPECT_EQ(reasons[2].find("has cost 0 s"), std::string::npos) << reasons[2];
    const std::size_t from = reasons[2].find("imbalance"), to = reasons[2].find(" and would cost");
    const std::string lost = reasons[2].substr(from, to - from);
    EXPECT_NE(reasons[3].find(lost), std::string::npos) << "a dry run changes nothing: " << reasons[3];
    EXPECT_NE(reasons[4].find("has cost 0 s since the last repartition"), std::string::npos) << reasons[4];
    const std::string price = reasons[2].substr(reasons[2].find("a repartition costs"));
    EXPECT_NE(reasons[4].find(price), std::string::npos) << "that of the first partition: " << reasons[4];
  });
}

TEST(ServicePolicy, WithoutStepTimesCostIsTolerance) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver by_tolerance(comm, service, "tolerance");
    Driver by_cost(comm, service, "cost");
    by_tolerance.create({{"parts", 5}, {"tolerance", 0.1}});
    by_cost.create({{"parts", 5}, {"tolerance", 0.1}, {"policy", "cost"}});
    Particles particles = random_particles(8, 500, 2);
    particles.dims = 3;
    particles.position.push_back(particles.position[0]);
    for (int step = 0; step < 20; ++step) {
      const Response a = by_tolerance.push(particles, step);
      const Response b = by_cost.push(particles, step);
      drift(particles, 500 + static_cast<std::uint64_t>(step), 0.05);
      if (comm.rank() != 0) continue;
      EXPECT_EQ(a.json["report"]["repartitioned"], b.json["report"]["repartitioned"]) << step;
      EXPECT_EQ(a.json["report"]["error"], b.json["report"]["error"]) << step;
      if (step > 0) {
        EXPECT_EQ(b.json["report"]["reason"],
                  "no step time was told: " + a.json["report"]["reason"].get<std::string>());
      }
    }
  });
}

// One particle far from all others outweighs them, and grows heavier: no cuts can help. One search shows it.
TEST(ServicePolicy, AVainSearchSettlesTheAccount) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver driver(comm, service, "a");
    driver.create({{"parts", 4}, {"policy", "cost"}});
    Particles particles = random_particles(11, 200, 3);
    particles.position[0][17] = 10;
    particles.weights.assign(200, 1);
    driver.step_seconds = 10;
    for (int step = 0; step < 6; ++step) {
      particles.weights[17] = step == 0 ? 1000 : 2000;
      const Response pushed = driver.push(particles, step);
      if (comm.rank() != 0) continue;
      const Json& report = pushed.json["report"];
      const std::string reason = report["reason"];
      EXPECT_EQ(report["repartitioned"].get<bool>(), step == 0);
      EXPECT_EQ(reason.ends_with("not adopted"), step == 1) << step << ": " << reason;
      EXPECT_EQ(reason.find("imbalance has cost 0 s") != std::string::npos, step > 0) << step << reason;
    }
  });
}

// A search in vain at one error forbids others up to that error, until there are new cuts, for which it proves nothing.
TEST(ServicePolicy, NewCutsMakeAVainSearchForgotten) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver driver(comm, service, "a");
    driver.create({{"parts", 2}, {"dims", 1}, {"tolerance", 0.1}});
    Particles line;
    line.dims = 1;
    line.position = {{0, 1, 2}};
    const auto push = [&](std::vector<double> weights, int step) {
      line.weights = std::move(weights);
      const Response pushed = driver.push(line, step);
      return comm.rank() == 0 ? pushed.json["report"] : Json();
    };
    push({10, 1, 1}, 0);
    const Json in_vain = push({10, 1, 1}, 1);
    const Json held_back = push({1, 2, 1.5}, 2);
    driver.ask("rebalance");
    const Json searched = push({2, 2, 1}, 3);
    if (comm.rank() != 0) return;
    EXPECT_TRUE(in_vain["reason"].get<std::string>().ends_with("not adopted")) << in_vain;
    EXPECT_NE(held_back["reason"].get<std::string>().find("it hasn't grown since"), std::string::npos) << held_back;
    EXPECT_LT(searched["error_before"], in_vain["error"]);
    EXPECT_TRUE(searched["repartitioned"]) << searched;
  });
}

TEST(ServicePolicy, Refusals) {
  on_ranks([](comm::Comm& comm) {
    const RankClock clock(comm.rank());
    Service service(comm, clock);
    Driver driver(comm, service, "a");
    const Response magic = driver.create({{"parts", 2}, {"policy", "magic"}});
    const Response number = driver.create({{"parts", 2}, {"policy", 1}});
    driver.create({{"parts", 2}, {"policy", "cost"}});
    const Response shown = driver.ask("scene.show");
    std::vector<Response> refused;
    for (const Json& seconds : {Json(-1e-9), Json("inf"), Json(true)}) {
      driver.step_seconds = seconds;
      refused.push_back(driver.push(random_particles(1, 20, 3), 0));
    }
    if (comm.rank() != 0) return;
    EXPECT_EQ(magic.status.code(), Code::invalid_argument);
    EXPECT_EQ(number.status.code(), Code::invalid_argument);
    EXPECT_EQ(shown.json["policy"], "cost");
    for (const Response& response : refused) {
      EXPECT_EQ(response.status.code(), Code::invalid_argument);
      EXPECT_NE(response.status.message().find("step_seconds"), std::string::npos) << response.status.message();
    }
  });
}

}  // namespace
}  // namespace rcb::testing
