// A service that takes up the scenes of an earlier one: it knows them but for their particles, which the next step
// brings, and goes on as if it had never ended.
#include <memory>

#include <gtest/gtest.h>

#include "tests/server/service/push/stories.hpp"
#include "tests/support/on_ranks.hpp"
#include "tests/support/self_comm.hpp"
#include "tests/support/simulated_storage.hpp"

namespace rcb::testing {
namespace {

// A copy, as the next process finds it.
std::shared_ptr<SimulatedStorage> copy_of(const SimulatedStorage& storage) {
  auto copy = std::make_shared<SimulatedStorage>(storage);
  for (auto& [path, bytes] : copy->files) bytes = std::make_shared<std::string>(*bytes);
  return copy;
}

// Stands still, so that decisions by costs are the same in all services.
class StillClock final : public Clock {
 public:
  double seconds() const override { return 0; }
};
const StillClock kStill;

// A service that lasts, and its client.
struct Lasting {
  Lasting(comm::Comm& comm, std::shared_ptr<SimulatedStorage> in)
      : storage(std::move(in)), service(comm, kStill, storage), driver(comm, service, "s") {}
  std::shared_ptr<SimulatedStorage> storage;
  Service service;
  Driver driver;
};

// What doesn't depend on which service answers, of any number of ranks. How many looked at what may differ.
Json comparable_report(Json report) {
  for (const char* name : {"seconds", "migrated", "skipped", "searched", "rounds", "reductions", "drifted", "way"})
    report.erase(name);
  return report;
}

enum class Brought { weights, ids, plain };

Particles particles_of(Brought kind, int dims) {
  Particles particles = random_particles(11, 400, dims);
  Random random(12);
  for (std::int64_t k = 0; k < 400; ++k) {
    if (kind == Brought::ids) particles.ids.push_back(5 + 3 * ((k * 37) % 400));
    if (kind != Brought::plain) particles.weights.push_back(random.uniform(0.5, 2));
  }
  return particles;
}

const Json kOptions{{"parts", 9}, {"tolerance", 0.15}, {"axis_hysteresis", 1.1}, {"policy", "cost"}};

// Steps [first, last) of two clients; the reports of both must agree. One rebalances after step 3.
void step_both(comm::Comm& comm, Driver& one, Driver& other, Particles& particles, int first, int last) {
  for (int step = first; step < last; ++step) {
    SCOPED_TRACE(step);
    drift(particles, 100 + static_cast<std::uint64_t>(step), 0.03);
    one.step_seconds = other.step_seconds = 0.01 * (step % 3);
    const Response left = one.push(particles, step);
    const Response right = other.push(particles, step);
    if (step == 3)
      for (Driver* driver : {&one, &other}) driver->ask("rebalance", {{"parts", 8}, {"tolerance", 0.1}});
    if (comm.rank() != 0) continue;
    EXPECT_TRUE(left.status.ok()) << left.status.message();
    EXPECT_TRUE(right.status.ok()) << right.status.message();
    EXPECT_EQ(comparable_report(left.json["report"]), comparable_report(right.json["report"]));
  }
}

void expect_same(comm::Comm& comm, Driver& one, Driver& other, const std::string& command, const Json& more) {
  Response left = one.ask(command, more);
  Response right = other.ask(command, more);
  if (comm.rank() != 0) return;
  ASSERT_TRUE(left.status.ok()) << command << ": " << left.status.message();
  EXPECT_EQ(left.json, right.json) << command;
  ASSERT_EQ(left.arrays.size(), right.arrays.size()) << command;
  for (std::size_t a = 0; a < left.arrays.size(); ++a)
    EXPECT_TRUE(std::ranges::equal(left.arrays[a].bytes.span(), right.arrays[a].bytes.span())) << command;
}

class Restored : public ::testing::TestWithParam<std::tuple<Brought, int, Path>> {};

TEST_P(Restored, GoesOnAsIfTheServiceHadNeverEnded) {
  const auto& [kind, dims, path] = GetParam();
  on_ranks([&](comm::Comm& comm) {
    Particles particles = particles_of(kind, dims);
    Json options = kOptions;
    options["dims"] = dims;
    Lasting lasting(comm, std::make_shared<SimulatedStorage>(1));
    lasting.driver.create(options);
    auto before = std::make_unique<Lasting>(comm, std::make_shared<SimulatedStorage>(1));
    before->driver.create(options);
    step_both(comm, lasting.driver, before->driver, particles, 0, 6);
    const auto storage = copy_of(*before->storage);
    before.reset();

    Lasting after(comm, storage);
    const scene::Restored restored = after.service.restore();
    if (comm.rank() == 0) {
      EXPECT_EQ(restored.scenes, 1U);
      EXPECT_EQ(restored.steps, 6U);
      EXPECT_EQ(restored.lost_records, 0U);
    }
    expect_same(comm, lasting.driver, after.driver, "counts", Json::object());
    expect_same(comm, lasting.driver, after.driver, "history", Json::object());
    after.driver.path = path;
    step_both(comm, lasting.driver, after.driver, particles, 6, 14);
    expect_same(comm, lasting.driver, after.driver, "fetch", Json::object());
    expect_same(comm, lasting.driver, after.driver, "assign", {{"checksum", true}});
    expect_same(comm, lasting.driver, after.driver, "cuts", {{"list", "arrays"}});
    expect_same(comm, lasting.driver, after.driver, "error", Json::object());
    expect_same(comm, lasting.driver, after.driver, "counts", Json::object());
  });
}

INSTANTIATE_TEST_SUITE_P(Scenes, Restored,
                         ::testing::Combine(::testing::Values(Brought::plain, Brought::weights, Brought::ids),
                                            ::testing::Values(2, 3),
                                            ::testing::Values(Path::gateway, Path::direct, Path::listed, Path::held)));

TEST(RestoredScene, GoesOnWithAnotherNumberOfRanks) {
  if (!ranks_are_threads()) GTEST_SKIP() << "one rank's service beside that of all";
  on_ranks([](comm::Comm& comm) {
    Particles particles = particles_of(Brought::ids, 3);
    Lasting lasting(comm, std::make_shared<SimulatedStorage>(1));
    lasting.driver.create(kOptions);
    Lasting many(comm, std::make_shared<SimulatedStorage>(1));
    many.driver.create(kOptions);
    step_both(comm, lasting.driver, many.driver, particles, 0, 6);
    // The service of many ranks goes on with one, that of one with many.
    SelfComm self;
    Lasting one(self, copy_of(*many.storage));
    const scene::Restored restored = one.service.restore();
    if (comm.rank() == 0) {
      EXPECT_EQ(restored.scenes, 1U);
    }
    Particles same = particles;
    Lasting again(comm, copy_of(*(comm.rank() == 0 ? one : many).storage));
    again.service.restore();
    step_both(comm, lasting.driver, again.driver, particles, 6, 12);
    if (comm.rank() != 0) return;
    for (int step = 6; step < 12; ++step) {
      drift(same, 100 + static_cast<std::uint64_t>(step), 0.03);
      one.driver.step_seconds = 0.01 * (step % 3);
      EXPECT_TRUE(one.driver.push(same, step).status.ok());
    }
    const scene::Ledger* with_one = one.service.ledgers().find("s");
    const scene::Ledger* with_many = again.service.ledgers().find("s");
    EXPECT_EQ(with_one->now().hash, with_many->now().hash);
    EXPECT_EQ(with_one->now().loads->loads, with_many->now().loads->loads);
    EXPECT_EQ(with_one->now().epoch, with_many->now().epoch);
  });
}

// A scene of two steps, of which the ranks hold no particles.
struct Lacking {
  explicit Lacking(comm::Comm& comm, Brought kind = Brought::ids) : particles(particles_of(kind, 3)) {
    auto before = std::make_unique<Lasting>(comm, std::make_shared<SimulatedStorage>(1));
    before->driver.create({{"parts", 5}});
    for (const int step : {0, 1}) before->driver.push(particles, step);
    for (const char* command : {"cuts", "owner", "box", "neighbours"})
      known[command] = before->driver.ask(command, kQuestion).json;
    after.emplace(comm, copy_of(*before->storage));
    after->service.restore();
  }
  static inline const Json kQuestion{
      {"position", {0.4, 0.5, 0.6}}, {"lo", {0.1, 0.1, 0.1}}, {"hi", {0.5, 0.5, 0.5}}, {"width", 0.1}};
  Particles particles;
  std::map<std::string, Json> known;
  std::optional<Lasting> after;
};

TEST(RestoredScene, TellsOfItsCutsAndStepsBeforeItsParticlesCome) {
  on_ranks([](comm::Comm& comm) {
    Lacking scene(comm);
    Driver& driver = scene.after->driver;
    for (const auto& [command, known] : scene.known) {
      const Response told = driver.ask(command, Lacking::kQuestion);
      if (comm.rank() == 0) {
        EXPECT_EQ(told.json, known) << command << ": " << told.status.message();
      }
    }
    for (const char* command : {"assign", "fetch", "quality", "halo", "compare", "rebalance"}) {
      const Response told = driver.ask(command, Lacking::kQuestion);
      if (comm.rank() != 0) continue;
      EXPECT_EQ(told.status.code(), Code::not_found) << command;
      EXPECT_NE(told.status.message().find("since the service was started"), std::string::npos);
    }
    const Response shown = driver.ask("scene.show");
    if (comm.rank() != 0) return;
    EXPECT_EQ(shown.json["step"], 1);
    EXPECT_EQ(shown.json["filled"], false);
    EXPECT_TRUE(shown.json["positions_step"].is_null());
    EXPECT_GT(shown.json["rounds"], 0);
  });
}

TEST(RestoredScene, AnswersThePushOfItsLastStepAgain) {
  on_ranks([](comm::Comm& comm) {
    Lacking scene(comm);
    const Response again = scene.after->driver.push(scene.particles, 1);  // its answer was lost
    if (comm.rank() == 0) {
      EXPECT_EQ(again.json["repeated"], true);
    }
  });
}

TEST(RestoredScene, TakesItsParticlesWholeAndOnce) {
  on_ranks([](comm::Comm& comm) {
    Lacking scene(comm);
    Driver& driver = scene.after->driver;
    const auto refused = [&](const char* why, const Particles& particles, Code code) {
      const Response pushed = driver.push(particles, 2);
      const Response shown = driver.ask("scene.show");
      if (comm.rank() != 0) return;
      EXPECT_EQ(pushed.status.code(), code) << why << ": " << pushed.status.message();
      EXPECT_EQ(shown.json["filled"], false) << why;
    };
    Particles twins = scene.particles;
    twins.ids[0] = twins.ids[1];
    refused("an id twice", twins, Code::not_conserved);
    Particles other = scene.particles;
    other.ids[0] = 1;
    refused("another particle", other, Code::not_conserved);
    refused("twins of the same sum", with_twins_of_the_same_sum(scene.particles), Code::duplicate_id);
    Particles lost = scene.particles;
    lost.position[1][7] = std::numeric_limits<double>::quiet_NaN();
    refused("no number", lost, Code::not_finite);

    const Response pushed = driver.push(scene.particles, 2);
    const Response shown = driver.ask("scene.show");
    const Response history = driver.ask("history");
    if (comm.rank() != 0) return;
    ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
    EXPECT_TRUE(pushed.json["report"]["drifted"].is_null()) << "nobody knows";
    EXPECT_EQ(shown.json["filled"], true);
    EXPECT_EQ(history.json["total"], 3);
  });
}

TEST(RestoredScene, ThatHasNeverBeenPushedIsOneStill) {
  on_ranks([](comm::Comm& comm) {
    auto before = std::make_unique<Lasting>(comm, std::make_shared<SimulatedStorage>(1));
    before->driver.create({{"parts", 5}, {"dims", 2}, {"part_sizes", {1, 2, 3, 4, 5}}});
    Lasting after(comm, copy_of(*before->storage));
    after.service.restore();
    const Particles particles = particles_of(Brought::plain, 2);
    const Response pushed = after.driver.push(particles, 0);
    if (comm.rank() != 0) return;
    ASSERT_TRUE(pushed.status.ok()) << pushed.status.message();
    EXPECT_EQ(pushed.json["report"]["reason"], "first positions");
    EXPECT_LT(pushed.json["report"]["error"], 0.1);
  });
}

}  // namespace
}  // namespace rcb::testing
