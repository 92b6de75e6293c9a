// The shared loop and the command line: what is pushed, in which order, and what is said about it.
#include "client/solvers/drive.hpp"

#include <cmath>
#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace rcb::solvers {
namespace {

using nlohmann::json;

class TickingClock final : public Clock {
 public:
  double seconds() const override { return ticks_ += 1; }

 private:
  mutable double ticks_ = 0;
};

class StillClock final : public Clock {
 public:
  double seconds() const override { return 0; }
};

Simulation spheres(std::uint64_t points) {
  TwoSpheresOptions options;
  options.points = points;
  return make_two_spheres(options).value();
}

client::StepReport report_of(std::int64_t step, double before, double after, bool repartitioned) {
  client::StepReport report;
  report.step = step;
  if (step > 0) report.error_before = before;
  report.error = after;
  report.repartitioned = repartitioned;
  report.json = json{{"step", step}, {"error", after}}.dump();
  return report;
}

struct FrameSink final : io::TrajectoryWriter {
  Status append(std::span<const double> positions) override {
    frames.emplace_back(positions.begin(), positions.end());
    return {};
  }
  Status close() override { return {}; }
  std::vector<std::vector<double>> frames;
};

TEST(StepLoop, PushesStepZeroAndThenEveryStep) {
  Simulation simulation = spheres(20);
  FrameSink sink;
  StepLoop loop;
  std::vector<std::int64_t> steps;
  std::vector<double> first_x;
  loop.trajectory = &sink;
  loop.push = [&](std::int64_t step, const client::Positions& positions,
                  std::optional<double> seconds) -> Result<client::StepReport> {
    EXPECT_EQ(positions.count, 20U);
    EXPECT_EQ(positions.dims, 3);
    EXPECT_EQ(seconds, step > 0 ? std::optional(1.0) : std::nullopt) << "nothing was computed before step 0";
    steps.push_back(step);
    first_x.push_back(positions.axis[0][0]);
    return report_of(step, 0.3, 0.05, step % 2 == 0);
  };
  RunRecord record;
  ASSERT_TRUE(run_steps(simulation, 4, loop, TickingClock{}, record).ok());
  EXPECT_EQ(steps, (std::vector<std::int64_t>{0, 1, 2, 3, 4}));
  EXPECT_EQ(record.reports.size(), 5U);
  EXPECT_EQ(record.repartitions(), 3U);
  EXPECT_EQ(record.largest_error()->error, 0.3);
  EXPECT_EQ(record.largest_error()->step, 1);
  EXPECT_EQ(record.steps_done, 4);
  ASSERT_EQ(sink.frames.size(), 5U);
  for (std::size_t k = 0; k < 5; ++k) {
    EXPECT_EQ(sink.frames[k].size(), 60U);
    EXPECT_EQ(sink.frames[k][0], first_x[k]) << "the frame is what was pushed";
  }
  EXPECT_EQ(first_x[0], spheres(20).mpm.position(0)[0]) << "step 0 is the start, before any motion";
  EXPECT_NE(first_x[0], first_x[1]);
  EXPECT_EQ(sink.frames[4][5], simulation.mpm.position(2)[1]) << "rows of x, y, z";
}

TEST(StepLoop, EndsAtTheFirstFailureAndSaysWhere) {
  Simulation simulation = spheres(20);
  StepLoop loop;
  loop.push = [](std::int64_t step, const client::Positions&, std::optional<double>) -> Result<client::StepReport> {
    if (step == 2) return Status(Code::deadline_exceeded, "no answer in 60 s", "wait longer");
    return report_of(step, 0, 0, false);
  };
  RunRecord record;
  const Status status = run_steps(simulation, 10, loop, StillClock{}, record);
  EXPECT_EQ(status.code(), Code::deadline_exceeded);
  EXPECT_EQ(status.message(), "step 2: no answer in 60 s");
  EXPECT_EQ(status.hint(), "wait longer");
  EXPECT_EQ(record.steps_done, 1);
}

TEST(StepLoop, EndsWhenInterrupted) {
  Simulation simulation = spheres(20);
  StepLoop loop;
  int asked = 0;
  loop.interrupted = [&] { return ++asked > 3; };
  RunRecord record;
  EXPECT_EQ(run_steps(simulation, 10, loop, StillClock{}, record).code(), Code::aborted);
  EXPECT_EQ(record.steps_done, 2);
}

TEST(Documents, CarryWhatWasPromised) {
  Program program;
  program.name = "two_spheres";
  RunOptions options;
  options.points = 20;
  options.steps = 1;
  options.scene = "s";
  options.tolerance = HUGE_VAL;
  RunRecord record;
  record.steps_done = 1;
  record.reports = {report_of(0, 0, 0.1, true), report_of(1, 0.2, 0.2, false)};
  json document = json::parse(json_document(program, options, record));
  EXPECT_EQ(document["scene"], "s");
  EXPECT_EQ(document["solver"], "two_spheres");
  EXPECT_EQ(document["points"], 20);
  EXPECT_EQ(document["steps"], 1);
  EXPECT_EQ(document["parts"], 8);
  EXPECT_EQ(document["tolerance"], "inf");
  EXPECT_EQ(document["positions"], "every-step");
  EXPECT_EQ(document["repartitions"], 1);
  EXPECT_EQ(document["error_max"], 0.2);
  ASSERT_EQ(document["reports"].size(), 2U);
  EXPECT_EQ(document["reports"][1], (json{{"step", 1}, {"error", 0.2}}));
  EXPECT_TRUE(document["momentum"].contains("drift"));
  EXPECT_TRUE(document["energy"].contains("growth"));
  EXPECT_NE(summary(program, options, 0.1, record).find("0.2 at step 1"), std::string::npos);

  EXPECT_TRUE(document["runout"].is_null());
  record.runout = RunRecord::RunOut{40, 39, 59};
  EXPECT_EQ(json::parse(json_document(program, options, record))["runout"],
            (json{{"length", 40.0}, {"front_start", 39.0}, {"front_end", 59.0}, {"relative", 0.5}}));
  EXPECT_NE(summary(program, options, 0.1, record).find("20 m, 0.5 of the initial length of 40 m"), std::string::npos);

  options.tolerance = 0.25;
  options.no_service = true;
  record.reports.clear();
  document = json::parse(json_document(program, options, record));
  EXPECT_EQ(document["tolerance"], 0.25);
  EXPECT_TRUE(document["repartitions"].is_null());
  EXPECT_TRUE(document["error_max"].is_null());
  EXPECT_EQ(document["reports"], json::array());

  document = json::parse(failure_document({Code::unavailable, "nobody", "rcbctl up"}));
  EXPECT_EQ(document,
            (json{{"failure", {{"code", "unavailable"}, {"message", "nobody"}, {"hint", "rcbctl up"}, {"exit", 3}}}}));
}

TEST(Numbers, InAnySpelling) {
  EXPECT_EQ(parse_number("-.5").value(), -0.5);
  EXPECT_EQ(parse_number("+1e3").value(), 1000);
  EXPECT_TRUE(std::isinf(parse_number("inf").value()));
  for (const char* bad : {"", "nan", "1x", " 1", "0x10", "--1", "+", "1e999999"})
    EXPECT_FALSE(parse_number(bad).ok()) << bad;
  EXPECT_EQ(parse_whole("1e6", 1, 2'000'000).value(), 1'000'000);
  for (const char* bad : {"0", "1.5", "inf", "2000001", "-3"}) EXPECT_FALSE(parse_whole(bad, 1, 2'000'000).ok()) << bad;
}

struct Outcome {
  int exit;
  std::string out;
  std::string err;
};

Outcome run(std::initializer_list<std::string> arguments) {
  TwoSpheresOptions scene;
  Program program;
  program.name = "two_spheres";
  program.version = "1.2.3";
  program.description = "test";
  program.defaults.points = 30;
  program.defaults.steps = 2;
  program.defaults.scene = "test";
  program.numbers = {{"--speed", "m/s", &scene.speed}};
  program.build = [&scene](std::uint64_t points) {
    scene.points = points;
    return make_two_spheres(scene);
  };
  std::vector<std::string> words{"two_spheres"};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  const int code = run_program(program, static_cast<int>(argv.size()), argv.data());
  std::fflush(stdout);
  return {code, ::testing::internal::GetCapturedStdout(), ::testing::internal::GetCapturedStderr()};
}

TEST(CommandLine, RunsWithoutAService) {
  const Outcome outcome = run({"--no-service", "--json", "--points", "1e2", "--speed", "2.5"});
  EXPECT_EQ(outcome.exit, 0) << outcome.err;
  EXPECT_EQ(outcome.err, "");
  const json document = json::parse(outcome.out);
  EXPECT_EQ(document["points"], 100);
  EXPECT_EQ(document["steps"], 2);
  EXPECT_LE(document["momentum"]["drift"].get<double>(), 1e-12);
}

TEST(CommandLine, WrongUsageIsTwoOnBothStreams) {
  for (const auto& words : std::vector<std::pair<std::string, std::string>>{{"--points", "0"},
                                                                            {"--points", "1"},
                                                                            {"--points", "1.5"},
                                                                            {"--steps", "-1"},
                                                                            {"--parts", "0"},
                                                                            {"--tolerance", "-.5"},
                                                                            {"--tolerance", "nan"},
                                                                            {"--deadline", "0"},
                                                                            {"--positions", "never"},
                                                                            {"--speed", "inf"},
                                                                            {"--speed", "fast"},
                                                                            {"--unknown", "1"}}) {
    const Outcome outcome = run({"--no-service", "--json", words.first, words.second});
    EXPECT_EQ(outcome.exit, 2) << words.first << " " << words.second;
    const json failure = json::parse(outcome.out)["failure"];
    EXPECT_EQ(failure["code"], "usage");
    EXPECT_EQ(failure["exit"], 2);
    EXPECT_NE(outcome.err.find(failure["message"].get<std::string>()), std::string::npos);
    EXPECT_EQ(run({"--no-service", words.first, words.second}).out, "");
  }
}

TEST(CommandLine, PhysicsThatFailsIsOne) {
  const Outcome outcome = run({"--no-service", "--json", "--speed", "1e4", "--steps", "20", "--points", "500"});
  EXPECT_EQ(outcome.exit, 1) << outcome.out;
  EXPECT_TRUE(json::parse(outcome.out).contains("failure"));
}

TEST(CommandLine, NobodyThereIsThree) {
  const Outcome outcome = run({"--json", "--endpoint", "unix:/nonexistent/rcbd.sock"});
  EXPECT_EQ(outcome.exit, 3) << outcome.out;
  EXPECT_EQ(json::parse(outcome.out)["failure"]["code"], "unavailable");
}

TEST(CommandLine, HelpAndVersion) {
  EXPECT_EQ(run({"--version"}).out, "two_spheres 1.2.3\n");
  const Outcome help = run({"--help"});
  EXPECT_EQ(help.exit, 0);
  for (const char* word : {"--points", "--steps", "--parts", "--tolerance", "--scene", "--endpoint", "--trajectory",
                           "--json", "--no-service", "--speed", "Exit codes"})
    EXPECT_NE(help.out.find(word), std::string::npos) << word;
}

}  // namespace
}  // namespace rcb::solvers
