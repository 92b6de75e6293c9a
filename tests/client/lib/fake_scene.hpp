// A scene as a service would keep it, simple enough to be believed: particles by id. Its cuts are always the same, x =
// 1, 2, ...: the x of its positions is to lie between that of the part and the next. It checks every push against what
// the test pushes and answers it, or does what it is told.
#pragma once

#include <algorithm>
#include <array>
#include <numeric>
#include <set>

#include "common/wire/count_record.hpp"
#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {

class FakeScene {
 public:
  enum class Fault {
    none,
    late,                 // reads the push, and says only that it wasn't done in time
    taken,                // commits, as if another session had pushed this number, and says so
    close_before_commit,  // reads the push, then closes
    close_after_commit,   // commits, then closes without an answer
    close_in_answer,      // commits and sends half of the answer
    late_after_commit,    // commits, and says only that it wasn't done in time
    die_before_commit,    // reads the push, then is started again, and its ranks hold nothing
    die_after_commit,     // commits, then the same
  };

  FakeScene(int dims, int parts, int ranks) : dims_(dims), parts_(parts), ranks_(ranks) {}

  // What the n-th push (from 0) meets.
  std::function<Fault(int)> fault = [](int) { return Fault::none; };
  // What the test pushes, by id.
  std::function<double(std::int64_t id, std::size_t axis, std::int64_t step)> position;

  // What the n-th count (from 0) meets, and its answer, if that is not a report.
  std::function<Fault(int)> count_fault = [](int) { return Fault::none; };
  std::function<protocol::Json(int)> verdict = [](int) { return protocol::Json(); };
  std::vector<wire::CountRecord> counted;

  std::vector<std::string> sessions;
  std::vector<std::int64_t> attempts;
  std::vector<protocol::Json> begun;
  std::function<void(ToldCuts&)> spoil_cuts = [](ToldCuts&) {};
  std::vector<std::string> commands;
  int commits = 0;
  bool empty_now = false;  // the scene was dropped
  int restarts = 0;
  int refills = 0;                                    // steps that brought particles to ranks that held none
  protocol::Json options = protocol::Json::object();  // more of what scene.open tells
  std::vector<double> weights;                        // as pushed last, by row
  std::optional<std::int64_t> step;
  std::int64_t epoch = 0;
  // Whether the connection ends at the n-th (from 0) of these commands, instead of its answer.
  std::function<bool(const std::string& command, int n)> close_at = [](const std::string&, int) { return false; };

  void serve(Peer& peer) {
    const auto hello = peer.greet(ranks_);
    if (!hello) return;
    sessions.push_back(hello->json["session"].get<std::string>());
    while (auto frame = peer.receive()) {
      if (frame->type == protocol::FrameType::goodbye) return;
      const auto command = frame->json["command"].get<std::string>();
      const auto n = std::count(commands.begin(), commands.end(), command);
      commands.push_back(command);
      if (close_at(command, static_cast<int>(n))) return;
      if (command == "scene.open") {
        if (empty_now)
          peer.fail(*frame, {Code::not_found, "no such scene"});
        else
          peer.reply(*frame, description());
      } else if (command == "scene.show") {
        peer.reply(*frame, description());
      } else if (command == "scene.create") {
        empty_now = false;
        if (frame->json.value("replace", false)) clear();
        peer.reply(*frame, description());
      } else if (command == "scene.drop") {
        clear();
        empty_now = true;
        peer.reply(*frame, protocol::Json::object());
      } else if (command == "scene.close") {
        peer.reply(*frame, protocol::Json::object());
      } else if (command == "cuts") {
        const ToldCuts cuts = cuts_now();
        if (step)
          peer.reply(*frame, cuts.json, cuts.arrays);
        else
          peer.fail(*frame, {Code::not_found, "no positions yet"});
      } else if (command == "push") {
        if (!push(peer, *frame)) return;
      } else if (command == "count") {
        if (!count(peer, *frame)) return;
      } else {
        peer.fail(*frame, {Code::unsupported, "unknown command"});
      }
    }
  }

 private:
  static constexpr std::array<const char*, 3> kAxes{"x", "y", "z"};

  ToldCuts cuts_now() const {
    ToldCuts cuts(dims_, parts_, epoch);
    spoil_cuts(cuts);
    return cuts;
  }

  protocol::Json description() const {
    protocol::Json json{{"scene", "s"},
                        {"n", ids_.size()},
                        {"dims", dims_},
                        {"parts", parts_},
                        {"ranks", ranks_},
                        {"epoch", epoch},
                        {"step", step ? protocol::Json(*step) : protocol::Json(nullptr)},
                        {"ids", has_ids_},
                        {"weights", weights_},
                        {"filled", filled_}};
    json.update(options);
    return json;
  }
  // False: the connection ends.
  bool count(Peer& peer, const Received& request) {
    const int n = static_cast<int>(counted.size());
    const auto record = wire::decode_count_record(std::as_bytes(std::span(request.record)));
    EXPECT_TRUE(record.ok()) << record.status().message();
    if (!record.ok()) return false;
    counted.push_back(*record);
    const Fault now = count_fault(n);
    if (now == Fault::close_before_commit) return false;
    const std::int64_t number = record->step;
    protocol::Json answer = verdict(n);
    if (!answer.is_null()) return peer.reply(request, answer);
    const bool repeated = step == number;
    answer["previous_step"] = *step;
    answer["report"] = report(number);
    answer["report"].update({{"sent", false}, {"way", "count"}, {"drifted", wire::or_null(record->drifted)}});
    if (repeated) answer["repeated"] = true;
    step = number;
    if (now == Fault::close_after_commit) return false;
    if (now == Fault::late_after_commit) return peer.fail(request, {Code::deadline_exceeded, "it goes on"});
    return peer.reply(request, answer);
  }

  // False: the connection ends.
  bool push(Peer& peer, const Received& push) {
    const Fault now = fault(static_cast<int>(attempts.size()));
    attempts.push_back(push.json["attempt"].get<std::int64_t>());
    begun.push_back(push.json);
    const auto number = push.json["step"].get<std::int64_t>();
    if (now == Fault::die_before_commit) return restart();
    if (now == Fault::close_before_commit) return false;
    if (now == Fault::late) return peer.fail(push, {Code::deadline_exceeded, "it was late"});
    if (step == number) return peer.reply(push, {{"report", report(number)}, {"repeated", true}});
    std::vector<std::int64_t> ids(push.json["n"].get<std::size_t>());
    std::iota(ids.begin(), ids.end(), 0);
    if (push.json.value("ids", false) && !ids.empty()) ids = push.values<std::int64_t>("id");
    if (step &&
        ids.size() + push.json["removed"].get<std::size_t>() != ids_.size() + push.json["inserted"].get<std::size_t>())
      return peer.fail(push, {Code::not_conserved, "others were there"});
    if (step && weights_ && !push.json.value("weights", false))
      return peer.fail(push, {Code::invalid_argument, "the push has no weights"});
    if (!ids.empty()) check_rows(push, ids, number);
    has_ids_ = std::ranges::any_of(ids, [&](std::int64_t id) { return id >= static_cast<std::int64_t>(ids.size()); });
    weights_ = push.json.value("weights", false);
    weights = weights_ && !ids.empty() ? push.values<double>("w") : std::vector<double>();
    ids_ = {ids.begin(), ids.end()};
    return commit(peer, push, number, now);
  }

  bool restart() {
    ++restarts;
    filled_ = false;
    return false;
  }

  void clear() {
    step.reset();
    epoch = 0;
    filled_ = true;
    ids_.clear();
    has_ids_ = weights_ = false;
    weights.clear();
  }

  // What the arrays say of themselves, and value by value.
  void check_rows(const Received& push, const std::vector<std::int64_t>& ids, std::int64_t number) {
    EXPECT_EQ(push.json["way"], "endpoint");
    protocol::Json arrays = protocol::Json::array();
    const auto describe = [&](const char* name, const char* dtype) {
      arrays.push_back({{"name", name}, {"dtype", dtype}, {"shape", {ids.size()}}});
    };
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(dims_); ++axis) describe(kAxes[axis], "<f8");
    if (push.json["weights"] == true) describe("w", "<f8");
    if (push.json["ids"] == true) describe("id", "<i8");
    ASSERT_EQ(push.json["arrays"], arrays);
    std::size_t wrong = 0;
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(dims_); ++axis) {
      const auto values = push.values<double>(kAxes[axis]);
      for (std::size_t i = 0; i < ids.size(); ++i) wrong += values[i] != position(ids[i], axis, number) ? 1U : 0U;
    }
    EXPECT_EQ(wrong, 0U) << "step " << number;
  }

  bool commit(Peer& peer, const Received& begin, std::int64_t number, Fault now) {
    if (!step) epoch = 1;
    if (!filled_) ++refills;
    filled_ = true;
    step = number;
    ++commits;
    if (now == Fault::die_after_commit) return restart();
    if (now == Fault::close_after_commit) return false;
    if (now == Fault::taken) return peer.fail(begin, {Code::stale_step, "another session's"});
    if (now == Fault::late_after_commit) return peer.fail(begin, {Code::deadline_exceeded, "it goes on"});
    protocol::Json answer{{"report", report(number)}};
    std::vector<protocol::Array> arrays;
    cuts_now().add_unless_known(begin.json["cuts_known"], answer, arrays);
    std::string bytes = protocol::frame(protocol::FrameType::reply, begin.request, answer, arrays, number % 2 == 0);
    if (now == Fault::close_in_answer) bytes.resize(bytes.size() / 2);
    peer.send(protocol::FrameType::notice, begin.request, {{"notice", "nearly done"}});
    peer.send_bytes(bytes);
    return now != Fault::close_in_answer;
  }

  protocol::Json report(std::int64_t number) const {
    return {{"scene", "s"},
            {"step", number},
            {"epoch", epoch},
            {"n", ids_.size()},
            {"parts", parts_},
            {"error_before", nullptr},
            {"error", 0.25},
            {"imbalance", 1.5},
            {"repartitioned", number == 0},
            {"reason", "because"},
            {"axes_flipped", 2},
            {"drifted", nullptr},
            {"moved", 3},
            {"migrated", 4},
            {"skipped", {"search"}},
            {"bytes", 5},
            {"seconds", {{"receive", 0.5}, {"total", 2}}}};
  }

  int dims_;
  int parts_;
  int ranks_;
  bool has_ids_ = false;
  bool weights_ = false;
  bool filled_ = true;
  std::set<std::int64_t> ids_;
};

}  // namespace rcb::client
