// The table of commands: what may come from a client, and what each command may do.
#include "server/api/commands.hpp"

#include <set>

#include <gtest/gtest.h>

namespace rcb::api {
namespace {

using wire::Json;

TEST(Commands, HaveOneEntryEach) {
  std::set<std::string_view> names;
  for (const CommandInfo& command : commands()) {
    EXPECT_TRUE(names.insert(command.name).second) << command.name;
    EXPECT_EQ(find_command(command.name), &command);
    EXPECT_EQ(std::set(command.fields.begin(), command.fields.end()).size(), command.fields.size()) << command.name;
  }
  for (const char* inside : {"push.begin", "plan", "", "push.slice"}) EXPECT_EQ(find_command(inside), nullptr);
}

TEST(Commands, NoFieldOfTheInsideIsKept) {
  for (const CommandInfo& command : commands()) {
    Json request{{"command", command.name},  {"deadline_seconds", 1}, {"blocks", 1}, {"unmoved", {1}}, {"seat", {}},
                 {"unknown", Json::object()}};
    for (const std::string_view field : command.fields) request[std::string(field)] = 1;
    keep_known_fields(request, command);
    EXPECT_EQ(request.size(), command.fields.size() + 2) << request;
    EXPECT_FALSE(request.contains("blocks"));
  }
}

TEST(Commands, ADryRunReads) {
  const CommandInfo& rebalance = *find_command("rebalance");
  EXPECT_TRUE(changes_scene({{"dry_run", false}}, rebalance));
  EXPECT_TRUE(changes_scene({{"dry_run", "yes"}}, rebalance));  // which the service refuses
  EXPECT_FALSE(changes_scene({{"dry_run", true}}, rebalance));
  EXPECT_FALSE(changes_scene(Json::object(), *find_command("quality")));
}

TEST(Commands, WhatChangesASceneRunsOnAllRanks) {
  for (const CommandInfo& command : commands())
    if (command.effect == Effect::changes) {
      EXPECT_NE(command.runs_on, RunsOn::root) << command.name;
    }
}

}  // namespace
}  // namespace rcb::api
