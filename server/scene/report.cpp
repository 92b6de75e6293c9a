#include "server/scene/report.hpp"

#include <cmath>
#include <concepts>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace rcb::scene {
namespace {

// A JSON object as text, field by field.
class ObjectText {
 public:
  void put(const char* name, const std::string& value) { put_raw(name, wire::dump_json(value)); }
  void put(const char* name, bool value) { put_raw(name, value ? "true" : "false"); }
  template <std::integral T>
  void put(const char* name, T value) {
    put_raw(name, fmt::format_int(value).c_str());
  }
  // As short as it can be read back, and never without a point or an exponent.
  void put(const char* name, double value) {
    std::string text = std::isfinite(value) ? fmt::format("{}", value) : "null";
    if (std::isfinite(value) && text.find_first_of(".e") == std::string::npos) text += ".0";
    put_raw(name, text);
  }
  template <typename T>
  void put(const char* name, const std::optional<T>& value) {
    if (value)
      put(name, *value);
    else
      put_raw(name, "null");
  }
  void put_raw(const char* name, std::string_view json) {
    text_ += text_.empty() ? "{\"" : ",\"";
    text_.append(name).append("\":").append(json);
  }
  std::string take() { return std::move(text_) + "}"; }

 private:
  std::string text_;
};

std::string text_of(const StepSeconds& seconds) {
  ObjectText text;
  text.put("receive", seconds.receive);
  text.put("exchange", seconds.exchange);
  text.put("search", seconds.search);
  text.put("migrate", seconds.migrate);
  text.put("total", seconds.total);
  return text.take();
}

// drifted: none where nobody knows it.
void put_counts(ObjectText& text, const StepCounts& counts, std::optional<std::uint64_t> drifted) {
  text.put("bytes", counts.bytes);
  text.put("drifted", drifted);
  text.put("moved", counts.moved);
  text.put("migrated", counts.migrated);
  text.put("scanned", counts.scanned);
  text.put("searched", counts.searched);
  text.put("rounds", counts.rounds);
  text.put("reductions", counts.reductions);
  text.put_raw("seconds", text_of(counts.seconds));
}

}  // namespace

const char* name_of(Way way) {
  switch (way) {
    case Way::sockets:
      return "sockets";
    case Way::shared_memory:
      return "shared-memory";
    case Way::file:
      return "file";
    case Way::count:
      return "count";
    case Way::endpoint:
      break;
  }
  return "endpoint";
}

std::vector<std::string> Skips::names() const {
  constexpr const char* kNames[] = {"dimension", "weights", "ids",           "double precision",
                                    "exchange",  "search",  "far from cuts", "positions"};
  std::vector<std::string> names;
  for (unsigned k = 0; k < std::size(kNames); ++k)
    if ((bits_ >> k & 1U) != 0) names.emplace_back(kNames[k]);
  return names;
}

StepSeconds& StepSeconds::operator+=(const StepSeconds& other) {
  receive += other.receive;
  exchange += other.exchange;
  search += other.search;
  migrate += other.migrate;
  total += other.total;
  return *this;
}

StepCounts& StepCounts::operator+=(const StepCounts& other) {
  bytes += other.bytes;
  drifted += other.drifted;
  moved += other.moved;
  migrated += other.migrated;
  scanned += other.scanned;
  searched += other.searched;
  rounds += other.rounds;
  reductions += other.reductions;
  seconds += other.seconds;
  return *this;
}

// Not by way of a tree of values: it is written at each step, and seldom looked into.
std::string text_of(const StepReport& report) {
  ObjectText text;
  text.put("scene", report.scene);
  text.put("step", report.step);
  text.put("epoch", report.epoch);
  text.put("n", report.n);
  text.put("parts", report.parts);
  text.put("error_before", report.error_before);
  text.put("error", report.error);
  text.put("imbalance", report.imbalance);
  text.put("repartitioned", report.repartitioned);
  text.put("reason", report.reason);
  text.put("axes_flipped", report.axes_flipped);
  text.put("inserted", report.inserted);
  text.put("removed", report.removed);
  text.put("strangers", report.strangers);
  if (report.weights_as_zero > 0) text.put("weights_as_zero", report.weights_as_zero);
  const std::vector<std::string> skipped = report.skipped.names();
  text.put_raw("skipped", skipped.empty() ? "[]" : fmt::format("[\"{}\"]", fmt::join(skipped, "\",\"")));
  text.put_raw("way", fmt::format("\"{}\"", name_of(report.way)));
  text.put("sent", report.sent());
  text.put("positions_step", report.positions_step);
  put_counts(text, report, report.drifted_known ? std::optional(report.drifted) : std::nullopt);
  return text.take();
}

wire::Json to_json(const StepCounts& counts) {
  ObjectText text;
  put_counts(text, counts, counts.drifted);
  return wire::Json::parse(text.take());
}

wire::Json to_json(const StepReport& report) { return wire::Json::parse(text_of(report)); }

}  // namespace rcb::scene
