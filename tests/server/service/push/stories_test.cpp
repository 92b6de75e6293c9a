// A step is its particles, whoever brings them and by whichever way: one history by one client and by seats, through
// the endpoint, over sockets and from shared memory, on any number of ranks.
#include "tests/server/service/push/stories.hpp"

#include <set>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

const std::vector<int> kManyRanks{1, 2, 3, 4, 5, 6, 7, 8};

struct Frame {
  Particles particles;
  std::uint64_t inserted = 0, removed = 0;
};

struct Story {
  std::uint64_t seed = 0;
  Json options;
  int parts = 1;
  bool ids = false, float32 = false;
  std::vector<Frame> frames;
};

// Moves all, most often to one side; on a grid many are then in one place.
void move_on(Particles& particles, bool on_grid, bool float32, Random& random) {
  const double width = random.below(4) == 0 ? 0.3 : 0.02, power = random.uniform(0.8, 1.3);
  for (auto& axis : particles.position)
    for (double& x : axis) {
      x = std::pow(std::abs(x + random.uniform(-width, width)), power);
      if (on_grid) x = std::round(x * 4) / 4;
      if (float32) x = static_cast<double>(static_cast<float>(x));
    }
}

Story make_story(std::uint64_t seed) {
  Random random(seed);
  const auto one_in = [&random](std::uint64_t count) { return random.below(count) == 0; };
  Story story{.seed = seed};
  story.parts = 1 + static_cast<int>(random.below(9));
  story.ids = one_in(2);
  story.float32 = one_in(3);
  const bool weights = one_in(2), on_grid = one_in(3), row_numbers = one_in(3);
  const int dims = 1 + static_cast<int>(random.below(3));
  const std::vector<Json> tolerances{0.02, 0.1, 0.5, "inf"};
  story.options = {{"parts", story.parts}, {"dims", dims}, {"tolerance", tolerances[random.below(4)]}};
  Particles now;
  now.dims = dims;
  const std::size_t n = one_in(5) ? random.below(4) : 40 + random.below(200);
  add_particles(now, n, story.ids, weights, random);
  for (std::size_t k = 0; k < n && row_numbers && story.ids; ++k) now.ids[k] = static_cast<std::int64_t>(n - 1 - k);
  for (int step = 0; step < 7; ++step) {
    Frame frame;
    if (step > 0 && story.ids && one_in(2)) {
      std::vector<std::size_t> rows = shuffled(now.count(), random);
      frame.removed = one_in(8) ? rows.size() : random.below(rows.size() / 4 + 1);
      rows.resize(rows.size() - frame.removed);
      keep_rows(now, rows);
      frame.inserted = random.below(30);
      add_particles(now, frame.inserted, true, weights, random);
    }
    move_on(now, on_grid, story.float32, random);
    frame.particles = now;
    story.frames.push_back(frame);
  }
  return story;
}

// in_order: rows without ids, so that those for the next rank follow those for the last.
enum class Teller { held, divided, direct, in_order, listed, seats, any };
constexpr Teller kTellers[] = {Teller::held,   Teller::divided, Teller::direct, Teller::in_order,
                               Teller::listed, Teller::seats,   Teller::any};

struct Telling {
  std::vector<Block> blocks;
  bool ids = false;
  int seats = 1;
};

Telling tell_by_seats(const Story& story, const Particles& particles, int ranks, Random& random) {
  const std::uint64_t seats = 1 + random.below(5);
  std::vector<Block> blocks(seats);
  for (const std::size_t row : shuffled(particles.count(), random)) blocks[random.below(seats)].rows.push_back(row);
  if (random.below(3) == 0 && seats > 1) {  // one has nothing
    blocks[0].rows.insert(blocks[0].rows.end(), blocks[1].rows.begin(), blocks[1].rows.end());
    blocks[1].rows.clear();
  }
  for (std::size_t k = 0; k < seats; ++k) {
    blocks[k].seat = static_cast<int>(k);
    blocks[k].path = std::vector{Path::gateway, Path::direct, Path::listed}[random.below(3)];
    blocks[k].is_float32 = story.float32 && random.below(2) == 0;
    if (blocks[k].path != Path::gateway) to_random_ranks(blocks[k], ranks, random);
  }
  return {std::move(blocks), true, static_cast<int>(seats)};
}

Telling tell(Teller teller, const Story& story, std::size_t step, int ranks, Random& random) {
  const Particles& particles = story.frames[step].particles;
  if (teller == Teller::any) teller = kTellers[random.below(6)];
  if (teller == Teller::seats) return tell_by_seats(story, particles, ranks, random);
  if (teller == Teller::held && story.ids && step > 0) teller = Teller::listed;
  Telling telling{.blocks = {}, .ids = story.ids || teller == Teller::direct};
  Block block = all_rows(particles);
  block.is_float32 = story.float32;
  block.path = teller == Teller::held      ? Path::held
               : teller == Teller::listed  ? Path::listed
               : teller == Teller::divided ? Path::gateway
                                           : Path::direct;
  if (teller == Teller::divided && random.below(2) == 0) telling.ids = true;
  if (telling.ids && teller != Teller::held) block.rows = shuffled(particles.count(), random);
  if (teller == Teller::direct || teller == Teller::listed || (teller == Teller::in_order && random.below(2) == 0))
    to_random_ranks(block, ranks, random);
  if (teller == Teller::in_order) std::ranges::sort(block.ranks);
  if (!telling.ids) block.by_socket.clear();
  telling.blocks = {std::move(block)};
  return telling;
}

bool are_row_numbers(const Particles& particles) {
  const std::set<std::int64_t> ids(particles.ids.begin(), particles.ids.end());
  return ids.empty() || (*ids.begin() == 0 && *ids.rbegin() == std::ssize(ids) - 1);
}

// What a step's report tells of the step, and not of the way by which it came.
Json told_of_step(const Json& report) {
  Json told;
  for (const char* name : {"step", "n", "error_before", "error", "imbalance", "repartitioned", "reason", "epoch",
                           "moved", "axes_flipped", "inserted", "removed", "scanned"})
    told[name] = report.at(name);
  told["as_zero"] = report.value("weights_as_zero", 0);
  return told;
}

using PartOf = std::map<std::int64_t, std::int32_t>;

PartOf parts_in(const Response& assigned) {
  const auto ids = values_of<std::int64_t>(assigned, "id");
  const auto parts = values_of<std::int32_t>(assigned, "part");
  PartOf part_of;
  for (std::size_t k = 0; k < ids.size(); ++k) part_of[ids[k]] = parts[k];
  return part_of;
}

std::uint64_t bytes_of(const Telling& telling, const Particles& particles) {
  std::uint64_t bytes = 0;
  for (const Block& block : telling.blocks)
    bytes += block.rows.size() * ((block.is_float32 ? 4U : 8U) * particles.position.size() +
                                  (particles.weights.empty() ? 0U : 8U) + (telling.ids ? 8U : 0U));
  return bytes;
}

// What depends on the way. Of drift and strangers the parts tell where they are under the same cuts before and after.
void check_work(const Story& story, const Telling& telling, const Particles& particles, const Json& report,
                const PartOf& before, const PartOf& after) {
  EXPECT_EQ(report["bytes"], bytes_of(telling, particles));
  EXPECT_EQ(report["scanned"], particles.count());
  const bool first = report["step"] == 0, new_cuts = report["repartitioned"];
  const bool held = !first && telling.blocks[0].path == Path::held && particles.count() > 0;
  std::uint64_t drifted = 0, strangers = 0;
  for (const auto& [id, part] : after)
    if (held && before.at(id) != part) ++drifted;
  for (const Block& block : telling.blocks)
    for (const std::size_t row : block.rows) {
      const std::int32_t part = after.at(id_of(particles, row));
      if (telling.seats > 1 && layout::rank_of_part(part, story.parts, telling.seats) != block.seat) ++strangers;
    }
  if (first || (held && !new_cuts)) {
    EXPECT_EQ(report["drifted"], drifted);
  }
  if (!first && !held && particles.count() > 0) {
    EXPECT_TRUE(report["drifted"].is_null()) << report["drifted"];
  }
  if (first || telling.seats <= 1) {
    EXPECT_EQ(report["strangers"], 0);
  } else if (!new_cuts) {
    EXPECT_EQ(report["strangers"], strangers);
  }
}

struct Tally {
  int repartitions = 0, quiet = 0, migrated = 0, strangers = 0, drifted = 0, flows = 0;
};

void tell_story(comm::Comm& comm, const Story& story, Teller teller, Reference& reference, Tally& tally) {
  OwnDriver driver(comm, "story", story.options);
  Random random(story.seed * 16 + static_cast<std::uint64_t>(teller));
  PartOf before;
  for (std::size_t step = 0; step < story.frames.size(); ++step) {
    const auto& [particles, inserted, removed] = story.frames[step];
    const Telling telling = tell(teller, story, step, comm.size(), random);
    const Response pushed = driver.push(particles, telling.blocks, static_cast<std::int64_t>(step), telling.ids,
                                        telling.seats, flow(inserted, removed));
    const Response shown = driver.ask("scene.show"), fetched = driver.ask("fetch"), assigned = driver.ask("assign");
    if (comm.rank() != 0) continue;
    SCOPED_TRACE(
        fmt::format("seed {}, teller {}, step {}, {} ranks", story.seed, static_cast<int>(teller), step, comm.size()));
    EXPECT_TRUE(pushed.status.ok()) << pushed.status.message();
    if (!pushed.status.ok()) continue;
    const Json& report = pushed.json["report"];
    Json told = told_of_step(report);
    for (const char* name : {"hash", "ids", "counts", "weights"}) told[name] = shown.json[name];
    reference.check(fmt::format("{}/{}", story.seed, step), told);
    reference.check(fmt::format("{}/{} on {}", story.seed, step, comm.size()), report["migrated"]);
    EXPECT_LE(report["migrated"], comm.size() > 1 ? report["moved"].get<std::uint64_t>() : 0);
    EXPECT_EQ(shown.json["ids"].get<bool>(), !are_row_numbers(particles));
    check_particles(fetched, particles);
    const PartOf after = parts_in(assigned);
    check_work(story, telling, particles, report, before, after);
    before = after;
    tally.repartitions += step > 0 && report["repartitioned"].get<bool>() ? 1 : 0;
    tally.quiet += report["repartitioned"].get<bool>() ? 0 : 1;
    tally.migrated += report["migrated"] > 0 ? 1 : 0;
    tally.strangers += report["strangers"] > 0 ? 1 : 0;
    tally.drifted += report["drifted"].is_number() && report["drifted"] > 0 ? 1 : 0;
    tally.flows += report["inserted"] > 0 && report["removed"] > 0 ? 1 : 0;
  }
}

TEST(Stories, AreTheSameWhoeverTellsThem) {
  Reference reference;
  Tally tally;
  on_ranks(kManyRanks, [&](comm::Comm& comm) {
    Tally others;
    for (std::uint64_t seed = 1; seed <= 16; ++seed) {
      const Story story = make_story(seed);
      for (const Teller teller : kTellers)
        tell_story(comm, story, teller, reference, comm.rank() == 0 ? tally : others);
    }
    if (comm.rank() != 0) return;
    for (const int seen : {tally.repartitions, tally.quiet, tally.strangers, tally.drifted, tally.flows,
                           tally.migrated + 20 / comm.size()})
      EXPECT_GT(seen, 10) << "the stories are too tame";
  });
}

TEST(Stories, OfParticlesInOnePlaceAreTheSameToo) {
  Reference reference;
  on_ranks(kManyRanks, [&](comm::Comm& comm) {
    Random random(3);
    Story story{.seed = 99, .options = {{"parts", 5}, {"dims", 2}, {"tolerance", 0.05}}, .parts = 5, .ids = true};
    Frame frame;
    frame.particles.dims = 2;
    add_particles(frame.particles, 200, true, false, random);
    for (int step = 0; step < 4; ++step) {
      for (auto& axis : frame.particles.position) std::ranges::fill(axis, step);
      frame.inserted = step == 2 ? 50 : 0;
      add_particles(frame.particles, frame.inserted, true, false, random);
      for (auto& axis : frame.particles.position) std::ranges::fill(axis, step);
      story.frames.push_back(frame);
    }
    Tally tally;
    for (const Teller teller : {Teller::divided, Teller::direct, Teller::listed, Teller::seats})
      tell_story(comm, story, teller, reference, tally);
  });
}

}  // namespace
}  // namespace rcb::testing
