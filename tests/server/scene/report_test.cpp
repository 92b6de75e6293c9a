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

TEST(Report, IsTheJsonOfItsFields) {
  const scene::StepSeconds seconds{0.5, 1, 1e-7, 2.5e200, 0};
  const scene::StepCounts counts{1, 2, 3, 4, 5, 6, 7, ~std::uint64_t{0}, seconds};
  const std::string reason = "\"quotes\", a \\ and a\nline";
  const auto way = scene::Way::shared_memory;
  StepReport report{counts, "jet", wire::kStepMax, 8, 9, 10, 0.1, 2, 1e16, true, reason, 11, 12, 13, 14, {},
                    way,    15,    true,           16};
  report.skipped.add(scene::Skip::weights);
  report.skipped.add(scene::Skip::double_precision);
  Json expected = Json::parse(R"({"bytes":1,"drifted":2,"moved":3,"migrated":4,"scanned":5,"searched":6,"rounds":7,
    "reductions":18446744073709551615,"scene":"jet","step":9223372036854775806,"epoch":8,"n":9,"parts":10,
    "seconds":{"receive":0.5,"exchange":1.0,"search":1e-7,"migrate":2.5e200,"total":0.0},
    "error_before":0.1,"error":2.0,"imbalance":1e16,"repartitioned":true,"reason":"\"quotes\", a \\ and a\nline",
    "axes_flipped":11,"inserted":12,"removed":13,"weights_as_zero":14,"skipped":["weights","double precision"],
    "way":"shared-memory","sent":true,"positions_step":15,"strangers":16})");
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
