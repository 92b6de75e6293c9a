// What a repartition looks at and what it cuts anew: nothing of it shows in answers but what was asked for.
#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using service::NoSkip;
using service::Service;

// Moves matter towards one end of an axis, smoothly, so that loads grow apart and few particles cross.
void lean(Particles& particles, double by) {
  for (double& x : particles.position[0]) x -= by * x * (8 - x) / 8;
}

TEST(Repartitions, LookAtFewAndAnswerAsASearchAmongAll) {
  on_ranks([](comm::Comm& comm) {
    for (const double hysteresis : {1.0, 1.5}) {
      Service incremental(comm, kClock);
      Service full(comm, kClock, {.no_skip = NoSkip::parse("warm").value()});
      Driver a(comm, incremental, "a");
      Driver b(comm, full, "a");
      const Json options{{"parts", 4}, {"tolerance", 0.02}, {"axis_hysteresis", hysteresis}};
      a.create(options);
      b.create(options);
      Particles particles = random_particles(3, 100000, 3);
      for (double& x : particles.position[0]) x *= 8;
      int few = 0;
      for (int step = 0; step < 7; ++step) {
        const Response one = a.push(particles, step);
        const Response other = b.push(particles, step);
        if (comm.rank() == 0) {
          ASSERT_TRUE(one.status.ok()) << one.status.message();
          Json left = one.json["report"];
          Json right = other.json["report"];
          if (step > 0 && left["repartitioned"].get<bool>()) {
            EXPECT_EQ(right["searched"], 100000);
            few += left["searched"] < 50000 ? 1 : 0;
          }
          for (const char* name : {"seconds", "skipped", "rounds", "reductions", "searched"}) {
            left.erase(name);
            right.erase(name);
          }
          EXPECT_EQ(left, right);
          EXPECT_EQ(one.json["plan"], other.json["plan"]);
        }
        lean(particles, 0.02);
      }
      EXPECT_EQ(a.ask("assign", {{"checksum", true}}).json, b.ask("assign", {{"checksum", true}}).json);
      EXPECT_TRUE(comm.rank() != 0 || few > 1) << few;
    }
  });
}

TEST(Repartitions, CutTheSubtreesThatNeedIt) {
  Reference reference;
  on_ranks([&reference](comm::Comm& comm) {
    OwnDriver driver(comm, "a", {{"parts", 8}, {"tolerance", 0.05}, {"recut", "subtree"}, {"axis_hysteresis", 2}});
    Particles particles = random_particles(4, 8000, 3);
    for (double& x : particles.position[0]) x *= 8;  // cut along it: parts 0..7 from left to right
    driver.push(particles, 0);
    const Json before = driver.ask("cuts").json;
    // Within the last quarter alone.
    for (double& x : particles.position[0])
      if (x > 6) x -= 0.2 * (x - 6) * (8 - x) / 2;
    const Response pushed = driver.push(particles, 1);
    const Json after = driver.ask("cuts").json;
    if (comm.rank() != 0) return;
    ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
    const Json& report = pushed.json["report"];
    EXPECT_TRUE(report["repartitioned"]) << report;
    EXPECT_LT(report["error"], 0.025);
    EXPECT_EQ(report["axes_flipped"], 0);
    ASSERT_EQ(before["cuts"].size(), 7U);
    int changed = 0;
    for (std::size_t c = 0; c < 7; ++c) changed += before["cuts"][c] == after["cuts"][c] ? 0 : 1;
    EXPECT_EQ(changed, 1);
    EXPECT_NE(before["cuts"][6], after["cuts"][6]);
    reference.check("cuts", after["cuts"]);
    reference.check("moved", report["moved"]);
  });
}

TEST(Repartitions, RefuseAnUnknownRecut) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Driver driver(comm, service, "a");
    const Response unknown = driver.create({{"parts", 2}, {"recut", "some"}});
    const Response no_word = driver.create({{"parts", 2}, {"recut", 1}});
    const Response good = driver.create({{"parts", 2}, {"recut", "subtree"}});
    const Response shown = driver.ask("scene.show");
    if (comm.rank() != 0) return;
    EXPECT_EQ(unknown.status.code(), Code::invalid_argument);
    EXPECT_EQ(no_word.status.code(), Code::invalid_argument);
    EXPECT_TRUE(good.status.ok());
    EXPECT_EQ(shown.json["recut"], "subtree");
  });
}

}  // namespace
}  // namespace rcb::testing
