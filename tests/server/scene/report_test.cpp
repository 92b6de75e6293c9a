// Reports as text: the JSON of all fields, of the types that they have.
#include "server/scene/report.hpp"

#include <bit>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "common/base/random.hpp"

namespace rcb::testing {
namespace {

using scene::StepReport;
using wire::Json;

// What a reader makes of it, who takes no field twice.
Json read(const StepReport& report) {
  const auto json = wire::parse_json(text_of(report));
  EXPECT_TRUE(json.ok()) << json.status().message() << text_of(report);
  return json.ok() ? *json : Json();
}

StepReport full_report() {
  StepReport report;
  report.bytes = 1;
  report.drifted = 2;
  report.moved = 3;
  report.migrated = 4;
  report.scanned = 5;
  report.searched = 6;
  report.rounds = 7;
  report.reductions = std::numeric_limits<std::uint64_t>::max();
  report.seconds = {0.5, 1, 1e-7, 2.5e200, 0};
  report.scene = "jet";
  report.step = std::numeric_limits<std::int64_t>::max() - 1;
  report.epoch = 8;
  report.n = 9;
  report.parts = 10;
  report.error_before = 0.1;
  report.error = 2;
  report.imbalance = 1e16;
  report.repartitioned = true;
  report.reason = "\"quotes\", a \\ and a\nline";
  report.axes_flipped = 11;
  report.inserted = 12;
  report.removed = 13;
  report.weights_as_zero = 14;
  report.skipped.add(scene::Skip::weights);
  report.skipped.add(scene::Skip::double_precision);
  report.way = scene::Way::shared_memory;
  report.positions_step = 15;
  report.strangers = 16;
  return report;
}

TEST(Report, IsTheJsonOfItsFields) {
  const Json seconds{{"receive", 0.5}, {"exchange", 1.0}, {"search", 1e-7}, {"migrate", 2.5e200}, {"total", 0.0}};
  Json expected{{"bytes", 1},
                {"drifted", 2},
                {"moved", 3},
                {"migrated", 4},
                {"scanned", 5},
                {"searched", 6},
                {"rounds", 7},
                {"reductions", std::numeric_limits<std::uint64_t>::max()},
                {"seconds", seconds},
                {"scene", "jet"},
                {"step", std::numeric_limits<std::int64_t>::max() - 1},
                {"epoch", 8},
                {"n", 9},
                {"parts", 10},
                {"error_before", 0.1},
                {"error", 2.0},
                {"imbalance", 1e16},
                {"repartitioned", true},
                {"reason", "\"quotes\", a \\ and a\nline"},
                {"axes_flipped", 11},
                {"inserted", 12},
                {"removed", 13},
                {"weights_as_zero", 14},
                {"skipped", {"weights", "double precision"}},
                {"way", "shared-memory"},
                {"sent", true},
                {"positions_step", 15},
                {"strangers", 16}};
  StepReport report = full_report();
  EXPECT_EQ(read(report).dump(), expected.dump());  // 2 and 2.0 differ as texts alone
  EXPECT_EQ(to_json(report), expected);
  report.way = scene::Way::count;
  report.repartitioned = false;
  report.skipped = {};
  report.error_before.reset();
  report.positions_step.reset();
  report.drifted_known = false;
  report.weights_as_zero = 0;
  expected.update({{"way", "count"}, {"sent", false}, {"repartitioned", false}, {"skipped", Json::array()}});
  expected.update({{"error_before", nullptr}, {"positions_step", nullptr}, {"drifted", nullptr}});
  expected.erase("weights_as_zero");
  EXPECT_EQ(read(report).dump(), expected.dump());
}

TEST(Report, HasAnyNumbersAndAnyText) {
  StepReport report;
  for (const double value : {std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(),
                             std::numeric_limits<double>::quiet_NaN()}) {
    report.error = report.seconds.total = value;
    report.error_before = value;
    const Json json = read(report);
    EXPECT_TRUE(json["error"].is_null() && json["error_before"].is_null() && json["seconds"]["total"].is_null());
  }
  for (std::uint64_t seed = 1; seed <= 20000; ++seed) {
    SCOPED_TRACE(seed);
    Random random(seed);
    const double any = std::bit_cast<double>(random.next());
    report.error = std::isfinite(any) ? any : 0;
    report.imbalance = std::ldexp(1 + std::floor(random.uniform(0, 9)), static_cast<int>(random.below(90)) - 20);
    const Json json = read(report);
    ASSERT_TRUE(json["error"].is_number_float() && json["imbalance"].is_number_float()) << json;
    ASSERT_EQ(std::bit_cast<std::uint64_t>(json["error"].get<double>()), std::bit_cast<std::uint64_t>(report.error));
    ASSERT_EQ(json["imbalance"], report.imbalance);
  }
  for (int c = 0; c < 128; ++c) report.reason += static_cast<char>(c);
  EXPECT_EQ(read(report)["reason"], report.reason);
  report.reason = "\xff";
  EXPECT_EQ(read(report)["reason"], "\xef\xbf\xbd");
}

}  // namespace
}  // namespace rcb::testing
