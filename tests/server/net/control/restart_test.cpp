// A service that is started where an earlier one has left its scenes: they are there before anybody is let in, told of
// by the ledger, and lack particles until the next step brings them.
#include <gtest/gtest.h>

#include "common/wire/count_record.hpp"
#include "tests/server/net/harness.hpp"
#include "tests/server/scene/model.hpp"

namespace rcb::net::testing {
namespace {

using wire::FrameType;
using wire::Json;

// Of two dimensions, without weights and ids.
rcb::testing::World plain_world(Random& random) {
  for (;;)
    if (rcb::testing::World world(random);
        world.dims == 2 && !world.set.has_weights && world.next_id == static_cast<particles::Id>(world.set.count()))
      return world;
}

class Restart : public ::testing::Test {
 protected:
  // An earlier service has left a scene of so many steps, from 0 on, which anna made.
  void leave(const std::string& name, int steps, scene::Travel positions = scene::Travel::every_step) {
    scene::Ledgers ledgers(keeping());
    Random random(7);
    rcb::testing::World world = plain_world(random);
    scene::SceneOptions options;
    options.dims = 2;
    options.parts = 4;
    options.positions = positions;
    rcb::testing::Ranks ranks(options);
    ledgers.take({name, scene::Created{options, {}}}, 0xabc);
    for (int step = 0; step < steps; ++step) {
      scene::Stepped stepped = ranks.push(world.set, step, ledgers.find(name)->terms({}));
      stepped.sessions = {scene::session_key(kAnna)};
      hash_ = wire::hex64(stepped.held.hash);
      ledgers.take({name, std::move(stepped)}, 0);
      world.move(random);
    }
    n_ = world.set.count();
  }
  scene::Keeping keeping() const { return {20, scene::disk_storage(), directory_.path()}; }
  std::unique_ptr<TestService> start(int orders_max = wire::kOrdersMax) const {
    return std::make_unique<TestService>([this, orders_max](ControlOptions& options) {
      options.keeping = keeping();
      options.orders_max = orders_max;
    });
  }
  static std::vector<std::string> scenes_in(Client& client) {
    std::vector<std::string> names;
    const Received list = client.call("scene.list");
    for (const Json& scene : list.json.at("scenes")) names.push_back(scene["scene"]);
    return names;
  }
  // The code that a push of "s" is refused with.
  std::string refused(Client& client, std::int64_t step, std::uint64_t n, const Json& more) const {
    client.push(step, n, more);
    return client.receive_but_notices().code();
  }
  Json show(Client& client) const { return client.call("scene.show", {{"scene", "s"}}).json; }

  Directory directory_;
  std::uint64_t n_ = 0;
  std::string hash_;
};

TEST_F(Restart, BringsTheScenesBackBeforeAnybodyIsLetIn) {
  leave("a", 3);
  leave("never", 0);
  leave("s", 5);
  const auto service = start();
  Client client = service->client("c");
  EXPECT_EQ(scenes_in(client), (std::vector<std::string>{"a", "never", "s"}));
  const Json shown = show(client);
  EXPECT_EQ(service->engine().executed(), std::vector<std::string>(3, "scene.restore"));
  EXPECT_EQ(client.call("status").json["restored"], (Json{{"scenes", 3}, {"steps", 8}, {"lost_records", 0}}));
  EXPECT_EQ(shown["step"], 4);
  EXPECT_EQ(shown["n"], n_);
  EXPECT_EQ(shown["hash"], hash_);
  EXPECT_EQ(shown["incarnation"], wire::hex64(0xabc));
  EXPECT_EQ(shown["filled"], false);
  EXPECT_TRUE(shown["positions_step"].is_null());
  const Json order = service->engine().request();
  EXPECT_EQ(order["scene"], "s");
  EXPECT_EQ(order["epoch"], shown["epoch"]);
  EXPECT_EQ(order["n"], n_);
  std::vector<std::string> arrays;
  const std::vector<Slice> slices = service->engine().slices();
  for (const wire::Array& array : slices.at(0).arrays) arrays.push_back(array.name);
  EXPECT_EQ(arrays, (std::vector<std::string>{"axes", "at", "id"}));
  const Json history = client.call("history", {{"scene", "s"}}).json;
  EXPECT_EQ(history["total"], 5);
  EXPECT_EQ(history["lost"], 0);
  for (int step = 0; step < 5; ++step) EXPECT_EQ(history["history"][static_cast<std::size_t>(step)]["step"], step);
  EXPECT_EQ(client.call("error", {{"scene", "s"}}).json["step"], 4);
  EXPECT_EQ(client.call("counts", {{"scene", "s"}}).json["counts"], shown["counts"]);
}

TEST_F(Restart, BringsBackMoreScenesThanThereMayBeOrders) {
  for (int k = 0; k < 9; ++k) leave("s" + std::to_string(k), 1);
  const auto service = start(2);
  Client client = service->client("c");
  EXPECT_EQ(scenes_in(client).size(), 9U);
  for (int k = 0; k < 9; ++k) {
    const Received shown = client.call("scene.show", {{"scene", "s" + std::to_string(k)}});
    EXPECT_EQ(shown.json["step"], 0) << shown.message();
  }
  EXPECT_EQ(service->engine().executed(), std::vector<std::string>(9, "scene.restore"));
}

TEST_F(Restart, LeavesOutWhatTheRanksCannotHoldAndKeepsIt) {
  leave("a", 1);
  leave("refused", 2);
  for (int start_of = 0; start_of < 2; ++start_of) {
    const auto service = start();
    Client client = service->client("c");
    client.call("fetch", {{"scene", "n1"}});  // orders before it are done
    EXPECT_EQ(client.call("scene.show", {{"scene", "refused"}}).code(), "not_found");
    EXPECT_EQ(scenes_in(client), std::vector<std::string>{"a"});
    EXPECT_EQ(client.call("status").json["restored"], (Json{{"scenes", 1}, {"steps", 1}, {"lost_records", 0}}));
    EXPECT_EQ(service->engine().executed().at(1), "scene.restore");
  }
}

TEST_F(Restart, BringsBackNothingThatWasDropped) {
  leave("s", 2);
  {
    const auto service = start();
    Client client = service->client("c");
    EXPECT_EQ(client.call("scene.drop", {{"scene", "s"}}).type, FrameType::reply);
    EXPECT_EQ(client.call("scene.create", {{"scene", "made"}, {"parts", 4}, {"dims", 2}}).type, FrameType::reply);
  }
  const auto service = start();
  Client client = service->client("c", kAnna);
  EXPECT_EQ(scenes_in(client), std::vector<std::string>{"made"});
  const Json shown = client.call("scene.show", {{"scene", "made"}}).json;
  EXPECT_TRUE(shown["step"].is_null());
  client.push(0, 10, {{"scene", "made"}});
  EXPECT_EQ(client.receive_but_notices().json["report"]["step"], 0);
}

TEST_F(Restart, TakesAStepAsIfNothingHadBeen) {
  leave("s", 5);
  const auto service = start();
  Client client = service->client("c", kAnna);
  EXPECT_EQ(refused(client, 5, n_ + 1, Json::object()), "not_conserved");
  EXPECT_EQ(refused(client, 5, n_, {{"incarnation", wire::hex64(0xabd)}}), "not_found");
  EXPECT_EQ(refused(client, 3, n_, Json::object()), "stale_step");
  client.push(4, n_);  // its answer may have been lost
  const Received again = client.receive_but_notices();
  EXPECT_EQ(again.json["repeated"], true) << again.message();
  EXPECT_EQ(again.json["report"]["step"], 4);
  EXPECT_EQ(service->engine().executed(), std::vector<std::string>{"scene.restore"});
  client.push(5, n_, {{"incarnation", wire::hex64(0xabc)}});
  EXPECT_EQ(client.receive_but_notices().json["report"]["step"], 5);
  const Json after = show(client);
  EXPECT_EQ(after["filled"], true);
  EXPECT_EQ(after["positions_step"], 5);
}

TEST_F(Restart, HasACountSentThatNoPositionsAreBehind) {
  leave("s", 3, scene::Travel::when_needed);
  const auto service = start();
  Client client = service->client("c", kAnna);
  const auto count = [&](std::int64_t step) {
    const Json shown = show(client);
    wire::CountRecord record{step, 0xabc, shown["epoch"], *wire::parse_hex64(hash_), n_};
    record.parts = {0};
    record.counts = {n_};
    client.send(FrameType::request, {{"command", "count"}, {"scene", "s"}}, encode(record));
    return client.receive_but_notices().json;
  };
  EXPECT_NE(count(3).value("send", "").find("since the service was started"), std::string::npos);
  EXPECT_EQ(count(2)["repeated"], true);
  client.push(3, n_);
  EXPECT_EQ(client.receive_but_notices().json["report"]["step"], 3);
}

}  // namespace
}  // namespace rcb::net::testing
