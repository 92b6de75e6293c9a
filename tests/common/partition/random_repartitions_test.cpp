// Thousands of random drifts, small and nasty, against the judge: new cuts from any cuts in force are those of a fresh
// partition, whoever holds the particles and however bad the guesses are.
#include <algorithm>
#include <mutex>
#include <numeric>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <gtest/gtest.h>

#include "common/partition/repartition.hpp"
#include "tests/support/agreement.hpp"
#include "tests/support/random_scenes.hpp"
#include "tests/support/ranges_of.hpp"

namespace rcb::partition {
namespace {

using namespace testing;

// How particles move between the cuts in force and the search.
enum Drift {
  kStay,
  kFewJump,     // one coordinate in sixteen becomes that of another row: ties stay ties
  kManyJump,    // every other one
  kShift,       // all along the first axis
  kJitter,      // each a little
  kCluster,     // most rows come to the place of the first
  kDisperse,    // most rows come from there
  kTurn,        // axes are exchanged, so cuts flip
  kOtherScene,  // the cuts in force are those of other kinds of coordinates
  kAppear,      // there were a few rows only: most cuts in force have an empty right side
  kDrifts
};

struct RandomRepartition {
  RandomScene before;
  int drift = kStay;
  int moves = 0;        // code of what moves
  int old_weights = 0;  // the family by which the cuts in force were found
  int held = 0;  // 0: particles lie anywhere; 1: on the rank that owns their part; 2: most of them do; 3: likewise,
                 // and ranks own very different numbers of parts
  bool by_part = false;   // particles side by side in the arrays are side by side in space
  bool blocks = false;    // the ranges of blocks are known
  bool previous = false;  // with hysteresis, the cuts in force matter to the axes
  bool incremental = true;
  int brackets = 0;  // code of how far they reach
  int boundary = 1;  // divisor
  int sampled = 0;   // at most; 0: enough to foresee all of so few particles

  std::uint64_t hash(std::uint64_t what) const { return mix64(mix64(static_cast<std::uint64_t>(moves)) + what); }
  bool moves_row(std::size_t row, std::uint64_t of, std::uint64_t one_in) const {
    return hash(of + 8 * row) % one_in == 0;
  }
};

void shift(int& code, std::uint64_t by) { code = static_cast<int>((static_cast<std::uint64_t>(code) + by) % kCodes); }

void gather_rows(const RandomRepartition& from, RandomScene& scene) {
  for (std::size_t i = 0; i < scene.rows.size(); ++i)
    if (!from.moves_row(i, 16, 3)) scene.rows[i].at = scene.rows[0].at;
}

// The scene for which the cuts in force were found.
RandomScene scene_before(const RandomRepartition& from) {
  RandomScene before = from.before;
  before.weights = from.old_weights;
  if (from.drift == kDisperse) gather_rows(from, before);
  if (from.drift == kAppear) before.rows.resize(std::min<std::size_t>(before.rows.size(), from.hash(1) % 8));
  return before;
}

RandomScene scene_now(const RandomRepartition& from) {
  RandomScene now = from.before;
  const std::vector<Row>& rows = from.before.rows;
  if (from.drift == kCluster) gather_rows(from, now);
  if (from.drift == kTurn) std::swap(now.family[0], now.family[static_cast<std::size_t>(now.dims) - 1]);
  if (from.drift == kOtherScene)
    for (std::size_t a = 0; a < 3; ++a) now.family[a] = static_cast<int>(from.hash(a) % kFamilies);
  for (std::size_t i = 0; i < rows.size(); ++i)
    for (std::size_t a = 0; a < static_cast<std::size_t>(now.dims); ++a) {
      int& code = now.rows[i].at[a];
      const std::uint64_t of = 16 + a;
      if ((from.drift == kFewJump && from.moves_row(i, of, 16)) ||
          (from.drift == kManyJump && from.moves_row(i, of, 2)))
        code = rows[from.hash(of + 4 + 8 * i) % rows.size()].at[a];
      if (from.drift == kShift && a == 0) shift(code, from.hash(0) % 4096);
      if (from.drift == kJitter) shift(code, from.hash(of + 8 * i) % 512);
    }
  return now;
}

void showValue(const RandomRepartition& from, std::ostream& out) {
  out << fmt::format(
      "drift {}, moves {}, cuts in force by weights {}, held {}, by part {}, blocks {}, previous {}, incremental {}, "
      "brackets {}, boundary divisor {}, sampled {}\nbefore: ",
      from.drift, from.moves, from.old_weights, from.held, from.by_part, from.blocks, from.previous, from.incremental,
      from.brackets, from.boundary, from.sampled);
  testing::showValue(scene_before(from), out);
  out << "now: ";
  testing::showValue(scene_now(from), out);
}

// The first part of each rank, and the end.
std::vector<int> first_parts(const RandomRepartition& from) {
  const int ranks = from.before.ranks;
  std::vector<int> first;
  for (int r = 0; r <= ranks; ++r) first.push_back(r * from.before.parts / ranks);
  if (from.held == 3) {
    for (std::size_t r = 1; r + 1 < first.size(); ++r)
      first[r] = static_cast<int>(from.hash(r) % static_cast<std::uint64_t>(from.before.parts + 1));
    std::ranges::sort(first);
  }
  return first;
}

// What a rank holds, and its particles' parts under the cuts in force.
struct RankShare {
  Share share;
  std::vector<std::int32_t> part;
};
RankShare share_of(const RandomRepartition& from, const Scene& scene, std::span<const std::int32_t> part, int rank) {
  const std::vector<int> first = first_parts(from);
  const auto r = static_cast<std::size_t>(rank);
  std::vector<std::size_t> rows;
  if (from.held == 0) rows = rows_of(from.before, scene.count(), rank);
  for (std::size_t i = 0; i < scene.count() && from.held > 0; ++i) {
    const bool stray = from.held > 1 && from.hash(i) % 9 == 0;
    if (stray ? from.hash(i + 1) % static_cast<std::uint64_t>(from.before.ranks) == r
              : part[i] >= first[r] && part[i] < first[r + 1])
      rows.push_back(i);
  }
  if (from.by_part) std::ranges::stable_sort(rows, {}, [part](std::size_t row) { return part[row]; });
  std::vector<std::int32_t> mine;
  for (const std::size_t row : rows) mine.push_back(part[row]);
  return {testing::take(scene, std::move(rows)), std::move(mine)};
}

RepartitionOptions options_of(const RandomRepartition& from, const JudgeOptions& asked, const CutTree& before) {
  RepartitionOptions options;
  options.incremental = from.incremental;
  options.partition = testing::options_of(asked);
  if (from.previous) options.partition.previous = &before;
  Tuning& tuning = options.partition.tuning = testing::tuning_of(from.before);
  tuning.bracket_sigmas = from.brackets % 4;
  tuning.bracket_margin = from.brackets / 4 % 3;
  tuning.boundary_divisor = static_cast<std::uint64_t>(from.boundary);
  if (from.sampled > 0) tuning.repartition_sample = {1, 1, static_cast<std::uint64_t>(from.sampled)};
  return options;
}

std::string wrong_loads(const LoadSummary& got, const LoadSummary& want) {
  if (got.counts != want.counts) return fmt::format("counts {}, not {}", got.counts, want.counts);
  if (got.loads != want.loads || got.weighted != want.weighted || got.scale_exponent != want.scale_exponent ||
      got.weights_as_zero != want.weights_as_zero)
    return "other loads";
  return got.error == want.error && got.imbalance == want.imbalance ? "" : "another error";
}

// What this rank sees wrong in `got`. Collective.
std::string wrong_here(comm::Comm& comm, Repartition got, const RankShare& here, const PartitionOptions& options,
                       const Judgement& judged) {
  PartitionResult all;
  all.part.resize(here.part.size());
  std::ranges::copy(here.part, all.part.begin());
  std::string wrong;
  for (std::size_t k = 0; k < got.delta.slot.size(); ++k) {
    const std::uint64_t slot = got.delta.slot[k];
    if (slot >= here.part.size() || (k > 0 && slot <= got.delta.slot[k - 1]))
      wrong = fmt::format("slot {} is out of order; ", slot);
    else if (std::exchange(all.part[slot], got.delta.part[k]) == got.delta.part[k])
      wrong = fmt::format("slot {} doesn't change its part; ", slot);
  }
  const std::span<const std::int32_t> part = all.part.span();
  const auto loads = summarise_loads(comm, here.share.particles.view(), part, options.part_sizes, options.parts);
  wrong += wrong_loads(got.loads, loads);
  all.tree = std::move(got.tree);
  all.counts = std::move(got.loads.counts);
  return wrong + testing::disagreement(all, here.share, judged);
}

// Runs a repartition on its ranks; empty: nothing wrong. Counts those that opened no whole.
std::string wrong_with(const RandomRepartition& from, int& incremental) {
  JudgeOptions asked;
  asked.parts = from.before.parts;
  for (const int code : from.before.part_sizes) asked.part_sizes.push_back(size_of(code));
  asked.band_axis = from.before.band_axis;
  Scene old_scene = scene_of(scene_before(from));
  Scene scene = scene_of(scene_now(from));
  Scene weighed = scene;
  std::string wrong = round_weights(old_scene) + round_weights(weighed);
  if (!wrong.empty()) return wrong;

  CutTree before = tree_of(testing::judge(old_scene, asked), scene.dims, asked.parts);
  before.method = testing::options_of(asked).method;
  before.part_sizes = asked.part_sizes;
  if (from.before.hysteresis > 0) asked.hysteresis = 1 + 0.1 * from.before.hysteresis;
  if (from.previous) old_axes(before, before.root(), asked.old_axis);
  const Judgement judged = testing::judge(weighed, asked);
  const RepartitionOptions options = options_of(from, asked, before);
  std::vector<std::int32_t> part(scene.count());
  for (std::size_t i = 0; i < scene.count(); ++i) {
    Point at{};
    for (std::size_t a = 0; a < static_cast<std::size_t>(scene.dims); ++a) at[a] = scene.x[a][i];
    part[i] = before.part_of(at, scene.id[i]);
  }

  std::mutex mutex;
  testing::on_threads(from.before.ranks, [&](comm::Comm& comm) {
    const RankShare here = share_of(from, scene, part, comm.rank());
    const particles::ParticleView view = here.share.particles.view();
    const particles::BlockRanges blocks = testing::ranges_of(view);
    const LoadSummary loads = summarise_loads(comm, view, here.part, asked.part_sizes, asked.parts);
    Repartition got = repartition(comm, view, options, {before, here.part, loads, from.blocks ? &blocks : nullptr});
    const bool few = got.incremental && asked.parts > 1 && got.cost.searched < scene.count();
    const std::string mine = wrong_here(comm, std::move(got), here, options.partition, judged);
    const std::lock_guard lock(mutex);
    if (comm.rank() == 0 && few) ++incremental;
    if (!mine.empty()) wrong += fmt::format("rank {}: {}\n", comm.rank(), mine);
  });
  return wrong;
}

rc::Gen<RandomRepartition> plain_repartitions(int rows_max) {
  return rc::gen::build<RandomRepartition>(
      rc::gen::set(&RandomRepartition::before, plain_scenes(rows_max)),
      rc::gen::set(&RandomRepartition::drift, any_of(kDrifts)), rc::gen::set(&RandomRepartition::moves, any_of(kCodes)),
      rc::gen::set(&RandomRepartition::held, any_of(4)), rc::gen::set(&RandomRepartition::by_part),
      rc::gen::set(&RandomRepartition::blocks), rc::gen::set(&RandomRepartition::previous),
      rc::gen::set(&RandomRepartition::incremental, rc::gen::map(any_of(8), [](int code) { return code != 7; })),
      rc::gen::set(&RandomRepartition::brackets, any_of(12)),
      rc::gen::set(&RandomRepartition::sampled, rc::gen::element(0, 0, 1, 5, 20, 80, 200)),
      rc::gen::set(&RandomRepartition::boundary, rc::gen::weightedElement<int>({{12, 1}, {3, 2}, {1, 5}, {1, 1000}})));
}

using Codes = std::array<int, 3>;

// Judges `count` repartitions; `add` gives a plain one what the test is about, from three codes. incremental_min: so
// many of a hundred must do without opening any whole.
template <typename Add>
void judge_repartitions(int count, int rows_max, int incremental_min, const Add& add) {
  const auto made =
      rc::gen::map(rc::gen::tuple(plain_repartitions(rows_max), any_of(kCodes), any_of(kCodes), any_of(kCodes)),
                   [add](std::tuple<RandomRepartition, int, int, int> codes) {
                     auto [from, a, b, c] = std::move(codes);
                     from.before.ranks = 1 + a % 8 * (b % 2);  // one, or up to eight
                     if (c % 3 > 0) from.before.hysteresis = 1 + b % 20;
                     if (a % 4 == 0) from.before.buckets = 1 + c;
                     add(from, Codes{a, b, c});
                     return from;
                   });
  int incremental = 0;
  int all = 0;
  testing::judge_random(count, made, [&](const RandomRepartition& from) {
    ++all;
    return wrong_with(from, incremental);
  });
  std::cout << incremental << " of " << all << " were incremental" << std::endl;
  EXPECT_GE(100 * incremental, incremental_min * all);
}

TEST(RandomRepartitions, Counted) {
  judge_repartitions(3000, 120, 1, [](RandomRepartition&, const Codes&) {});
}

TEST(RandomRepartitions, Weighted) {
  judge_repartitions(2500, 90, 1, [](RandomRepartition& from, const Codes& codes) {
    from.before.weights = 1 + codes[0] % kWeightFamilies;
    if (codes[1] % 3 > 0) from.old_weights = codes[1] % 3 == 1 ? from.before.weights : codes[2] % (1 + kWeightFamilies);
  });
}

TEST(RandomRepartitions, PartSizes) {
  judge_repartitions(1500, 80, 1, [](RandomRepartition& from, const Codes& codes) {
    from.before.weights = codes[0] % (1 + kWeightFamilies);
    give_sizes(from.before, codes[1]);
  });
}

TEST(RandomRepartitions, Bands) {
  judge_repartitions(1500, 100, 1, [](RandomRepartition& from, const Codes& codes) {
    from.before.band_axis = codes[0] % from.before.dims;
    if (codes[1] % 3 == 0) from.before.weights = 1 + codes[1] % kWeightFamilies;
    if (codes[2] % 4 == 0) give_sizes(from.before, codes[2]);
  });
}

// Thousands of particles in few places: too many to gather at once, so that histograms find every cut.
TEST(RandomRepartitions, ManyCopies) {
  judge_repartitions(500, 40, 1, [](RandomRepartition& from, const Codes& codes) {
    from.before.copies = 1 + codes[0] % 100;
    if (codes[1] % 4 == 0) from.before.weights = 1 + codes[1] % kWeightFamilies;
  });
}

// Few parts with many particles, most of which stay: whole blocks lie inside of a part.
TEST(RandomRepartitions, FewParts) {
  judge_repartitions(1500, 900, 8, [](RandomRepartition& from, const Codes& codes) {
    from.before.parts = 2 + codes[2] % 7;
    from.before.ranks = 1 + codes[0] % 3;
    if (codes[1] % 4 == 0) from.before.weights = 1 + codes[1] % kWeightFamilies;
    if (codes[0] % 3 > 0) from.before.family = {7, codes[1] % 2 == 0 ? 7 : 5, 7};  // that drift smoothly
  });
}

// Few parts of particles of which many share a coordinate, also with those near a cut that was expected elsewhere.
TEST(RandomRepartitions, Ties) {
  judge_repartitions(2000, 400, 5, [](RandomRepartition& from, const Codes& codes) {
    from.before.parts = 2 + codes[2] % 5;
    from.before.ranks = 1 + codes[0] % 3;
    for (int& family : from.before.family) family = std::array{0, 1, 2, 7, 8}[static_cast<std::size_t>(family) % 5];
    if (codes[1] % 2 == 0) from.drift = kFewJump;
    if (codes[1] % 4 == 1) from.before.weights = 1 + codes[0] % kWeightFamilies;
  });
}

}  // namespace
}  // namespace rcb::partition
