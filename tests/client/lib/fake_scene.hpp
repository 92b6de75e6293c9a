// A scene as a service would keep it, simple enough to be believed: particles by id, a part for each from a formula,
// its own copy of the plan. It checks every push against what the test pushes and answers it, or does what it is told.
#pragma once

#include <mutex>

#include "common/plan/plan.hpp"
#include "tests/client/lib/fake_service.hpp"

namespace rcb::client {

class FakeScene {
 public:
  enum class Fault {
    none,
    stale,                // forgets the client's plan and says so
    close_before_commit,  // reads the push, then closes
    close_after_commit,   // commits, then closes without an answer
    close_in_answer,      // commits and sends half of the answer
    busy_early,           // refuses at push.begin, then reads the slices
    wrong_checksum,       // commits, with a plan that isn't what the client derives
    die_before_commit,    // reads the push, then is another service, without the scene
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

  std::vector<std::string> sessions;
  std::vector<std::int64_t> attempts;
  std::vector<std::string> commands;
  int slices_read = 0;
  int commits = 0;
  bool empty_now = false;  // the scene was dropped
  int restarts = 0;
  wire::Json options = wire::Json::object();  // more of what scene.open tells
  std::vector<wire::Json> created;            // scene.create of lost scenes
  std::vector<double> weights;                // as pushed last, by row
  std::optional<std::int64_t> step;
  std::int64_t epoch = 0;
  bool first_order_by_row = true;

  void serve(Peer& peer) {
    const auto hello = peer.greet(ranks_, "instance " + std::to_string(restarts));
    if (!hello) return;
    sessions.push_back(hello->json["session"].get<std::string>());
    while (auto frame = peer.receive()) {
      if (frame->header.type == wire::FrameType::goodbye) return;
      const auto command = frame->json["command"].get<std::string>();
      commands.push_back(command);
      if (command == "scene.open") {
        if (empty_now)
          peer.fail(*frame, {Code::not_found, "no such scene"});
        else
          peer.reply(*frame, description());
      } else if (command == "scene.create") {
        created.push_back(frame->json);
        empty_now = false;
        peer.reply(*frame, description());
      } else if (command == "scene.close") {
        peer.reply(*frame, wire::Json::object());
      } else if (command == "plan") {
        send_plan(peer, *frame);
      } else if (command == "push.begin") {
        if (!push(peer, *frame)) return;
      } else if (command != "push.slice") {
        peer.fail(*frame, {Code::unsupported, "unknown command"});
      }
    }
  }

  std::vector<std::int32_t> parts_by_id() const { return part_; }

 private:
  wire::Json description() const {
    wire::Json json{{"scene", "s"},
                    {"n", n_},
                    {"dims", dims_},
                    {"parts", parts_},
                    {"ranks", ranks_},
                    {"epoch", epoch},
                    {"step", step ? wire::Json(*step) : wire::Json(nullptr)},
                    {"ids", has_ids_},
                    {"weights", weights_}};
    json.update(options);
    return json;
  }
  wire::Json plan_json() const { return {{"version", plan_->version()}, {"checksum", wire::hex64(plan_->checksum())}}; }
  template <typename T>
  static wire::Array array(const char* name, const char* dtype, const std::vector<T>& values) {
    wire::Array out{name, dtype, {values.size()}, {}};
    const auto bytes = std::as_bytes(std::span(values));
    out.bytes.assign(bytes);
    return out;
  }
  void send_plan(Peer& peer, const Received& request) const {
    std::vector<std::int64_t> ids;
    std::vector<std::int32_t> parts;
    std::vector<std::uint64_t> counts;
    for (int rank = 0; rank < ranks_; ++rank) {
      counts.push_back(plan_->rows(rank).size());
      for (const std::uint64_t row : plan_->rows(rank)) {
        ids.push_back(plan_->id_of_row(row));
        parts.push_back(part_[row]);
      }
    }
    peer.reply(request, {{"counts", counts}, {"plan", plan_json()}, {"parts", parts_}, {"ranks", ranks_}},
               {array("id", "<i8", ids), array("part", "<i4", parts)}, true);
  }

  // False: the connection ends.
  bool push(Peer& peer, const Received& begin) {
    const Fault now = fault(static_cast<int>(attempts.size()));
    attempts.push_back(begin.json["attempt"].get<std::int64_t>());
    const auto number = begin.json["step"].get<std::int64_t>();
    const auto n = begin.json["n"].get<std::uint64_t>();
    if (now == Fault::busy_early) {
      peer.fail(begin, {Code::busy, "held by another"});
      // Slices that the client had begun are read by serve(), as a service reads and drops them.
      return true;
    }
    const bool first = !step;
    if (first) plan_ = plan::Plan::blocks(n, ranks_, {});
    std::vector<Received> slices;
    for (int i = 0; i < begin.json["slices"].get<int>(); ++i) {
      auto slice = peer.receive();
      if (!slice) return false;
      EXPECT_EQ(slice->json["command"], "push.slice");
      slices.push_back(std::move(*slice));
    }
    slices_read += static_cast<int>(slices.size());
    if (now == Fault::die_before_commit) return restart();
    if (now == Fault::close_before_commit) return false;
    if (step == number) {
      peer.reply(begin, {{"report", report(number, 0)}, {"plan", plan_json()}, {"repeated", true}});
      return true;
    }
    if (now == Fault::stale || (!first && begin.json["plan"] != plan_json())) {
      peer.fail(begin, {Code::stale_plan, "fetch the plan"});
      return true;
    }
    check_slices(begin, slices, number, first);
    if (begin.json["weights"] == true) take_weights(slices);
    return commit(peer, begin, number, first, now);
  }

  bool restart() {
    ++restarts;
    empty_now = true;
    step.reset();
    plan_.reset();
    part_.clear();
    epoch = 0;
    n_ = 0;
    has_ids_ = weights_ = false;
    weights.clear();
    return false;
  }

  // Behind the axes.
  void take_weights(const std::vector<Received>& slices) {
    weights_ = true;
    weights.assign(n_ == 0 ? plan_->count() : n_, -1);
    std::size_t next = 0;
    for (int rank = 0; rank < ranks_; ++rank) {
      const auto rows = plan_->rows(rank);
      if (rows.empty()) continue;
      const auto* from = slices[next++].bulk.data() + 8 * static_cast<std::size_t>(dims_) * rows.size();
      for (std::size_t i = 0; i < rows.size(); ++i) std::memcpy(&weights[rows[i]], from + 8 * i, 8);
    }
  }

  // Every rank's slice, value by value.
  void check_slices(const Received& begin, const std::vector<Received>& slices, std::int64_t number, bool first) {
    if (first && begin.json["ids"] == true) take_ids(begin, slices);
    EXPECT_EQ(begin.json["plan"], plan_json());
    std::size_t next = 0;
    for (int rank = 0; rank < ranks_; ++rank) {
      const auto rows = plan_->rows(rank);
      if (rows.empty()) continue;
      ASSERT_LT(next, slices.size());
      const Received& slice = slices[next++];
      EXPECT_EQ(slice.json["rank"], rank);
      ASSERT_EQ(slice.json["count"], rows.size());
      EXPECT_EQ(slice.json["attempt"], begin.json["attempt"]);
      ASSERT_GE(slice.bulk.size(), rows.size() * 8 * static_cast<std::size_t>(dims_));
      std::size_t wrong = 0;
      for (std::size_t axis = 0; axis < static_cast<std::size_t>(dims_); ++axis)
        for (std::size_t i = 0; i < rows.size(); ++i) {
          double value = 0;
          std::memcpy(&value, slice.bulk.data() + 8 * (axis * rows.size() + i), 8);
          wrong += value != position(plan_->id_of_row(rows[i]), axis, number) ? 1U : 0U;
        }
      EXPECT_EQ(wrong, 0U) << "rank " << rank << " step " << number;
    }
    EXPECT_EQ(next, slices.size());
  }

  void take_ids(const Received& begin, const std::vector<Received>& slices) {
    std::vector<std::int64_t> ids;
    for (const Received& slice : slices) {
      const auto count = slice.json["count"].get<std::size_t>();
      const std::size_t at = ids.size();
      ids.resize(at + count);
      std::memcpy(ids.data() + at, slice.bulk.data() + slice.bulk.size() - 8 * count, 8 * count);
    }
    has_ids_ = true;
    plan_ = plan::Plan::blocks(begin.json["n"].get<std::uint64_t>(), ranks_, ids);
  }

  bool commit(Peer& peer, const Received& begin, std::int64_t number, bool first, Fault now) {
    n_ = begin.json["n"].get<std::uint64_t>();
    std::vector<std::uint64_t> rows;
    std::vector<std::int32_t> to;
    std::vector<std::pair<std::int64_t, std::int32_t>> changed;
    if (first) part_.assign(n_, -1);
    for (std::uint64_t row = 0; row < n_; ++row) {
      const std::int32_t part = part_of(plan_->id_of_row(row), number);
      if (part == part_[row]) continue;
      part_[row] = part;
      rows.push_back(row);
      to.push_back(plan::rank_of_part(part, parts_, ranks_));
      changed.emplace_back(plan_->id_of_row(row), part);
    }
    EXPECT_TRUE(plan_->apply(rows, to, first).ok());
    std::sort(changed.begin(), changed.end());
    std::vector<std::int64_t> ids;
    std::vector<std::int32_t> parts;
    for (const auto& [id, part] : changed) {
      ids.push_back(id);
      parts.push_back(part);
    }
    if (first) epoch = 1;
    step = number;
    ++commits;
    first_of_recreated_ = first && restarts > 0;
    if (now == Fault::die_after_commit) return restart();
    if (now == Fault::close_after_commit) return false;
    wire::Json plan = plan_json();
    if (now == Fault::wrong_checksum) plan["checksum"] = "0123456789abcdef";
    std::string bytes = Peer::frame(
        wire::FrameType::reply, begin.header.request, {{"report", report(number, ids.size())}, {"plan", plan}},
        {array("changed_id", "<i8", ids), array("changed_part", "<i4", parts)}, number % 2 == 0);
    if (now == Fault::close_in_answer) bytes.resize(bytes.size() / 2);
    peer.send(wire::FrameType::notice, begin.header.request, {{"notice", "nearly done"}});
    peer.send_bytes(bytes);
    return now != Fault::close_in_answer;
  }

  wire::Json report(std::int64_t number, std::size_t moved) const {
    return {{"scene", "s"},
            {"step", number},
            {"epoch", epoch},
            {"n", n_},
            {"parts", parts_},
            {"scene_recreated", first_of_recreated_},
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
  std::uint64_t n_ = 0;
  bool has_ids_ = false;
  bool weights_ = false;
  bool first_of_recreated_ = false;
  std::optional<plan::Plan> plan_;
  std::vector<std::int32_t> part_;  // by row
};

}  // namespace rcb::client
