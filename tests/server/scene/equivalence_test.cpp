// One and the same history, whether every step's positions travel or only those that a count can't stand in for; and
// no trace in the ledger of what isn't a step. The service may die at any call that stores, and is started again.
#include <algorithm>
#include <array>
#include <iterator>
#include <memory>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include "server/scene/ledger.hpp"
#include "tests/server/scene/counting.hpp"
#include "tests/server/scene/model.hpp"
#include "tests/support/simulated_storage.hpp"

namespace rcb::testing {
namespace {

using scene::CountRecord;
using scene::Ledger;
using scene::SceneOptions;
using scene::Stepped;
using scene::StepReport;
using scene::Travel;
using wire::Json;

constexpr std::uint64_t kIncarnation = 0xC0FFEE;

std::string picture(const scene::DecisionTerms& terms) {
  return fmt::format("{} {} {} {} {}", terms.error_when_not_adopted.value_or(-1), terms.timed, terms.lost_seconds,
                     terms.repartition_seconds, terms.since.value_or(-1));
}

// All that can be seen of a ledger.
std::string picture(const Ledger& ledger) {
  const scene::SceneState& now = ledger.now();
  const scene::SceneTotals& totals = ledger.totals();
  return fmt::format("{} {} {} {} {} / {} {} {} {} {} {} {} {} {} / {} {} {} {} {} {} {} {} {} / {} {} {}",
                     now.options.parts, now.options.tolerance, now.options.cut_tolerance, now.options.part_sizes,
                     now.incarnation, now.step.value_or(-1), now.positions_step.value_or(-1), now.id_sum.value_or(0),
                     now.n, now.others, now.weights, now.epoch, now.hash, static_cast<const void*>(now.loads.get()),
                     totals.steps, totals.repartitions, totals.bytes, totals.drifted, totals.moved,
                     totals.seconds.search, totals.skipped, totals.asked, ledger.history().total(),
                     picture(ledger.terms(0.1)), picture(ledger.terms({})), ledger.wants_positions());
}

// One random scene, stepped by pushes alone (`every`) and by counts and pushes (`lazy`).
class TwoLedgers {
 public:
  // What came about, over all scenes.
  struct Seen {
    std::uint64_t committed = 0, sent = 0, wasted = 0, other_cuts = 0, other_scale = 0, lost = 0, rebalanced = 0,
                  died_before = 0, died_after = 0;
    std::uint64_t flowed = 0, flowed_on = 0, emptied = 0;
    std::array<std::uint64_t, 14> faults{};
  };

  TwoLedgers(std::uint64_t seed, Seen& seen) : random_(seed), seen_(seen) {
    ledgers_->take({"jet", scene::Created{with(options_, Travel::when_needed), lazy_ranks_.held()}}, kIncarnation);
  }

  void run() {
    for (int k = 0; k < 12 && !::testing::Test::HasFailure(); ++k) {
      SCOPED_TRACE(fmt::format("step {}", step_));
      step();
    }
    const auto all = reports(every_, 0);
    const auto other = reports(lazy(), 0);
    ASSERT_EQ(all.size(), other.size());
    for (std::size_t k = 0; k < all.size(); ++k) expect_alike(all[k], other[k]);
  }

 private:
  static SceneOptions with(SceneOptions options, Travel travel) {
    options.positions = travel;
    return options;
  }

  Ledger& lazy() { return *ledgers_->find("jet"); }

  // The service has died, and another takes up what it has kept.
  // before: the ranks without this step, if they have taken it.
  void restart(const Ranks* before = nullptr) {
    disk_->live();
    ledgers_ = std::make_unique<scene::Ledgers>(keeping_);
    EXPECT_EQ(ledgers_->restore().scenes, 1U);
    const bool committed = lazy().now().step == step_;
    ++(committed ? seen_.died_after : seen_.died_before);
    if (before != nullptr && !committed) lazy_ranks_ = *before;
    others_ = false;
    if (committed)
      positions_lost_ = true;
    else
      positions_step_.reset();
  }

  // Does what may store; returns false if the service died of it.
  template <typename Work>
  bool survives(const Work& work) {
    if (lazy().now().step && chance(random_, 10)) disk_->die_after(1 + random_.below(8));
    try {
      work();
    } catch (const ProcessDied&) {
      return false;
    }
    disk_->live();
    return true;
  }

  void step() {
    world_.move(random_);
    if (lazy().now().step && chance(random_, 5)) world_.exchange(random_);
    flow();
    step_ += 1 + static_cast<std::int64_t>(random_.below(3));
    if (lazy().now().step && chance(random_, 20)) restart();
    if (chance(random_, 8)) session_ = fmt::format("run {}", step_);
    seconds_ = chance(random_, 4) ? std::nullopt : std::optional(random_.uniform(0, 0.1));
    if (lazy().now().step && chance(random_, 8)) rebalance_due_ = true;
    if (rebalance_due_ || chance(random_, 10)) lazy().want_positions();
    if (chance(random_, 4)) lazy().take(scene::Asked{"quality"});
    const bool others = lazy().now().others;
    const std::string outcome = count();
    const bool send = outcome.starts_with("send: ");
    if (send && chance(random_, 6)) {  // never followed by its push
      ++seen_.lost;
      return;
    }
    const bool first = !every_.now().step;
    const bool emptied = ids_.empty() != (world_.set.count() == 0);
    const bool due = emptied || first || lazy().wants_positions() || !had_positions_;
    if (flows() && !send) ++seen_.flowed;
    seen_.flowed_on += others && send && had_positions_ ? 1 : 0;
    seen_.emptied += emptied ? 1 : 0;
    bool held = false;
    Stepped all = every_ranks_.push(world_.set, step_, every_.terms(seconds_));
    EXPECT_TRUE(send == (due || all.report.repartitioned || all.wasted)) << outcome;
    take(every_, std::move(all));
    if (send) held = push();
    numbers_.push_back(step_);
    sessions_.push_back(session_);
    compare(first || (send && held) || drifted_.has_value(), send);
    lose_answer();
    ids_.assign(world_.set.id.begin(), world_.set.id.end());
    learn(send);
    if (rebalance_due_ && lazy().now().positions_step == lazy().now().step) rebalance();
  }

  // Returns whether the ranks held the positions of the step before.
  bool push() {
    ++seen_.sent;
    for (;;) {
      const bool held = lazy().now().positions_step == lazy().now().step;
      const auto terms = wire::parse_json(wire::dump_json(to_json(lazy().terms(seconds_))));
      const Ranks before = lazy_ranks_;
      Stepped one = lazy_ranks_.push(world_.set, step_, scene::read_terms(*terms));
      seen_.wasted += one.wasted ? 1 : 0;
      one.drifted = drifted_;
      if (survives([&] { take(lazy(), one); })) return held;
      restart(&before);
      if (lazy().now().step == step_) return held;
    }
  }

  void take(Ledger& ledger, Stepped stepped) {
    stepped.sessions = {scene::session_key(session_)};
    stepped.step_seconds = seconds_;
    stepped.report.inserted = come_;
    stepped.report.removed = go_;
    const StepReport& report = ledger.take(std::move(stepped));
    EXPECT_EQ(report.step, step_);
  }

  // Counts the step until the verdict is about the step itself; returns it.
  std::string count() {
    for (;;) {
      look();
      const std::vector<CountRecord> seats = requests();
      const scene::SceneState& now = lazy().now();
      const auto due = now.weights ? scale_needed(world_.set.view()) : std::nullopt;
      const std::string before = picture(lazy());
      if (now.step && cuts_.epoch == now.epoch && (!due || *due == scale_)) {
        const bool judged = now.positions_step && ids_.empty() == (world_.set.count() == 0);
        for (std::uint64_t k = judged ? random_.below(4) : 0; k > 0; --k) disturb(seats, due);
        EXPECT_EQ(ask(every_, at_step(seats, step_)), "send: the scene's ranks hold every step");
      }
      std::string outcome;
      had_positions_ = now.positions_step.has_value();
      if (!survives([&] { outcome = ask(lazy(), seats); })) {
        restart();
        if (lazy().now().step != step_) continue;
        outcome = fmt::format("committed after {}", numbers_.back());
      }
      if (outcome.starts_with("committed")) {
        EXPECT_EQ(outcome, fmt::format("committed after {}", numbers_.back()));
        ++seen_.committed;
        return outcome;
      }
      EXPECT_EQ(picture(lazy()), before) << outcome;
      if (outcome.starts_with("send: ")) {
        EXPECT_EQ(ask(lazy(), at_step(seats, step_ + 2)), outcome);
        EXPECT_EQ(ask(lazy(), seats), outcome);
        EXPECT_EQ(picture(lazy()), before);
        return outcome;
      }
      if (outcome == "other cuts") {
        EXPECT_NE(cuts_.epoch, now.epoch);
        ++seen_.other_cuts;
        cuts_ = {lazy_ranks_.tree(), now.epoch, now.hash};
        part_known_ = false;
      } else {
        EXPECT_EQ(outcome, fmt::format("other scale {}", due.value_or(0)));
        if (!due || scale_ == *due) return outcome;
        ++seen_.other_scale;
        scale_ = *due;
      }
    }
  }

  // How many have come and gone since the last step; ids ascend.
  void flow() {
    const std::span<const particles::Id> now = world_.set.id.span();
    std::vector<particles::Id> both;
    std::ranges::set_intersection(now, ids_, std::back_inserter(both));
    come_ = lazy().now().step ? now.size() - both.size() : 0;
    go_ = ids_.size() - both.size();
  }
  bool flows() const { return come_ + go_ > 0; }

  // The parts of all rows by the cuts that the client knows.
  void look() {
    part_.resize(world_.set.count());
    std::ranges::fill(part_, 0);
    if (cuts_.epoch > 0) cuts_.tree.classify(world_.set.view(), part_.span());
    drifted_ = part_known_ && !flows() ? std::optional(differences(part_, last_part_)) : std::nullopt;
  }
  std::vector<CountRecord> requests() {
    const std::size_t n = world_.set.count();
    std::size_t count = chance(random_, 3) ? 2 + random_.below(3) : 1;
    std::vector<CountRecord> seats;
    std::uint64_t come = come_, go = go_;  // that the seats to come tell
    for (std::size_t seat = 0, first = 0; seat < count; ++seat) {
      const std::size_t last = seat + 1 == count ? n : first + random_.below(n - first + 1);
      CountRecord& one =
          seats.emplace_back(count_rows(world_.set.view(), part_.span(), std::exchange(first, last), last, scale_));
      one.session = session_;
      one.step = step_;
      one.incarnation = kIncarnation;
      one.epoch = cuts_.epoch;
      one.hash = cuts_.hash;
      if (drifted_) one.drifted = count > 1 ? 0 : *drifted_;  // a seat doesn't know where its rows were
      if (seconds_) one.step_seconds = seat == 0 ? *seconds_ : 0;
      if (count == 1 && !tells_ids_ && !flows()) one.id_sum.reset();
      const bool all = seat + 1 == count;  // the seats before it tell some
      one.inserted = all ? come : random_.below(come + 1);
      one.removed = all ? go : random_.below(go + 1);
      come -= one.inserted;
      go -= one.removed;
    }
    if (count > 1) drifted_.reset();
    return seats;
  }

  static std::vector<CountRecord> at_step(std::vector<CountRecord> seats, std::int64_t step) {
    for (CountRecord& seat : seats) {
      seat.step = step;
      seat.session = "another";
    }
    return seats;
  }

  // Asks something that must change nothing, made of counts that could be committed.
  void disturb(std::vector<CountRecord> seats, std::optional<int> due) {
    if (world_.set.count() == 0) seats.resize(1);
    std::size_t at = random_.below(seats.size());  // with particles: what the others counted by doesn't matter
    while (seats.size() > 1 && seats[at].n == 0) at = (at + 1) % seats.size();
    CountRecord& one = seats[at];
    std::string expected = "refused not_conserved";
    const std::uint64_t fault = random_.below(seen_.faults.size());
    const std::uint64_t k = random_.below(numbers_.size());
    switch (fault) {
      case 0:  // an old step, by another session
        seats = at_step(seats, numbers_[k]);
        expected = "refused stale_step";
        break;
      case 1:
        for (CountRecord& seat : seats) {
          seat.step = numbers_[k];
          seat.session = sessions_[k];
        }
        expected = k + 1 < numbers_.size() ? "refused stale_step" : "repeated";
        break;
      case 2:
        one.hash ^= 1U;
        expected = "other cuts";
        break;
      case 3:
        --one.epoch;
        expected = "other cuts";
        break;
      case 4:
        for (CountRecord& seat : seats) ++seat.incarnation;
        expected = "refused not_found";
        break;
      case 5:  // one particle more
        if (one.n == 0) {
          one.parts = {0};
          one.counts = {0};
        }
        ++one.counts[0];
        ++one.n;
        break;
      case 6:  // another particle
        if (!lazy().now().id_sum || flows()) return;
        one.id_sum = random_.next();
        break;
      case 7:
        if (one.n == 0) return;
        for (CountRecord& seat : seats) {
          if (seat.weights)
            seat.weights.reset();
          else
            seat.weights.emplace().loads.resize(seat.parts.size());
        }
        expected = "refused invalid_argument";
        break;
      case 8:
        if (!due || one.n == 0) return;
        one.weights->scale = *due + 1;
        expected = fmt::format("other scale {}", *due);
        break;
      case 9:  // a load that no weights have
        if (!due || one.n == 0) return;
        one.weights->loads[0] = u128{1} << 127U;
        expected = "refused invalid_argument";
        break;
      case 10:  // a part that isn't there
        if (one.n == 0) return;
        one.parts.back() = lazy().now().options.parts;
        expected = "refused invalid_argument";
        break;
      case 11:  // comes, and isn't there
        ++one.inserted;
        break;
      case 12:  // comes, and nobody says which
        if (seats.size() > 1 || one.n == 0 || lazy().now().n <= go_) return;
        ++one.inserted;
        ++one.removed;
        one.id_sum.reset();
        expected = "refused invalid_argument";
        break;
      default:
        ++one.n;
        expected = "malformed invalid_argument";
    }
    ++seen_.faults[fault];
    const std::string before = picture(lazy());
    EXPECT_EQ(ask(lazy(), seats), expected) << "fault " << fault;
    EXPECT_EQ(picture(lazy()), before) << "fault " << fault;
  }

  // drifted: whether anybody could know it.
  void compare(bool drifted, bool sent) {
    const Json one = reports(every_, every_.history().total() - 1).at(0);
    const Json other = reports(lazy(), lazy().history().total() - 1).at(0);
    expect_alike(one, other);
    EXPECT_EQ(other["drifted"], drifted ? one["drifted"] : Json());
    EXPECT_EQ(other["sent"], sent);
    if (sent) positions_step_ = step_;
    EXPECT_EQ(other["positions_step"], positions_step_ ? Json(*positions_step_) : Json());
    others_ = !sent && !positions_lost_ && (others_ || flows());
    EXPECT_EQ(lazy().now().others, others_);
    if (std::exchange(positions_lost_, false)) positions_step_.reset();
    EXPECT_EQ(lazy().now().positions_step, positions_step_);
    EXPECT_FALSE(sent && lazy().wants_positions());
    EXPECT_EQ(lazy().now().step, step_);
    EXPECT_EQ(lazy().now().n, world_.set.count());
    EXPECT_EQ(lazy().now().id_sum.value_or(*every_.now().id_sum), every_.now().id_sum);
    EXPECT_EQ(one["inserted"], come_);
    EXPECT_EQ(one["removed"], go_);
    EXPECT_EQ(every_.now().hash, lazy().now().hash);
    EXPECT_EQ(every_.now().loads->loads, lazy().now().loads->loads);
    EXPECT_EQ(every_.now().loads->part_errors, lazy().now().loads->part_errors);
    EXPECT_EQ(picture(every_.terms(0.1)), picture(lazy().terms(0.1)));
    EXPECT_EQ(every_.totals().steps, lazy().totals().steps);
    EXPECT_EQ(every_.totals().repartitions, lazy().totals().repartitions);
  }
  static void expect_alike(const Json& one, const Json& other) {
    for (const char* name : {"scene", "step", "n", "parts", "error_before", "error", "imbalance", "repartitioned",
                             "reason", "epoch", "moved", "axes_flipped", "inserted", "removed", "weights_as_zero"})
      EXPECT_EQ(one.value(name, Json()), other.value(name, Json())) << name;
  }
  // The answer doesn't arrive: the step is counted again, or pushed, which asks for what is remembered.
  void lose_answer() {
    const std::string before = picture(lazy());
    EXPECT_EQ(ask(lazy(), requests()), "repeated");
    for (const auto& [session, step] : {std::pair(session_, step_), {session_ + "'", step_}, {session_, step_ + 1}})
      EXPECT_EQ(lazy().was_in_last(session, step), session == session_ && step == step_);
    EXPECT_EQ(picture(lazy()), before);
  }

  // What the client knows after a step.
  void learn(bool sent) {
    if (sent) cuts_ = {lazy_ranks_.tree(), lazy().now().epoch, lazy().now().hash};
    last_part_.resize(world_.set.count());
    cuts_.tree.classify(world_.set.view(), last_part_.span());
    part_known_ = true;
  }

  void rebalance() {
    const SceneOptions options = random_options(random_, world_.dims);
    every_.take(every_ranks_.rebalance(with(options, Travel::every_step)));
    lazy().take(lazy_ranks_.rebalance(with(options, Travel::when_needed)));
    EXPECT_EQ(every_.now().hash, lazy().now().hash);
    rebalance_due_ = false;
    ++seen_.rebalanced;
  }

  struct KnownCuts {
    cuts::CutTree tree;
    std::uint64_t epoch = 0;
    std::uint64_t hash = 0;
  };

  Random random_;
  Seen& seen_;
  World world_{random_};
  SceneOptions options_ = random_options(random_, world_.dims);
  Ranks every_ranks_{with(options_, Travel::every_step)};
  Ranks lazy_ranks_{with(options_, Travel::when_needed)};
  scene::HistoryMemory memory_{100};
  Ledger every_{"jet", {with(options_, Travel::every_step), every_ranks_.held()}, kIncarnation, memory_, nullptr};
  std::shared_ptr<SimulatedStorage> disk_ = std::make_shared<SimulatedStorage>(random_.next());
  scene::Keeping keeping_{.keep_reports = 100, .storage = disk_, .data_dir = "/data"};
  std::unique_ptr<scene::Ledgers> ledgers_ = std::make_unique<scene::Ledgers>(keeping_);  // with the lazy one
  bool tells_ids_ = chance(random_, 2);

  // The client's:
  std::int64_t step_ = -1;
  std::string session_ = "run";
  std::optional<double> seconds_;
  KnownCuts cuts_;
  int scale_ = 0;
  Buffer<std::int32_t> part_;       // at this step
  Buffer<std::int32_t> last_part_;  // at the step before, by the cuts it knows
  bool part_known_ = false;
  std::optional<std::uint64_t> drifted_;  // as the count said

  std::vector<std::int64_t> numbers_;  // of the steps in the history
  std::vector<std::string> sessions_;
  std::vector<particles::Id> ids_;  // of the last step
  std::uint64_t come_ = 0, go_ = 0;
  bool others_ = false;  // the ranks hold
  std::optional<std::int64_t> positions_step_;
  bool had_positions_ = false;   // the ranks, of a step that is known, as it was counted
  bool positions_lost_ = false;  // the service died after it had kept the step
  bool rebalance_due_ = false;
};

TEST(Ledger, CountsLeaveTheHistoryThatPushesLeave) {
  const auto level = spdlog::get_level();
  spdlog::set_level(spdlog::level::off);  // what the services that died have left half done
  constexpr std::uint64_t kScenes = 500;
  TwoLedgers::Seen seen;
  for (std::uint64_t seed = 1; seed <= kScenes && !HasFailure(); ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    TwoLedgers(seed, seen).run();
  }
  spdlog::set_level(level);
  if (HasFailure()) return;
  for (const std::uint64_t count :
       {seen.committed, seen.sent, seen.wasted, seen.other_cuts, seen.other_scale, seen.lost, seen.rebalanced,
        seen.died_before, seen.died_after, seen.flowed, seen.flowed_on, seen.emptied})
    EXPECT_GT(count, kScenes / 20);
  for (const std::uint64_t count : seen.faults) EXPECT_GT(count, kScenes / 10);
}

}  // namespace
}  // namespace rcb::testing
