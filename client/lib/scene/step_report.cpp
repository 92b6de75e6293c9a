#include "client/lib/scene/step_report.hpp"

#include <algorithm>
#include <limits>

#include "client/lib/session/session.hpp"
#include "common/wire/field_reader.hpp"

namespace rcb::client {
namespace {

constexpr double kHuge = std::numeric_limits<double>::max();

// Reads each field into the member of its type.
class Reader {
 public:
  explicit Reader(const wire::Json& json) : fields_(json) {}

  template <typename T>
  void count(const char* name, T& out) {
    constexpr auto kMost = static_cast<std::int64_t>(std::min<std::uint64_t>(std::numeric_limits<T>::max(), kLarge));
    out = static_cast<T>(fields_.integer_or(name, 0, kMost, 0));
  }
  void number(const char* name, double& out) { out = fields_.number_or(name, -kHuge, kHuge, out); }
  void text(const char* name, std::string& out) { out = fields_.text(name, 1U << 16U); }
  void flag(const char* name, bool& out) { out = fields_.flag(name); }
  Status status() const {
    return fields_.ok() ? Status() : Status(Code::protocol_error, "step report: " + fields_.status().message());
  }

 private:
  wire::FieldReader fields_;
};

}  // namespace

Result<StepReport> read_report(const wire::Json& json) {
  StepReport report;
  Reader reader(json);
  reader.text("scene", report.scene);
  reader.count("step", report.step);
  reader.count("epoch", report.epoch);
  reader.count("n", report.n);
  reader.count("parts", report.parts);
  if (json.contains("error_before") && !json["error_before"].is_null())
    reader.number("error_before", report.error_before.emplace(0));
  reader.number("error", report.error);
  reader.number("imbalance", report.imbalance);
  reader.flag("repartitioned", report.repartitioned);
  reader.text("reason", report.reason);
  reader.count("axes_flipped", report.axes_flipped);
  if (json.contains("drifted") && !json["drifted"].is_null()) reader.count("drifted", report.drifted.emplace(0));
  reader.count("strangers", report.strangers);
  reader.count("moved", report.moved);
  reader.count("migrated", report.migrated);
  reader.count("inserted", report.inserted);
  reader.count("removed", report.removed);
  reader.count("scanned", report.scanned);
  reader.count("searched", report.searched);
  reader.count("rounds", report.rounds);
  reader.count("reductions", report.reductions);
  if (json.contains("sent")) reader.flag("sent", report.sent);
  if (json.contains("positions_step") && !json["positions_step"].is_null())
    reader.count("positions_step", report.positions_step.emplace(0));
  reader.count("weights_as_zero", report.weights_as_zero);
  reader.count("bytes", report.bytes);
  if (json.contains("way")) reader.text("way", report.way);
  if (const auto skipped = json.find("skipped"); skipped != json.end() && skipped->is_array())
    for (const wire::Json& entry : *skipped)
      if (entry.is_string()) report.skipped.push_back(entry.get<std::string>());
  if (const auto seconds = json.find("seconds"); seconds != json.end() && seconds->is_object()) {
    Reader parts(*seconds);
    parts.number("receive", report.seconds_receive);
    parts.number("exchange", report.seconds_exchange);
    parts.number("search", report.seconds_search);
    parts.number("migrate", report.seconds_migrate);
    parts.number("total", report.seconds_total);
    if (!parts.status()) return parts.status();
  }
  if (!reader.status()) return reader.status();
  report.json = wire::dump_json(json);
  return report;
}

}  // namespace rcb::client
