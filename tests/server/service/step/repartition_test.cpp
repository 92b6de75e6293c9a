// What a repartition looks at: nothing of it shows in answers.
#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using service::NoSkip;

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
        }
        lean(particles, 0.02);
      }
      EXPECT_EQ(a.ask("assign", {{"checksum", true}}).json, b.ask("assign", {{"checksum", true}}).json);
      EXPECT_TRUE(comm.rank() != 0 || few > 1) << few;
    }
  });
}

}  // namespace
}  // namespace rcb::testing
