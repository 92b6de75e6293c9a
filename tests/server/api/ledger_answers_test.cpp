// What rank 0 answers from a ledger alone: pages of step reports, and steps that are repeated, of which older reports
// are read from a journal.
#include "server/api/ledger_answers.hpp"

#include <chrono>
#include <filesystem>
#include <future>
#include <new>

#include <gtest/gtest.h>

#include "tests/support/directory.hpp"

namespace rcb::api {
namespace {

using rcb::testing::DirectoryTest;
using wire::Json;

// The answer with what is read beside the engine; a failure where that doesn't come in time.
Answer whole_of(Answer answer) {
  const auto whole = std::make_shared<std::promise<Answer>>();
  auto coming = whole->get_future();
  complete(std::move(answer), [whole](Answer given) { whole->set_value(std::move(given)); });
  if (coming.wait_for(std::chrono::seconds(60)) == std::future_status::ready) return coming.get();
  return failed({Code::internal, "no answer"});
}

// A scene that one client steps; a step here is its report alone.
class StillScene {
 public:
  StillScene(std::size_t keep_reports, const std::string& directory)
      : ledgers_({keep_reports, scene::disk_storage(), directory}) {
    ledgers_.take({"still", scene::Created{}}, 1);
    step(0);
  }
  void step(std::int64_t step) {
    scene::Stepped stepped;
    stepped.report.step = step;
    stepped.sessions = {scene::session_key("s")};
    stepped.held.loads = std::make_shared<const partition::LoadSummary>();
    ledgers_.take({"still", std::move(stepped)}, 0);
  }
  Answer ask(const std::string& command, Json arguments = Json::object()) const {
    arguments["command"] = command;
    return whole_of(answer_from(ledger(), arguments, 1));
  }
  const scene::Ledger& ledger() const { return *ledgers_.find("still"); }

 private:
  scene::Ledgers ledgers_;
};

class LedgerAnswers : public DirectoryTest {};

std::vector<std::int64_t> numbers_in(std::int64_t from, std::int64_t to) {
  std::vector<std::int64_t> numbers;
  for (; from < to; ++from) numbers.push_back(from);
  return numbers;
}

TEST_F(LedgerAnswers, OneThatCouldNotBeFilledIsAFailure) {
  StillScene still(8, directory_);
  for (int step = 1; step < 100; ++step) still.step(step);
  const Answer answer = whole_of(
      with_reports(still.ledger(), 0, 100, [](scene::FoundReports, const Answer&) { throw std::bad_alloc(); }));
  EXPECT_EQ(answer.status.code(), Code::too_large);
}

TEST_F(LedgerAnswers, PagesAreTheWholeAndTheWholeIsRefusedWhereItIsLong) {
  StillScene still(100, directory_);
  constexpr int kSteps = 5000;
  for (int step = 1; step < kSteps; ++step) still.step(step);

  const Answer whole = still.ask("history");
  EXPECT_EQ(whole.status.code(), Code::too_large);
  EXPECT_NE(whole.status.hint().find("count"), std::string::npos);
  EXPECT_EQ(still.ask("history", {{"last", 4097}}).status.code(), Code::too_large);
  EXPECT_EQ(still.ask("history", {{"last", 4096}}).json["history"].size(), 4096U);
  EXPECT_EQ(still.ask("history", {{"last", 3}}).json["history"][0]["step"], kSteps - 3);
  EXPECT_EQ(still.ask("history", {{"last", 0}}).json["history"], Json::array());

  for (const Json& arguments : {Json{{"count", 1000}}, Json{{"from", 0}}, Json{{"last", 2000}, {"count", 777}}}) {
    SCOPED_TRACE(arguments.dump());
    std::vector<std::int64_t> found;
    Json asked = arguments;
    for (Json next = 0; !next.is_null();) {
      const Answer page = still.ask("history", asked);
      ASSERT_TRUE(page.status.ok()) << page.status.message();
      EXPECT_EQ(page.json["total"], kSteps);
      EXPECT_EQ(page.json["lost"], 0);
      for (const Json& report : page.json["history"]) found.push_back(report["step"].get<std::int64_t>());
      next = page.json["next"];
      asked = {{"from", next}, {"count", arguments.value("count", 100000)}};
    }
    EXPECT_EQ(found, numbers_in(arguments.contains("last") ? kSteps - 2000 : 0, kSteps));
  }
  EXPECT_EQ(still.ask("history", {{"from", 1}, {"last", 1}}).status.code(), Code::invalid_argument);
  EXPECT_EQ(still.ask("history", {{"count", 0}}).status.code(), Code::invalid_argument);
  const Answer beyond = still.ask("history", {{"from", kSteps + 5}});
  EXPECT_TRUE(beyond.json["history"].empty());
  EXPECT_TRUE(beyond.json["next"].is_null());
}

TEST_F(LedgerAnswers, TheLastStepIsAnsweredAgain) {
  StillScene still(1, directory_);
  for (int step = 1; step < 5; ++step) still.step(step);
  std::filesystem::remove_all(at("scenes"));
  const auto again = wire::parse_json(repeated(still.ledger()));
  ASSERT_TRUE(again.ok());
  EXPECT_EQ((*again)["repeated"], true);
  EXPECT_EQ((*again)["report"]["step"], 4);
}

}  // namespace
}  // namespace rcb::api
