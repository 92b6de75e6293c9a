// A scene outlives its process, wherever that dies: its state is that after the last step that was answered or the one
// before, its cuts are those of the state, its history is whole. And what has been done to its files never makes it
// another scene than it was.
#include "server/scene/lasting.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <future>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <random>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/server/scene/counting.hpp"
#include "tests/server/scene/model.hpp"
#include "tests/support/simulated_storage.hpp"

namespace rcb::testing {
namespace {

using scene::Ledger;
using scene::Ledgers;
using wire::Json;

using Disk = std::shared_ptr<SimulatedStorage>;

Disk copy_of(const SimulatedStorage& disk) {
  auto copy = std::make_shared<SimulatedStorage>(disk);
  for (auto& [path, bytes] : copy->files) bytes = std::make_shared<std::string>(*bytes);
  return copy;
}

// All of a ledger that lasts.
Json picture_of(const Ledger& ledger) {
  const scene::SceneState& now = ledger.now();
  const auto or_null = [](const auto& value) { return value ? Json(*value) : Json(); };
  const scene::SceneTotals& totals = ledger.totals();
  Json json{{"options", to_json(now.options)},
            {"part_sizes", now.options.part_sizes},
            {"incarnation", now.incarnation},
            {"n", now.n},
            {"flags", {now.weights, now.ids}},
            {"epoch", now.epoch},
            {"hash", now.hash},
            {"search", {now.search_rounds, now.search_reductions}},
            {"step", or_null(now.step)},
            {"ids", or_null(now.id_sum)},
            {"terms", {to_json(ledger.terms({})), to_json(ledger.terms(0.01)), to_json(ledger.terms(5.0))}},
            {"counts", to_json(static_cast<const scene::StepCounts&>(totals))},
            {"totals", {totals.steps, totals.repartitions, totals.skipped, totals.asked}}};
  for (int seat = 0; seat < 3 && now.step; ++seat)
    json["seats"].push_back(ledger.was_in_last(fmt::format("seat {}", seat), *now.step));
  if (!now.loads) return json;
  json["loads"] = {now.loads->counts, now.loads->load_values, now.loads->part_errors, now.loads->targets};
  json["balance"] = {now.loads->error, now.loads->imbalance, now.loads->weighted, now.loads->scale_exponent,
                     now.loads->weights_as_zero};
  for (const u128 load : now.loads->loads)
    json["exact"].push_back({static_cast<std::uint64_t>(load >> 64U), static_cast<std::uint64_t>(load)});
  return json;
}

// Until the files of scenes that were dropped are removed.
void settle(const Ledgers& ledgers) {
  if (ledgers.empty()) return;
  std::promise<void> done;
  const auto reading = ledgers.begin()->second.history().reading(0, 0, nullptr);
  ASSERT_TRUE(reading([](const scene::FoundReports&) {}, [&done] { done.set_value(); }).ok());
  done.get_future().wait();
}

std::map<std::string, Json> pictures_of(const Ledgers& ledgers) {
  std::map<std::string, Json> pictures;
  for (const auto& [name, ledger] : ledgers) pictures[name] = picture_of(ledger);
  return pictures;
}

std::map<std::uint64_t, Json> reports_of(const Ledger& ledger) {
  std::map<std::uint64_t, Json> reports;
  const Status read = ledger.journal()->read(
      0, ledger.totals().steps,
      [&reports](std::uint64_t number, std::string_view text) { reports[number] = *wire::parse_json(text); });
  EXPECT_TRUE(read.ok()) << read.message();
  return reports;
}

// What happens to the scene "jet", and all that a solver and the ranks know of it. A copy goes on likewise. Beside it
// there is a scene "still", which is never pushed.
class Life {
 public:
  explicit Life(std::uint64_t seed) : random_(seed) {}

  void next(Ledgers& ledgers) {
    if (!ledgers.contains("still")) {
      ledgers.take({"still", scene::Created{random_options(random_, 2), {}}}, 0x5711);
      return;
    }
    Ledger* ledger = ledgers.find("jet");
    replaced_ = ledger == nullptr || chance(random_, 25);
    if (replaced_) return create(ledgers);
    if (chance(random_, 30)) {
      ledgers.take({"jet", scene::Dropped{}}, 0);
      return;
    }
    const scene::SceneState& now = ledger->now();
    if (now.step && now.positions_step == now.step && chance(random_, 6)) {
      scene::SceneOptions options = random_options(random_, world_->dims);
      options.positions = now.options.positions;
      if (chance(random_, 8)) options.parts = 700;  // a state, and cuts, that outgrow their place
      if (options.parts == 700) options.part_sizes.clear();
      ledgers.take({"jet", ranks_.rebalance(options)}, 0);
    } else {
      make_step(ledgers, *ledger);
    }
  }
  const std::vector<Json>& reports() const { return reports_; }
  std::size_t seats() const { return seats_; }  // of the last step
  bool replaced() const { return replaced_; }   // by what happened last

 private:
  void create(Ledgers& ledgers) {
    world_.emplace(random_);
    scene::SceneOptions options = random_options(random_, world_->dims);
    options.positions = one_of(random_, {scene::Travel::every_step, scene::Travel::when_needed});
    ranks_ = Ranks(options);
    reports_.clear();
    incarnation_ += 1 + random_.below(1000);
    ledgers.take({"jet", scene::Created{options, ranks_.held()}}, incarnation_);
  }

  void make_step(Ledgers& ledgers, Ledger& ledger) {
    step_ += 1 + static_cast<std::int64_t>(random_.below(3));
    world_->move(random_);
    seconds_ = chance(random_, 4) ? std::nullopt : std::optional(random_.uniform(0, 0.1));
    if (chance(random_, 4)) ledger.take(scene::Asked{"quality"});
    const std::vector<particles::Id> had(world_->set.id.begin(), world_->set.id.end());
    if (ledger.now().step && chance(random_, 12)) world_->exchange(random_);
    if (ledger.now().step && count(ledger, had)) return;
    scene::Stepped stepped = ranks_.push(world_->set, step_, ledger.terms(seconds_));
    stepped.step_seconds = seconds_;
    stepped.sessions = sessions();
    seats_ = stepped.sessions.size();
    reports_.push_back(to_json(*ledgers.take({"jet", std::move(stepped)}, 0)));
  }

  // Whether the step needed no more than its count. had: the ids of the step before; ids ascend.
  bool count(Ledger& ledger, const std::vector<particles::Id>& had) {
    const scene::SceneState& now = ledger.now();
    const auto view = world_->set.view();
    Buffer<std::int32_t> part(view.count);
    ranks_.tree().classify(view, part.span());
    scene::CountRecord record =
        count_rows(view, part.span(), 0, view.count, now.weights ? scale_needed(view).value_or(0) : 0);
    std::vector<particles::Id> both;
    std::ranges::set_intersection(world_->set.id.span(), had, std::back_inserter(both));
    record.step = step_;
    record.incarnation = now.incarnation;
    record.epoch = now.epoch;
    record.hash = now.hash;
    record.inserted = view.count - both.size();
    record.removed = had.size() - both.size();
    record.step_seconds = seconds_;
    record.sessions = sessions();
    const auto verdict = ledger.count(record);
    const auto* done = std::get_if<scene::CountVerdict::Committed>(&verdict.is);
    EXPECT_TRUE(done != nullptr || std::holds_alternative<scene::CountVerdict::Send>(verdict.is));
    if (done != nullptr) seats_ = record.sessions.size();
    if (done != nullptr) reports_.push_back(to_json(done->report));
    return done != nullptr;
  }

  // Of no seats, or of up to three.
  std::vector<std::uint64_t> sessions() {
    std::vector<std::uint64_t> sessions;
    for (std::uint64_t k = random_.below(4); k > 0; --k)
      sessions.push_back(scene::session_key(fmt::format("seat {}", k - 1)));
    return sessions;
  }

  Random random_;
  std::optional<World> world_;
  Ranks ranks_{scene::SceneOptions()};
  std::size_t seats_ = 0;
  std::uint64_t incarnation_ = 0x1000;
  std::int64_t step_ = -1;
  std::optional<double> seconds_;
  std::vector<Json> reports_;  // of the scene that is there
  bool replaced_ = false;
};

struct Moment {
  Life life;
  std::map<std::string, Json> pictures;
};

scene::Keeping keeping(const Disk& disk) { return {.keep_reports = 20, .storage = disk, .data_dir = "data"}; }

// A process, from its start on. `moments` has those after its start and after each of what happens until it dies.
void run(Life life, const Disk& disk, int count, std::vector<Moment>& moments) {
  Ledgers ledgers(keeping(disk));
  ledgers.restore();
  moments.push_back({life, pictures_of(ledgers)});
  for (int k = 0; k < count && !::testing::Test::HasFailure(); ++k) {
    life.next(ledgers);
    settle(ledgers);
    moments.push_back({life, pictures_of(ledgers)});
  }
}

// Of a scene as it was restored, which is that of this life. lost: how many reports may be missing.
void check_restored(const Ledger& ledger, const Life& life, std::uint64_t lost = 0) {
  const scene::SceneState& now = ledger.now();
  EXPECT_TRUE(!now.positions_step && !now.filled);
  EXPECT_EQ(ledger.totals().steps, ledger.history().total());
  EXPECT_EQ(now.tree != nullptr, now.step.has_value());
  if (!now.step) return;
  EXPECT_EQ(now.tree->hash(), now.hash);
  for (std::size_t k = 0; k < 4; ++k)
    EXPECT_EQ(ledger.was_in_last(fmt::format("seat {}", k), *now.step), k < life.seats()) << k;
  const auto reports = reports_of(ledger);
  ASSERT_EQ(ledger.totals().steps, life.reports().size());
  EXPECT_EQ(reports.size(), ledger.journal()->reports());
  EXPECT_GE(reports.size() + lost, life.reports().size());
  for (const auto& [number, report] : reports) EXPECT_EQ(report, life.reports()[number]) << number;
}

struct Seen {
  std::uint64_t died = 0, before = 0, after = 0, between = 0, steps = 0;
};

// The process dies at a random store or call, is started anew, dies again.
void live_and_die(std::uint64_t seed, Seen& seen) {
  Random random(mix64(seed));
  Life life(seed);
  auto disk = std::make_shared<SimulatedStorage>(seed);
  for (int start = 0; start < 5 && !::testing::Test::HasFailure(); ++start) {
    SCOPED_TRACE(fmt::format("start {}", start));
    const int count = 1 + static_cast<int>(random.below(25));
    std::vector<Moment> whole;
    run(life, copy_of(*disk), count, whole);
    std::vector<Moment> moments;
    disk->die_after(1 + random.below(3 * static_cast<std::uint64_t>(count) + 4));
    try {
      run(life, disk, count, moments);
    } catch (const ProcessDied&) {
      ++seen.died;
    }
    disk->live();
    disk = copy_of(*disk);
    const std::size_t at = moments.size();  // what it died of would have led to this moment
    for (std::size_t k = 0; k < at; ++k) EXPECT_EQ(moments[k].pictures, whole[k].pictures) << "not the same life";
    const Moment before = at > 0 ? whole[at - 1] : Moment{life, whole[0].pictures};
    const Moment& after = at < whole.size() ? whole[at] : before;

    Ledgers ledgers(keeping(disk));
    const scene::Restored restored = ledgers.restore();
    const auto found = pictures_of(ledgers);
    auto between = before.pictures;
    between.erase("jet");
    life = found == after.pictures ? after.life : before.life;
    if (found == before.pictures) ++seen.before;
    if (found == after.pictures) ++seen.after;
    if (found == between && after.life.replaced()) ++seen.between;  // the old one is gone, the new one not there yet
    EXPECT_TRUE(found == after.pictures || found == before.pictures || (found == between && after.life.replaced()))
        << Json(found) << "\nbefore: " << Json(before.pictures) << "\nafter: " << Json(after.pictures);
    EXPECT_EQ(restored.scenes, found.size());
    EXPECT_EQ(restored.lost_records, 0U);
    if (const Ledger* still = ledgers.find("still")) {
      EXPECT_FALSE(still->now().step);
    }
    const Ledger* jet = ledgers.find("jet");
    if (jet == nullptr) continue;
    check_restored(*jet, life);
    EXPECT_EQ(restored.steps, jet->totals().steps);
    seen.steps += jet->totals().steps;
  }
}

TEST(LastingScene, IsThatOfTheLastStepOrTheOneBeforeWhereverTheProcessDies) {
  const std::uint64_t seed = std::random_device{}();
  constexpr std::uint64_t kLives = 60;
  Seen seen;
  for (std::uint64_t k = 0; k < kLives && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", seed + k));
    live_and_die(seed + k, seen);
  }
  if (HasFailure()) return;
  for (const std::uint64_t count : {seen.died, seen.before, seen.after, seen.steps}) EXPECT_GT(count, kLives);
  EXPECT_GT(seen.between, 0U);
}

// Any moment of a life at which "jet" looked like this.
const Moment* find_moment(const std::vector<Moment>& moments, const Json& jet) {
  for (const Moment& moment : moments)
    if (const auto found = moment.pictures.find("jet"); found != moment.pictures.end() && found->second == jet)
      return &moment;
  return nullptr;
}

TEST(LastingScene, OnADiskThatFailsOrIsFullIsOneThatItWas) {
  const std::uint64_t seed = std::random_device{}();
  std::uint64_t lost = 0, stale = 0, gone = 0;
  for (std::uint64_t k = 0; k < 120 && !HasFailure(); ++k) {
    SCOPED_TRACE(fmt::format("seed {}", seed + k));
    Random random(mix64(seed + k));
    auto disk = std::make_shared<SimulatedStorage>(seed + k);
    std::vector<Moment> moments;
    run(Life(seed + k), disk, static_cast<int>(random.below(10)), moments);
    if (chance(random, 2))
      disk->fault_rate = random.uniform(0.1, 0.9);
    else
      disk->room = random.below(1U << 21U);
    const double rate = std::exchange(disk->fault_rate, 0);
    {
      Ledgers ledgers(keeping(disk));
      ledgers.restore();
      disk->fault_rate = rate;
      Life life = moments.back().life;
      for (int at = 0; at < 30; ++at) {
        life.next(ledgers);
        settle(ledgers);
        moments.push_back({life, pictures_of(ledgers)});
      }
    }
    disk->fault_rate = 0;
    disk->room = std::numeric_limits<std::size_t>::max();
    Ledgers ledgers(keeping(disk));
    const scene::Restored restored = ledgers.restore();
    Ledger* jet = ledgers.find("jet");
    if (jet == nullptr) {
      ++gone;
      continue;
    }
    const Moment* moment = find_moment(moments, picture_of(*jet));
    ASSERT_NE(moment, nullptr) << picture_of(*jet);
    check_restored(*jet, moment->life, restored.lost_records);
    EXPECT_EQ(restored.lost_records, jet->totals().steps - jet->journal()->reports());
    lost += restored.lost_records;
    if (moments.back().pictures != pictures_of(ledgers)) ++stale;
    // Once there is room, all lasts again.
    Life life = moment->life;
    for (int at = 0; at < 5; ++at) life.next(ledgers);
    settle(ledgers);
    Ledgers again(keeping(copy_of(*disk)));
    again.restore();
    const Ledger* last = ledgers.find("jet");
    const Ledger* kept = again.find("jet");
    ASSERT_EQ(last != nullptr, kept != nullptr);
    if (last != nullptr) {
      EXPECT_EQ(picture_of(*last), picture_of(*kept));
    }
  }
  EXPECT_GT(lost, 0U);
  EXPECT_GT(gone, 0U);
  EXPECT_GT(stale, 0U);
}

TEST(LastingScene, WhoseFilesAreDamagedIsOneThatItWasOrNone) {
  const std::uint64_t seed = std::random_device{}();
  std::uint64_t same = 0, older = 0, none = 0;
  for (std::uint64_t k = 0; k < 30 && !HasFailure(); ++k) {
    auto disk = std::make_shared<SimulatedStorage>(seed + k);
    std::vector<Moment> moments;
    run(Life(seed + k), disk, 25, moments);
    for (int damage = 0; damage < 40 && !HasFailure(); ++damage) {
      SCOPED_TRACE(fmt::format("seed {}, damage {}", seed + k, damage));
      Random random(mix64(seed + k) + static_cast<std::uint64_t>(damage));
      const Disk damaged = copy_of(*disk);
      const auto file = [&] {
        auto at = damaged->files.begin();
        std::advance(at, static_cast<std::ptrdiff_t>(random.below(damaged->files.size())));
        return at->second;
      };
      for (std::uint64_t times = 1 + random.below(3); times > 0; --times) {
        std::string& bytes = *file();
        const std::size_t used = std::max<std::size_t>(bytes.find_last_not_of('\0') + 1, 1);
        switch (random.below(4)) {
          case 0:
            bytes.resize(random.below(bytes.size() + 1));
            break;
          case 1:
            bytes = *file();
            break;
          default:
            if (!bytes.empty())
              bytes[random.below(std::min(used, bytes.size()))] ^= static_cast<char>(1U << random.below(8));
        }
      }
      Ledgers ledgers(keeping(damaged));
      const scene::Restored restored = ledgers.restore();
      Ledger* jet = ledgers.find("jet");
      Life life = moments.back().life;
      if (jet == nullptr) {
        ++none;
      } else {
        const Moment* moment = find_moment(moments, picture_of(*jet));
        ASSERT_NE(moment, nullptr) << picture_of(*jet);
        ++(picture_of(*jet) == moments.back().pictures["jet"] ? same : older);
        check_restored(*jet, moment->life, restored.lost_records);
        life = moment->life;
      }
      for (int at = 0; at < 4; ++at) life.next(ledgers);
    }
  }
  for (const std::uint64_t count : {same, older, none}) EXPECT_GT(count, 25U);
}

// A disk without room for larger states takes new cuts all the same, and must not take them in place of those that the
// state in the journal names.
TEST(LastingScene, KeepsTheCutsOfTheStateThatIsKept) {
  auto disk = std::make_shared<SimulatedStorage>(1);
  Json kept;
  {
    Ledgers ledgers(keeping(disk));
    Random random(3);
    ParticleSet particles;
    particles.dims = 1;
    particles.has_weights = true;
    particles.resize(2000);
    for (std::size_t i = 0; i < 2000; ++i) {
      particles.position[0][i] = random.uniform();
      particles.weight[i] = random.uniform(1, 2);
      particles.id[i] = static_cast<particles::Id>(i);
    }
    scene::SceneOptions options;
    options.parts = 3;
    options.dims = 1;
    Ranks ranks(options);
    ledgers.take({"jet", scene::Created{options, ranks.held()}}, 1);
    ledgers.take({"jet", ranks.push(particles, 0, {})}, 0);
    kept = picture_of(*ledgers.find("jet"));
    disk->room = 0;
    for (const int parts : {500, 501, 502}) {
      options.parts = parts;
      options.part_sizes.assign(static_cast<std::size_t>(parts), 1.1);
      options.part_sizes[0] = 1;
      ledgers.take({"jet", ranks.rebalance(options)}, 0);
    }
    disk->room = std::numeric_limits<std::size_t>::max();
  }
  {
    Ledgers ledgers(keeping(disk));
    EXPECT_EQ(ledgers.restore().scenes, 1U);
    ASSERT_TRUE(ledgers.contains("jet"));
    EXPECT_EQ(picture_of(*ledgers.find("jet")), kept);
  }
}

// New cuts that no state knows, since the process died in between, are those to be overwritten next.
TEST(LastingScene, IsThereHoweverOftenItsProcessDiesAsItsCutsChange) {
  Random random(5);
  World world(random);
  scene::SceneOptions options = random_options(random, world.dims);
  options.parts = 4;
  options.part_sizes.clear();
  Ranks ranks(options);
  auto first = std::make_shared<SimulatedStorage>(1);
  {
    Ledgers ledgers(keeping(first));
    ledgers.take({"jet", scene::Created{options, ranks.held()}}, 1);
    ledgers.take({"jet", ranks.push(world.set, 0, {})}, 0);
  }
  const auto rebalance = [&](const Disk& disk, int parts, std::uint64_t calls) {
    options.parts = parts;
    Ledgers ledgers(keeping(disk));
    ledgers.restore();
    disk->die_after(calls);
    try {
      ledgers.take({"jet", ranks.rebalance(options)}, 0);
    } catch (const ProcessDied&) {
    }
    disk->live();
  };
  for (std::uint64_t k = 0; k < 400; ++k) {
    SCOPED_TRACE(k);
    const Disk disk = copy_of(*first);
    for (const int parts : {5, 6, 7}) rebalance(disk, parts, 1 + random.below(3));
    Ledgers ledgers(keeping(disk));
    EXPECT_EQ(ledgers.restore().scenes, 1U);
    ASSERT_TRUE(ledgers.contains("jet"));
    const scene::SceneState& now = ledgers.find("jet")->now();
    EXPECT_EQ(now.tree->parts, now.options.parts);
    EXPECT_EQ(now.tree->hash(), now.hash);
  }
}

// A scene made, and stepped so many times by an engine that does nothing.
std::string make_scene(const Disk& disk, std::uint64_t incarnation, int steps) {
  Ledgers ledgers(keeping(disk));
  Random random(incarnation);
  World world(random);
  scene::SceneOptions options;
  options.parts = 3;
  options.dims = world.dims;
  ledgers.take({"jet", scene::Created{options, {}}}, incarnation);
  Ranks ranks(options);
  for (int step = 0; step < steps; ++step)
    ledgers.take({"jet", ranks.push(world.set, step, ledgers.find("jet")->terms({}))}, 0);
  return scene::SceneFolder{"jet", incarnation}.path("data");
}

TEST(LastingScene, OfTwoOfItsNameTheLaterGoesOn) {
  for (const auto& [first, second] : {std::pair{2, 5}, {5, 2}}) {
    auto disk = std::make_shared<SimulatedStorage>(1);
    const std::string earlier = make_scene(disk, 1, first);
    const std::string later = make_scene(disk, 2, second);
    {
      Ledgers ledgers(keeping(disk));
      const scene::Restored restored = ledgers.restore();
      EXPECT_EQ(restored.scenes, 1U);
      EXPECT_EQ(restored.steps, static_cast<std::uint64_t>(second));
      EXPECT_EQ(ledgers.find("jet")->now().incarnation, 2U);
    }
    EXPECT_FALSE(disk->files.contains(earlier + "/state")) << "it would come back once the later one is dropped";
    EXPECT_TRUE(disk->files.contains(later + "/state"));
  }
}

TEST(LastingScene, ThatIsDroppedLeavesNothing) {
  auto disk = std::make_shared<SimulatedStorage>(1);
  make_scene(disk, 1, 3);
  {
    Ledgers ledgers(keeping(disk));
    ledgers.restore();
    ledgers.forget("jet");
  }
  EXPECT_FALSE(disk->files.empty()) << "it stays for the next start";
  {
    Ledgers ledgers(keeping(disk));
    EXPECT_EQ(ledgers.restore().scenes, 1U);
    disk->fault_rate = 1;  // its files can't be removed
    ledgers.take({"jet", scene::Dropped{}}, 0);
  }
  disk->fault_rate = 0;
  EXPECT_FALSE(disk->files.empty());
  Ledgers ledgers(keeping(disk));
  EXPECT_EQ(ledgers.restore().scenes, 0U) << "it was dropped";
  EXPECT_TRUE(disk->files.empty());
  EXPECT_TRUE(disk->names_in("data/scenes")->empty());
}

TEST(LastingScene, WhoseMakingWasCutShortIsRemoved) {
  auto disk = std::make_shared<SimulatedStorage>(1);
  const std::string path = make_scene(disk, 1, 3);
  disk->files.erase(path + "/state");
  Ledgers ledgers(keeping(disk));
  EXPECT_EQ(ledgers.restore().scenes, 0U);
  EXPECT_TRUE(disk->names_in("data/scenes")->empty());
}

// Hostile bytes.

std::vector<std::string> encodings() {
  std::vector<std::string> all;
  for (std::uint64_t seed = 1; seed < 25; ++seed) {
    auto disk = std::make_shared<SimulatedStorage>(seed);
    std::vector<Moment> moments;
    run(Life(seed), disk, 12, moments);
    const auto folders = scene_folders(*disk, "data");
    for (const auto& folder : *folders) {
      scene::JournalFound found;
      EXPECT_TRUE(scene::Journal::open(*disk, "data", folder, found).ok());
      for (const auto* kind : {&found.states, &found.cuts})
        for (const std::string& bytes : *kind) all.push_back(bytes);
    }
  }
  return all;
}

class LastingBytes : public ::testing::Test {
 protected:
  // What can be read can be used, and is written again as it was read.
  bool read_and_use(const std::string& bytes);

 private:
  SimulatedStorage disk_{1};
  scene::HistoryMemory memory_{1};
};

bool LastingBytes::read_and_use(const std::string& bytes) {
  bool read = false;
  if (auto tree = scene::decode_tree(bytes); tree.ok()) {
    read = true;
    EXPECT_EQ(scene::decode_tree(scene::encode(*tree))->hash(), tree->hash());
  } else {
    EXPECT_EQ(tree.status().code(), Code::io_error);
  }
  auto lasting = scene::decode_lasting(bytes, 7);
  if (!lasting.ok()) {
    EXPECT_EQ(lasting.status().code(), Code::io_error);
    return read;
  }
  const std::string encoded = scene::encode(*lasting, scene::encode_frame(lasting->now));
  const auto again = scene::decode_lasting(encoded, 7);
  EXPECT_TRUE(again.ok()) << again.status().message();
  if (again.ok()) {
    EXPECT_EQ(scene::encode(*again, scene::encode_frame(again->now)), encoded);
  }
  auto journal = scene::Journal::create(disk_, "data", {"jet", 7});
  Ledger ledger("jet", *lasting, memory_, std::make_unique<scene::Journal>(std::move(*journal)));
  const auto terms = wire::parse_json(wire::dump_json(to_json(ledger.terms(0.1))));
  EXPECT_TRUE(terms.ok());
  if (terms.ok()) scene::read_terms(*terms);
  picture_of(ledger);
  if (ledger.now().loads) decide_step(ledger.now().options, *ledger.now().loads, ledger.terms(0.1));
  return true;
}

TEST_F(LastingBytes, AreReadWhateverTheyAre) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE(fmt::format("seed {}", seed));
  Random random(seed);
  const auto all = encodings();
  std::uint64_t changed = 0;
  for (const std::string& bytes : all) {
    EXPECT_TRUE(read_and_use(bytes));
    for (int k = 0; k < 100 && !HasFailure(); ++k) {
      std::string other = bytes;
      if (chance(random, 3)) other.resize(random.below(bytes.size()));
      for (std::uint64_t times = random.below(4); times > 0 && !other.empty(); --times)
        other[random.below(other.size())] = static_cast<char>(random.next());
      if (chance(random, 8)) other.insert(random.below(other.size() + 1), std::string(1 + random.below(9), '\xff'));
      if (read_and_use(other) && other != bytes) ++changed;
    }
  }
  EXPECT_GT(changed, 100U);
  for (int k = 0; k < 20000; ++k) {
    std::string bytes(random.below(64), '\0');
    for (char& byte : bytes) byte = static_cast<char>(random.next());
    EXPECT_FALSE(read_and_use(bytes));
  }
}

TEST_F(LastingBytes, OfHugeCountsAndDepthsAreRefused) {
  const std::string huge(8, '\xff');
  const std::string inside("\x81\xa1", 2);  // an object of one field, whose name has one letter
  for (int head = 0x80; head < 0x100; ++head) {
    const std::string one(1, static_cast<char>(head));
    EXPECT_FALSE(read_and_use(one + huge));
    EXPECT_FALSE(read_and_use(inside + "a" + one + huge));
    EXPECT_FALSE(read_and_use(inside + "a" + std::string(5'000'000, one[0])));
  }
  std::string nested;
  for (int k = 0; k < 1'000'000; ++k) nested += inside + "a";
  EXPECT_FALSE(read_and_use(nested));
}

// Calls visit(value) for each value in the JSON, in place.
void for_each_value(Json& json, const std::function<void(Json&)>& visit) {
  visit(json);
  if (json.is_structured())
    for (Json& inside : json) for_each_value(inside, visit);
}

std::string msgpack(const Json& json) {
  std::string bytes;
  Json::to_msgpack(json, bytes);
  return bytes;
}

// A state's frame, which is bytes of its own, as the object within.
Json unfolded(const std::string& bytes) {
  Json json = Json::from_msgpack(bytes);
  if (json.contains("frame")) json["frame"] = Json::from_msgpack(json["frame"].get_binary());
  return json;
}
std::string folded(Json json) {
  if (json.is_object() && json.contains("frame") && json["frame"].is_object()) {
    const std::string frame = msgpack(json["frame"]);
    json["frame"] = Json::binary({frame.begin(), frame.end()});
  }
  return msgpack(json);
}

TEST_F(LastingBytes, WithFieldsOfOtherTypesAndValuesAreReadOrRefused) {
  const std::vector<Json> others{nullptr,
                                 -1,
                                 std::numeric_limits<std::int64_t>::min(),
                                 std::numeric_limits<std::uint64_t>::max(),
                                 std::uint64_t{1} << 62U,
                                 1e300,
                                 -0.5,
                                 std::numeric_limits<double>::quiet_NaN(),
                                 std::numeric_limits<double>::infinity(),
                                 "\xff\xfe",
                                 "rcb",
                                 true,
                                 Json::array(),
                                 Json::object(),
                                 Json::binary({}),
                                 Json::binary(std::vector<std::uint8_t>(48, 0xff))};
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE(fmt::format("seed {}", seed));
  Random random(seed);
  std::uint64_t refused = 0;
  for (const std::string& bytes : encodings()) {
    Json json = unfolded(bytes);
    std::vector<Json*> values;
    for_each_value(json, [&values](Json& value) { values.push_back(&value); });
    if (values.size() > 400) continue;
    for (Json* value : values)
      for (const Json& other : others) {
        if (!chance(random, 5)) continue;
        Json was = other;
        std::swap(*value, was);
        if (!read_and_use(folded(json))) ++refused;
        std::swap(*value, was);
        if (HasFailure()) return;
      }
    const Json complete = json;
    for (const char* name : {"counts", "loads"}) {
      if (!complete.contains("loads") || !complete["loads"].is_object() || !complete["loads"].contains(name)) continue;
      Json more = complete;
      std::ranges::fill(more["loads"][name].get_binary(), std::uint8_t{0xff});
      EXPECT_FALSE(read_and_use(folded(more))) << "too many of " << name;
    }
    for (const bool in_frame : {false, true}) {
      if (in_frame && !complete.contains("frame")) continue;
      for (const auto& [name, value] : (in_frame ? complete["frame"] : complete).items()) {
        Json without = complete;
        (in_frame ? without["frame"] : without).erase(name);
        EXPECT_FALSE(read_and_use(folded(without))) << name;
      }
    }
  }
  EXPECT_GT(refused, 2000U);
}

}  // namespace
}  // namespace rcb::testing
