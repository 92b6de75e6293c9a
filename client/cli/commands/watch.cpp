// watch: prints a line for each step as it comes.
#include <algorithm>

#include <fmt/format.h>
#include <unistd.h>

#include "client/cli/app.hpp"
#include "client/cli/interrupt.hpp"
#include "client/cli/print/output.hpp"
#include "common/base/clock.hpp"

namespace rcb::cli {
namespace {

constexpr useconds_t kPollMicroseconds = 200'000;
constexpr std::uint64_t kReportsMax = 1000;  // asked for at once; if more come in a burst, the older ones aren't shown

struct WatchOptions {
  std::string name;
  std::uint64_t steps = 0;  // 0: no limit
  double seconds = 0;       // 0: no limit
};

std::string line(const Json& report) {
  const Json& before = report.at("error_before");
  return fmt::format("step {}  epoch {}  error {}{}  drifted {}  moved {}  migrated {}  {}  {} ms{}",
                     text_of(report, "step"), text_of(report, "epoch"),
                     before.is_null() ? "" : text_of(before) + " -> ", text_of(report, "error"),
                     text_of(report, "drifted"), text_of(report, "moved"), text_of(report, "migrated"),
                     text_of(report, "way"), milliseconds(report.at("seconds").at("total").get<double>()),
                     report.at("repartitioned").get<bool>() ? "  repartitioned: " + text_of(report, "reason") : "");
}

// Prints new reports; with --json as the items of one array, which is closed at the end.
class Watcher {
 public:
  Watcher(const WatchOptions& options, const Context& context) : options_(options), context_(context) {}

  Status run() {
    auto client = connect(context_);
    if (!client) return client.status();
    const SteadyClock clock;
    const double end = clock.seconds() + options_.seconds;
    for (bool first = true; !interrupted() && !enough() && !reader_gone(); first = false) {
      if (options_.seconds > 0 && clock.seconds() > end) break;
      if (!first) usleep(kPollMicroseconds);
      auto newest = reports(*client, 1);
      if (!newest) return closed(newest.status());
      if (first) newest_ = *newest;
      if (*newest == newest_) continue;
      if (Status status = show(*client); !status) return closed(status);
    }
    return closed({});
  }

 private:
  bool enough() const { return options_.steps > 0 && shown_ >= options_.steps; }

  Result<Json> reports(client::Client& client, std::uint64_t last) const {
    auto reply = ask(client, "history", {{"scene", options_.name}, {"last", last}});
    if (!reply) return reply.status();
    return reply->at("history");
  }

  // Prints the reports after the one shown last; all of them if that one is gone because the scene was created again.
  Status show(client::Client& client) {
    auto found = reports(client, kReportsMax);
    if (!found) return found.status();
    auto next = found->begin();
    if (!newest_.empty())
      if (const auto known = std::find(found->begin(), found->end(), newest_.back()); known != found->end())
        next = known + 1;
    for (; next != found->end() && !enough(); ++next) {
      if (context_.json)
        print_line((shown_ == 0 ? "[" : ",") + next->dump());
      else
        print_line(line(*next));
      context_.document_begun = true;
      ++shown_;
    }
    newest_ = found->empty() ? Json::array() : Json::array({found->back()});
    return flush_output();
  }

  // Ends the array. If it has items, a failure is told on stderr only, since stdout has its one document.
  Status closed(Status status) const {
    if (status.code() == Code::interrupted) status = {};  // the usual end
    if (!context_.json) return status;
    if (shown_ == 0 && !status) return status;
    print_line(shown_ == 0 ? "[]" : "]");
    return status;
  }

  const WatchOptions& options_;
  const Context& context_;
  Json newest_ = Json::array();  // the last report, if any
  std::uint64_t shown_ = 0;
};

Status watch(const WatchOptions& options, const Context& context) { return Watcher(options, context).run(); }

}  // namespace

void add_watch_command(CLI::App& app, Context& context) {
  auto [command, options] = add_command(app, context,
                                        {"watch", "A line a step, as the steps come, until interrupted",
                                         "  rcbctl watch jet\n  rcbctl watch jet --steps 10 --json", kAskGroup},
                                        watch);
  add_scene_name(command, options.name);
  add_value(command, "--steps", options.steps, kind::whole_number("K", 1), "end after so many steps");
  add_value(command, "--for", options.seconds, kind::positive_number("SECONDS"), "end after so many seconds");
}

}  // namespace rcb::cli
