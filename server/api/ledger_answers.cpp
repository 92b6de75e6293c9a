#include "server/api/ledger_answers.hpp"

#include <algorithm>
#include <memory>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"
#include "server/api/lists.hpp"

namespace rcb::api {
namespace {

using scene::Ledger;
using scene::SceneState;
using wire::or_null;

// Its destructor gives an answer that somebody waits for: the one that was set, or else a failure.
class Awaited {
 public:
  explicit Awaited(TakeAnswer take)
      : take_(std::move(take)),
        answer_(failed({Code::unavailable, "the service ended before the older step reports were read"})) {}
  Awaited(const Awaited&) = delete;
  Awaited& operator=(const Awaited&) = delete;
  ~Awaited() { take_(std::move(answer_)); }
  void set(Answer answer) { answer_ = std::move(answer); }

 private:
  TakeAnswer take_;
  Answer answer_;
};

void put_loads(Answer& answer, const SceneState& now) {
  put_list<std::uint64_t>(answer, answer.json, "counts", now.loads->counts);
  put_list<double>(answer, answer.json, "targets", now.loads->targets);
  if (now.weights) put_list<double>(answer, answer.json, "loads", now.loads->load_values);
}

Answer error(const Ledger& ledger) {
  const SceneState& now = ledger.now();
  return done({{"scene", ledger.name()},
               {"step", or_null(now.step)},
               {"epoch", now.epoch},
               {"error", now.loads->error},
               {"imbalance", now.loads->imbalance},
               {"tolerance", wire::number_json(now.options.tolerance)}});
}

Answer counts(const Ledger& ledger) {
  Answer answer = done({{"epoch", ledger.now().epoch}});
  put_loads(answer, ledger.now());
  return answer;
}

Answer stats(const Ledger& ledger) {
  const scene::SceneTotals& totals = ledger.totals();
  wire::Json json = to_json(static_cast<const scene::StepCounts&>(totals));
  json.update({{"scene", ledger.name()},
               {"steps", totals.steps},
               {"repartitions", totals.repartitions},
               {"skipped", totals.skipped},
               {"asked", totals.asked}});
  return done(std::move(json));
}

Answer history(const Ledger& ledger, const wire::Json& request) {
  const std::uint64_t total = ledger.totals().steps;
  const auto last = wire::integer_field_or(request, "last", 0, wire::kIntegerMax, wire::kIntegerMax);
  if (!last.ok()) return failed(last.status());
  const std::uint64_t wanted = std::min(static_cast<std::uint64_t>(*last), total);
  if (given(request, "last") && given(request, "from"))
    return failed({Code::invalid_argument, "'last' and 'from' at once", "'last' says where the first page begins"});
  const bool paged = given(request, "from") || given(request, "count");
  if (!paged && wanted > wire::kReportsMax)
    return failed({Code::too_large, fmt::format("{} step reports don't fit into one answer", wanted),
                   R"(ask for them by pages: "from" and "count", as rcbctl history does, or for the "last" few)"});
  const auto page = read_page(request, total, total - wanted, wire::kReportsMax);
  if (!page.ok()) return failed(page.status());
  return with_reports(ledger, page->from, page->end, [page = *page, total](scene::FoundReports found, Answer& answer) {
    wire::Json& json = answer.json;
    json["total"] = total;
    json["lost"] = page.end - page.from - found.reports.size();
    if (json["lost"] != 0) json["loss"] = found.loss;
    json["history"] = std::move(found.reports);
    page.tell(json, total);
  });
}

}  // namespace

Answer with_reports(const scene::Ledger& ledger, std::uint64_t first, std::uint64_t last,
                    std::function<void(scene::FoundReports, Answer&)> fill) {
  Answer answer = done(wire::Json::object());
  if (ledger.history().in_memory(first)) {
    fill(ledger.history().newest(first, last), answer);
    return answer;
  }
  answer.later = [reading = ledger.history().reading(first, last, ledger.journal()), fill = std::move(fill)](
                     Answer base, TakeAnswer take) {
    auto awaited = std::make_shared<Awaited>(std::move(take));
    auto filled = std::make_shared<Answer>(std::move(base));
    auto whole = std::make_shared<bool>(false);
    const Status begun = reading(
        [fill, filled, whole](scene::FoundReports found) {
          fill(std::move(found), *filled);
          *whole = true;
        },
        [awaited, filled, whole] {
          // Most likely memory has run out.
          awaited->set(*whole ? std::move(*filled)
                              : failed({Code::too_large, "there is no memory for the older step reports",
                                        "ask for fewer at a time, or a page"}));
        });
    if (!begun.ok()) awaited->set(failed(begun));
  };
  return answer;
}

Answer describe(const Ledger& ledger, int ranks) {
  const SceneState& now = ledger.now();
  const scene::SceneOptions& options = now.options;
  wire::Json json = to_json(options);
  json.update({{"scene", ledger.name()},
               {"n", now.n},
               {"ranks", ranks},
               {"weights", now.weights},
               {"ids", now.ids},
               {"step", or_null(now.step)},
               {"positions_step", or_null(now.positions_step)},
               {"filled", now.filled},
               {"incarnation", wire::hex64(now.incarnation)},
               {"epoch", now.epoch}});
  for (const char* name : {"part_sizes", "error", "imbalance", "counts", "targets", "hash", "rounds", "reductions"})
    json[name] = nullptr;
  Answer answer = done(std::move(json));
  if (!options.part_sizes.empty()) put_list<double>(answer, answer.json, "part_sizes", options.part_sizes);
  if (!now.loads) return answer;
  answer.json["error"] = now.loads->error;
  answer.json["imbalance"] = now.loads->imbalance;
  answer.json["hash"] = wire::hex64(now.hash);
  answer.json["rounds"] = now.search_rounds;
  answer.json["reductions"] = now.search_reductions;
  if (now.loads->weights_as_zero > 0) answer.json["weights_as_zero"] = now.loads->weights_as_zero;
  put_loads(answer, now);
  return answer;
}

wire::Json restore_order(const Ledger& ledger) {
  const SceneState& now = ledger.now();
  wire::Json order = to_json(now.options);
  order.update({{"command", "scene.restore"},
                {"part_sizes", now.options.part_sizes},
                {"scene", ledger.name()},
                {"epoch", now.epoch},
                {"n", now.n},
                {"weights", now.weights},
                {"ids", now.ids},
                {"rounds", now.search_rounds},
                {"reductions", now.search_reductions}});
  if (now.id_sum) order["id_sum"] = *now.id_sum;
  return order;
}

Answer answer_from(const Ledger& ledger, const wire::Json& request, int ranks) {
  const std::string command = request.at("command").get<std::string>();
  if (command == "history") return history(ledger, request);
  if (command == "stats") return stats(ledger);
  if (command != "error" && command != "counts") return describe(ledger, ranks);
  if (!ledger.now().loads)
    return failed(
        {Code::not_found, fmt::format("scene '{}' has no positions yet", ledger.name()), "push a step first"});
  return command == "error" ? error(ledger) : counts(ledger);
}

std::string verdict_text(const Ledger& ledger, const scene::CountVerdict& verdict) {
  using scene::CountVerdict;
  if (const auto* send = std::get_if<CountVerdict::Send>(&verdict.is)) return wire::dump_json({{"send", send->why}});
  if (const auto* other = std::get_if<CountVerdict::OtherScale>(&verdict.is))
    return fmt::format(R"({{"again":"scale","scale":{}}})", other->exponent);
  if (const auto* done = std::get_if<CountVerdict::Committed>(&verdict.is))
    return fmt::format(R"({{"previous_step":{},"report":{}}})",
                       done->previous_step ? std::to_string(*done->previous_step) : "null", ledger.last_report());
  return R"({"again":"cuts"})";
}

std::string repeated(const Ledger& ledger) {
  return fmt::format(R"({{"repeated":true,"report":{}}})", ledger.last_report());
}

}  // namespace rcb::api
