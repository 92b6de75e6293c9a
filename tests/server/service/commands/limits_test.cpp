// What one request can cost: answers stay small whatever the number of parts, long commands end at their deadline or
// with their client and change nothing, an order tells of its own scene alone.
#include "common/wire/limits.hpp"

#include <cmath>
#include <filesystem>

#include <gtest/gtest.h>

#include "common/io/files/roots.hpp"
#include "server/api/commands.hpp"
#include "server/service/service.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

using service::OrderTerms;

TEST(Answers, OfManyPartsHaveTheirListsBesideTheJson) {
  if (!ranks_are_threads()) GTEST_SKIP() << "takes long where ranks are more than cores";
  static constexpr int kParts = 9000;
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "many", {{"parts", kParts}, {"dims", 2}, {"part_sizes", Json(std::vector<int>(kParts, 3))}});
    Particles particles = random_particles(5, 12'000, 2);
    particles.weights.assign(12'000, 1.5);
    particles.weights[0] = 2;
    driver.push(particles, 0);
    std::map<std::string, Response> answers;
    for (const api::CommandInfo& command : api::commands()) {
      if (command.effect != api::Effect::reads || command.runs_on == api::RunsOn::session) continue;
      Json arguments{{"position", {0.5, 0.5}}, {"lo", {-9, -9}}, {"hi", {9, 9}}, {"width", 1e-3}};
      if (command.name == "write_parts" || command.name == "scene.open") continue;
      answers[std::string(command.name)] = driver.ask(std::string(command.name), arguments);
    }
    answers["dry run"] = driver.ask("rebalance", {{"dry_run", true}});
    if (comm.rank() != 0) return;
    for (const auto& [name, answer] : answers) {
      SCOPED_TRACE(name);
      EXPECT_LE(wire::dump_json(answer.json).size(), 65536U);
      if (name != "cuts") {
        EXPECT_TRUE(answer.status.ok()) << answer.status.message();
      }
      EXPECT_LE(answer.arrays.size(), wire::kArraysMax);
    }
    EXPECT_EQ(answers["cuts"].status.code(), Code::too_large);
    for (const char* name : {"counts", "scene.show"}) {
      const Response& answer = answers[name];
      for (const char* list : {"counts", "targets", "loads"}) EXPECT_TRUE(answer.json.at(list).is_null()) << list;
      const auto counts = values_of<std::uint64_t>(answer, "counts");
      EXPECT_EQ(std::accumulate(counts.begin(), counts.end(), std::uint64_t{0}), 12'000U);
      EXPECT_EQ(counts.size(), std::size_t{kParts});
      EXPECT_EQ(values_of<double>(answer, "targets").size(), std::size_t{kParts});
      EXPECT_EQ(values_of<double>(answer, "loads").size(), std::size_t{kParts});
    }
    EXPECT_EQ(values_of<double>(answers["scene.show"], "part_sizes"), std::vector<double>(kParts, 3));
    EXPECT_EQ(values_of<std::int32_t>(answers["box"], "parts").size(), std::size_t{kParts});
    EXPECT_EQ(values_of<std::uint64_t>(answers["quality"], "ghosts").size(), std::size_t{kParts});
    EXPECT_EQ(values_of<std::int32_t>(answers["dry run"], "neighbours").size(), std::size_t{kParts});
    const wire::Array* areas = wire::find_array(answers["compare"].arrays, "interface_areas");
    ASSERT_NE(areas, nullptr);
    EXPECT_EQ(areas->shape, (std::vector<std::uint64_t>{5, kParts}));
    EXPECT_EQ(areas->bytes.size(), 5U * kParts * 8);
  });
}

TEST(Answers, PagesOfCutsAreTheWhole) {
  on_ranks([](comm::Comm& comm) {
    for (const int parts : {1, 2, 37, 128}) {
      OwnDriver driver(comm, "cut", {{"parts", parts}});
      driver.push(random_particles(7, 100, 3), 0);
      const Response whole = driver.ask("cuts");
      for (const char* list : {"cuts", "regions"}) {
        for (const int count : {1, 10, 1000}) {
          Json found = Json::array();
          for (Json from = 0; !from.is_null();) {
            const Response page = driver.ask("cuts", {{"list", list}, {"from", from}, {"count", count}});
            if (comm.rank() != 0) {
              const std::size_t items = static_cast<std::size_t>(list == std::string("cuts") ? parts - 1 : parts);
              from = from.get<std::size_t>() + static_cast<std::size_t>(count) < items
                         ? Json(from.get<std::size_t>() + static_cast<std::size_t>(count))
                         : Json();
              continue;
            }
            ASSERT_TRUE(page.status.ok()) << page.status.message();
            EXPECT_EQ(page.json["hash"], whole.json["hash"]);
            EXPECT_EQ(page.json["from"], from);
            EXPECT_LE(page.json[list].size(), static_cast<std::size_t>(count));
            found.insert(found.end(), page.json[list].begin(), page.json[list].end());
            from = page.json["next"];
          }
          if (comm.rank() == 0) {
            EXPECT_EQ(found, whole.json[list]) << list << " of " << parts << " by " << count;
          }
        }
      }
      for (const Json& wrong : {Json{{"list", "ties"}}, Json{{"from", 0}}, Json{{"list", "cuts"}, {"count", -1}}}) {
        const Response refused = driver.ask("cuts", wrong);
        if (comm.rank() == 0) {
          EXPECT_EQ(refused.status.code(), Code::invalid_argument) << wrong.dump();
        }
      }
    }
  });
}

// Answers every question of a long command whether to go on by counting.
TEST(LongCommands, EndAtTheirDeadlineOrWithTheirClientAndChangeNothing) {
  const std::string folder = (std::filesystem::temp_directory_path() / "rcb-limits-never-written").string();
  const auto roots = std::make_shared<io::Roots>();
  ASSERT_TRUE(roots->add(std::filesystem::temp_directory_path()).ok());
  on_ranks([&](comm::Comm& comm) {
    OwnDriver driver(comm, "long", {{"parts", 5}}, {.roots = roots});
    driver.push(random_particles(3, 500, 3), 0);
    const Response before = driver.ask("scene.show");
    const auto gone = std::make_shared<const std::atomic<bool>>(true);
    // Rank 0's word counts: the others are told nothing.
    const OrderTerms late{0, comm.rank() == 0 ? -1.0 : 1000.0};
    const OrderTerms left{0, 1000, comm.rank() == 0 ? gone : nullptr};
    for (const Json& request :
         {Json{{"command", "compare"}}, Json{{"command", "quality"}}, Json{{"command", "fetch"}},
          Json{{"command", "assign"}}, Json{{"command", "halo"}, {"width", 1}},
          Json{{"command", "rebalance"}, {"parts", 4}}, Json{{"command", "rebalance"}, {"dry_run", true}},
          Json{{"command", "write_parts"}, {"directory", folder}, {"prefix", "p"}}}) {
      SCOPED_TRACE(request.dump());
      Json order = request;
      order["scene"] = "long";
      const Response at_deadline = driver.service.execute(order, {}, late);
      const Response without_client = driver.service.execute(order, {}, left);
      if (comm.rank() != 0) continue;
      EXPECT_EQ(at_deadline.status.code(), Code::deadline_exceeded) << at_deadline.status.message();
      EXPECT_EQ(without_client.status.code(), Code::aborted) << without_client.status.message();
    }
    const Response after = driver.ask("scene.show");
    if (comm.rank() == 0) {
      EXPECT_EQ(after.json, before.json);
    }
    std::filesystem::remove_all(folder);
  });
}

TEST(LongCommands, ALoadIsGivenUpBeforeItsCommit) {
  if (!ranks_are_threads()) GTEST_SKIP() << "the file is of one process";
  const std::string path = std::string(std::filesystem::temp_directory_path() / "rcb-limits-load-XXXXXX");
  std::string file = path;
  const int made = ::mkstemp(file.data());
  ASSERT_GE(made, 0);
  const std::string text = "x,y,z\n0,0,0\n1,2,3\n4,5,6\n";
  ASSERT_EQ(::write(made, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  ::close(made);
  const auto roots = std::make_shared<io::Roots>();
  ASSERT_TRUE(roots->add(std::filesystem::temp_directory_path()).ok());
  on_ranks([&](comm::Comm& comm) {
    OwnDriver driver(comm, "load", {{"parts", 2}}, {.roots = roots});
    const Json order{{"command", "load"}, {"scene", "load"}, {"path", file}};
    const Response late = driver.service.execute(order, {}, {0, -1});
    if (comm.rank() == 0) {
      EXPECT_EQ(late.status.code(), Code::deadline_exceeded) << late.status.message();
    }
    const Response counts = driver.ask("counts");
    if (comm.rank() == 0) {
      EXPECT_EQ(counts.status.code(), Code::not_found);
    }
    const Response loaded = driver.service.execute(order);
    if (comm.rank() == 0) {
      EXPECT_TRUE(loaded.status.ok()) << loaded.status.message();
    }
  });
  std::filesystem::remove(file);
}

TEST(Compare, TakesEachMethodOnce) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "c", {{"parts", 3}});
    driver.push(random_particles(3, 50, 3), 0);
    const Response twice = driver.ask("compare", {{"methods", Json(std::vector<std::string>(5000, "rcb"))}});
    const Response long_name = driver.ask("compare", {{"methods", {std::string(1 << 20, 'x')}}});
    const Response once = driver.ask("compare", {{"methods", {"rcb", "bands-x"}}});
    if (comm.rank() != 0) return;
    EXPECT_EQ(twice.status.code(), Code::invalid_argument);
    EXPECT_NE(twice.status.message().find("'rcb' stands twice"), std::string::npos) << twice.status.message();
    EXPECT_EQ(long_name.status.code(), Code::invalid_argument);
    EXPECT_LT(long_name.status.message().size(), 300U);
    EXPECT_EQ(once.json["methods"].size(), 2U);
  });
}

TEST(Scenes, AllTogetherHaveALimitOfParts) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    const auto scenes = static_cast<int>(wire::kPartsTotalMax / wire::kPartsMax);
    for (int k = 0; k <= scenes; ++k) {
      const Response made = Driver(comm, service, "s" + std::to_string(k)).create({{"parts", wire::kPartsMax}});
      if (comm.rank() == 0) {
        EXPECT_EQ(made.status.code(), k < scenes ? Code::ok : Code::too_large) << k;
      }
    }
    Driver last(comm, service, "s" + std::to_string(scenes - 1));
    const Response same = last.create({{"parts", wire::kPartsMax}, {"replace", true}});
    const Response fewer = last.create({{"parts", 4}, {"replace", true}});
    const Response another = Driver(comm, service, "t").create({{"parts", wire::kPartsMax - 4}});
    last.push(random_particles(1, 9, 3), 0);
    const Response grown = last.ask("rebalance", {{"parts", 5}});
    if (comm.rank() != 0) return;
    EXPECT_TRUE(same.status.ok() && fewer.status.ok() && another.status.ok());
    EXPECT_EQ(grown.status.code(), Code::too_large);
  });
}

// However many scenes there are, an order tells of one.
TEST(Scenes, AnOrderTellsOfItsOwnSceneAlone) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    std::vector<Driver> drivers;
    for (int k = 0; k < 30; ++k) drivers.emplace_back(comm, service, "s" + std::to_string(k));
    for (Driver& driver : drivers) driver.create({{"parts", 2}});
    const Response pushed = drivers[7].push(random_particles(1, 40, 3), 4);
    const Response asked = drivers[7].ask("counts");
    Particles bad = random_particles(1, 40, 3);
    bad.position[0][3] = std::nan("");
    const Response refused = drivers[7].push(bad, 5);
    const Response dropped = drivers[7].ask("scene.drop");
    if (comm.rank() != 0) {
      EXPECT_FALSE(pushed.change);
      return;
    }
    ASSERT_TRUE(pushed.change && std::holds_alternative<scene::Stepped>(pushed.change->event));
    EXPECT_EQ(pushed.change->scene, "s7");
    const auto& stepped = std::get<scene::Stepped>(pushed.change->event);
    EXPECT_EQ(stepped.report.step, 4);
    EXPECT_EQ(stepped.held.n, 40U);
    EXPECT_FALSE(asked.change);
    EXPECT_FALSE(refused.change || refused.status.ok());
    ASSERT_TRUE(dropped.change);
    EXPECT_EQ(dropped.change->scene, "s7");
    EXPECT_TRUE(std::holds_alternative<scene::Dropped>(dropped.change->event));
  });
}

}  // namespace
}  // namespace rcb::testing
