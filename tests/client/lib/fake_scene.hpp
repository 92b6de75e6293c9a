// A scene as a service would keep it, simple enough to be believed: particles by id, a part for each from a formula,
// its own copy of the plan, by the plain rules of tests/support/protocol.hpp. Its cuts are always the same, x = 1, 2,
// ...: where a test wants to know parts, the x of its positions is to lie between that of the part and the next. It
// checks every push against what the test pushes and answers it, or does what it is told.
#pragma once

#include <algorithm>
#include <array>
#include <map>
#include <numeric>

#include "tests/client/lib/fake_service.hpp"
#include "tests/client/lib/told_cuts.hpp"

namespace rcb::client {

class FakeScene {
 public:
  enum class Fault {
    none,
    stale,                // forgets the client's plan and says so
    late,                 // reads the push, and says only that it wasn't done in time
    taken,                // commits, as if another session had pushed this number, and says so
    close_before_commit,  // reads the push, then closes
    close_after_commit,   // commits, then closes without an answer
    close_in_answer,      // commits and sends half of the answer
    late_after_commit,    // commits, and says only that it wasn't done in time
    busy_early,           // refuses at push.begin, then reads the slices
    wrong_checksum,       // commits, with a plan that isn't what the client derives
    die_before_commit,    // reads the push, then is started again, and its ranks hold nothing
    die_after_commit,     // commits, then the same
  };

  FakeScene(int dims, int parts, int ranks) : dims_(dims), parts_(parts), ranks_(ranks) {}

  // What the n-th push.begin (from 0) meets.
  std::function<Fault(int)> fault = [](int) { return Fault::none; };
  // The part of particle `id` after a step.
  std::function<std::int32_t(std::int64_t id, std::int64_t step)> part_of = [](std::int64_t, std::int64_t) {
    return 0;
  };
  // What the test pushes, by id.
  std::function<double(std::int64_t id, std::size_t axis, std::int64_t step)> position;

  // What the n-th count (from 0) meets, and its answer, if that is not a report.
  std::function<Fault(int)> count_fault = [](int) { return Fault::none; };
  std::function<protocol::Json(int)> verdict = [](int) { return protocol::Json(); };
  std::vector<Received> counted;

  std::vector<std::string> sessions;
  std::vector<std::int64_t> attempts;
  std::vector<protocol::Json> cuts_known;  // as each push.begin says; null: it doesn't
  std::function<void(ToldCuts&)> spoil_cuts = [](ToldCuts&) {};
  std::vector<std::string> commands;
  int slices_read = 0;
  int commits = 0;
  bool empty_now = false;  // the scene was dropped
  int restarts = 0;
  int refills = 0;
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
      } else if (command == "plan") {
        send_plan(peer, *frame);
      } else if (command == "cuts") {
        const ToldCuts cuts = cuts_now();
        if (step)
          peer.reply(*frame, cuts.json, cuts.arrays);
        else
          peer.fail(*frame, {Code::not_found, "no positions yet"});
      } else if (command == "push.begin") {
        if (!push(peer, *frame)) return;
      } else if (command == "count") {
        if (!count(peer, *frame)) return;
      } else if (command != "push.slice") {
        peer.fail(*frame, {Code::unsupported, "unknown command"});
      }
    }
  }

 private:
  using Slices = std::map<int, Received>;  // by rank
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
  void send_plan(Peer& peer, const Received& request) const {
    std::vector<std::int64_t> ids;
    std::vector<std::int32_t> parts;
    std::vector<std::uint64_t> counts;
    for (const auto& of_rank : plan_->slots) {
      counts.push_back(of_rank.size());
      for (const std::int64_t id : of_rank) {
        ids.push_back(id);
        parts.push_back(part_.at(id));
      }
    }
    peer.reply(request, {{"counts", counts}, {"plan", plan_->json()}, {"parts", parts_}, {"ranks", ranks_}},
               {protocol::array_of("id", "<i8", ids), protocol::array_of("part", "<i4", parts)}, true);
  }

  // False: the connection ends.
  bool count(Peer& peer, const Received& request) {
    const int n = static_cast<int>(counted.size());
    counted.push_back(request);
    const Fault now = count_fault(n);
    if (now == Fault::close_before_commit) return false;
    const auto number = request.json["step"].get<std::int64_t>();
    protocol::Json answer = verdict(n);
    if (!answer.is_null()) return peer.reply(request, answer);
    const bool repeated = step == number;
    answer["previous_step"] = *step;
    answer["report"] = report(number, 0);
    answer["report"].update({{"sent", false}, {"way", "count"}, {"drifted", request.json["drifted"]}});
    if (repeated) answer["repeated"] = true;
    step = number;
    if (now == Fault::close_after_commit) return false;
    if (now == Fault::late_after_commit) return peer.fail(request, {Code::deadline_exceeded, "it goes on"});
    return peer.reply(request, answer);
  }

  // False: the connection ends.
  bool push(Peer& peer, const Received& begin) {
    const Fault now = fault(static_cast<int>(attempts.size()));
    attempts.push_back(begin.json["attempt"].get<std::int64_t>());
    cuts_known.push_back(begin.json.value("cuts_known", protocol::Json()));
    const auto number = begin.json["step"].get<std::int64_t>();
    if (now == Fault::busy_early) {
      peer.fail(begin, {Code::busy, "held by another"});
      // Slices that the client had begun are read by serve(), as a service reads and drops them.
      return true;
    }
    const bool first = !step;
    Slices slices;
    for (int i = 0; i < begin.json["slices"].get<int>(); ++i) {
      auto slice = peer.receive();
      if (!slice) return false;
      EXPECT_EQ(slice->json["command"], "push.slice");
      const int rank = slice->json["rank"].get<int>();
      EXPECT_TRUE(slices.emplace(rank, std::move(*slice)).second) << "two slices of rank " << rank;
    }
    slices_read += static_cast<int>(slices.size());
    if (now == Fault::die_before_commit) return restart();
    if (now == Fault::close_before_commit) return false;
    if (now == Fault::late) {
      peer.fail(begin, {Code::deadline_exceeded, "it was late"});
      return true;
    }
    if (begin.json.value("refill", false)) return refill(peer, begin, slices, now);
    if (step == number) {
      peer.reply(begin, {{"report", report(number, 0)}, {"plan", plan_->json()}, {"repeated", true}});
      return true;
    }
    if (!first && !filled_) {
      peer.fail(begin, {Code::base_lost, "the ranks hold no particles"});
      return true;
    }
    if (first) take_ids(begin, slices);
    if (now == Fault::stale || (!first && begin.json["plan"] != plan_->json())) {
      peer.fail(begin, {Code::stale_plan, "fetch the plan"});
      return true;
    }
    check_slices(begin, slices, number);
    if (begin.json["weights"] == true) take_weights(slices);
    return commit(peer, begin, number, first, now);
  }

  bool restart() {
    ++restarts;
    filled_ = false;
    return false;
  }

  // The positions of the step after: a particle is in the part in whose region its x lies.
  bool refill(Peer& peer, const Received& begin, const Slices& slices, Fault now) {
    EXPECT_FALSE(filled_);
    EXPECT_EQ(begin.json["step"], *step);
    const auto before = ids_;
    take_ids(begin, slices);
    EXPECT_EQ(ids_, before);
    check_slices(begin, slices, *step + 1);
    if (weights_) take_weights(slices);
    for (const auto& [rank, slice] : slices) {
      const auto x = slice.values<double>("x");
      const auto& ids = plan_->slots[static_cast<std::size_t>(rank)];
      for (std::size_t i = 0; i < ids.size(); ++i) part_[ids[i]] = static_cast<std::int32_t>(x[i]);
    }
    plan_->commit(part_, parts_, true);
    filled_ = true;
    ++refills;
    if (now == Fault::die_after_commit) return restart();
    peer.reply(begin, {{"refilled", true}, {"plan", plan_->json()}});
    return true;
  }

  void clear() {
    step.reset();
    plan_.reset();
    part_.clear();
    epoch = 0;
    filled_ = true;
    ids_.clear();
    has_ids_ = weights_ = false;
    weights.clear();
  }

  void take_weights(const Slices& slices) {
    weights_ = true;
    std::map<std::int64_t, double> by_id;
    for (const auto& [rank, slice] : slices) {
      const auto values = slice.values<double>("w");
      const auto& ids = plan_->slots[static_cast<std::size_t>(rank)];
      for (std::size_t i = 0; i < ids.size(); ++i) by_id[ids[i]] = values.at(i);
    }
    weights.clear();
    for (const std::int64_t id : ids_) weights.push_back(by_id.at(id));
  }

  // Every rank's slice: what it says of itself, and value by value.
  void check_slices(const Received& begin, const Slices& slices, std::int64_t number) {
    EXPECT_EQ(begin.json["session"], sessions.back());
    EXPECT_EQ(begin.json["plan"], plan_->json());
    EXPECT_EQ(begin.json["n"], ids_.size());
    std::size_t with_particles = 0;
    for (std::size_t rank = 0; rank < plan_->slots.size(); ++rank) {
      const auto& ids = plan_->slots[rank];
      if (ids.empty()) continue;
      ++with_particles;
      const auto found = slices.find(static_cast<int>(rank));
      ASSERT_NE(found, slices.end()) << "no slice of rank " << rank;
      const Received& slice = found->second;
      for (const char* field : {"scene", "session", "step", "attempt", "plan"})
        EXPECT_EQ(slice.json[field], begin.json[field]) << field;
      EXPECT_EQ(slice.json["count"], ids.size());
      protocol::Json arrays = protocol::Json::array();
      const auto describe = [&](const char* name, const char* dtype) {
        arrays.push_back({{"name", name}, {"dtype", dtype}, {"shape", {ids.size()}}});
      };
      for (std::size_t axis = 0; axis < static_cast<std::size_t>(dims_); ++axis) describe(kAxes[axis], "<f8");
      if (begin.json["weights"] == true) describe("w", "<f8");
      if (begin.json["ids"] == true) describe("id", "<i8");
      ASSERT_EQ(slice.json["arrays"], arrays);
      std::size_t wrong = 0;
      for (std::size_t axis = 0; axis < static_cast<std::size_t>(dims_); ++axis) {
        const auto values = slice.values<double>(kAxes[axis]);
        for (std::size_t i = 0; i < ids.size(); ++i) wrong += values[i] != position(ids[i], axis, number) ? 1U : 0U;
      }
      EXPECT_EQ(wrong, 0U) << "rank " << rank << " step " << number;
    }
    EXPECT_EQ(with_particles, slices.size());
  }

  // At a first push: the solver's own, in its order, or 0..n-1.
  void take_ids(const Received& begin, const Slices& slices) {
    has_ids_ = begin.json["ids"] == true;
    ids_.assign(has_ids_ ? 0 : begin.json["n"].get<std::size_t>(), 0);
    std::iota(ids_.begin(), ids_.end(), 0);
    if (has_ids_)
      for (const auto& [rank, slice] : slices)
        for (const std::int64_t id : slice.values<std::int64_t>("id")) ids_.push_back(id);
    plan_.emplace(ids_, ranks_);
  }

  bool commit(Peer& peer, const Received& begin, std::int64_t number, bool first, Fault now) {
    std::map<std::int64_t, std::int32_t> after;
    for (const std::int64_t id : ids_) after[id] = part_of(id, number);
    std::vector<std::int64_t> ids;
    std::vector<std::int32_t> parts;
    for (const auto& [id, part] : after) {
      if (!first && part_.at(id) == part) continue;
      ids.push_back(id);
      parts.push_back(part);
    }
    part_ = std::move(after);
    plan_->commit(part_, parts_, first);
    if (first) epoch = 1;
    filled_ = true;
    step = number;
    ++commits;
    if (now == Fault::die_after_commit) return restart();
    if (now == Fault::close_after_commit) return false;
    if (now == Fault::taken) {
      peer.fail(begin, {Code::stale_step, "another session's"});
      return true;
    }
    if (now == Fault::late_after_commit) {
      peer.fail(begin, {Code::deadline_exceeded, "it goes on"});
      return true;
    }
    protocol::Json plan = plan_->json();
    if (now == Fault::wrong_checksum) plan["checksum"] = "0123456789abcdef";
    protocol::Json answer{{"report", report(number, ids.size())}, {"plan", plan}};
    std::vector<protocol::Array> arrays{protocol::array_of("changed_id", "<i8", ids),
                                        protocol::array_of("changed_part", "<i4", parts)};
    if (begin.json.contains("cuts_known")) cuts_now().add_unless_known(begin.json["cuts_known"], answer, arrays);
    std::string bytes = protocol::frame(protocol::FrameType::reply, begin.request, answer, arrays, number % 2 == 0);
    if (now == Fault::close_in_answer) bytes.resize(bytes.size() / 2);
    peer.send(protocol::FrameType::notice, begin.request, {{"notice", "nearly done"}});
    peer.send_bytes(bytes);
    return now != Fault::close_in_answer;
  }

  protocol::Json report(std::int64_t number, std::size_t moved) const {
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
            {"drifted", moved},
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
  std::vector<std::int64_t> ids_;  // by row
  std::optional<protocol::Plan> plan_;
  std::map<std::int64_t, std::int32_t> part_;  // by id
};

}  // namespace rcb::client
