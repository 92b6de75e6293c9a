// Blocks that don't fit are refused, by whichever way they come: all ranks say the same, and the scene stays as it was.
#include "server/service/push/blocks.hpp"

#include <cmath>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "server/service/context/collective.hpp"
#include "tests/server/service/push/stories.hpp"
#include "tests/support/forwarding_comm.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

constexpr Path kAnyRankPaths[] = {Path::gateway, Path::direct, Path::listed};

std::vector<std::size_t> first_rows(std::size_t count) {
  std::vector<std::size_t> rows(count);
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  return rows;
}

TEST(Blocks, NothingIsLostOrDoubled) {
  on_ranks([](comm::Comm& comm) {
    for (const Path path : kAnyRankPaths) {
      Refusing scene(comm, {{"parts", 4}, {"dims", 2}, {"tolerance", 0.3}});
      const Particles particles = with_ids(5, 61, 2);
      scene.taken(particles, dealt(comm, particles, path), 0, true, 1);
      Particles fewer = particles;
      keep_rows(fewer, first_rows(60));
      const auto refused = [&](const Particles& pushed, const std::vector<std::string>& words, const Json& told) {
        scene.refused(Code::not_conserved, words, pushed, dealt(comm, pushed, path), 1, true, 1, told);
        scene.refused(Code::not_conserved, words, pushed, shares(comm, pushed, 3, path), 1, true, 3, told);
      };
      Particles other = particles;
      other.ids[17] = 7;
      refused(other, {"other particles"}, flow(0, 0));
      other.ids[17] = other.ids[18];  // one twice, another not at all
      refused(other, {"other particles"}, flow(0, 0));
      scene.taken(fewer, dealt(comm, fewer, path), 1, true, 1, flow(0, 1));
      scene.taken(particles, shares(comm, particles, 2, path), 2, true, 2, flow(1, 0));
      scene.refused(Code::not_conserved, {"other particles"}, other, dealt(comm, other, path), 3, true, 1);
    }
  });
}

TEST(Blocks, TwinsAreNamedAndWhoPushesThem) {
  on_ranks([](comm::Comm& comm) {
    for (const Path path : kAnyRankPaths) {
      OwnDriver driver(comm, "t", {{"parts", 3}, {"dims", 2}});
      const Particles particles = with_ids(9, 50, 2);
      Particles twins = particles;
      twins.ids[10] = twins.ids[31] = 7;  // rows of seat 1 of 3, of seats 2 and 3 of 4
      const auto told = [&](std::int64_t step, std::size_t seats, const Json& more) {
        const auto blocks = seats == 1 ? dealt(comm, twins, path) : shares(comm, twins, seats, path);
        const Response refused = driver.push(twins, blocks, step, true, static_cast<int>(seats), more);
        if (comm.rank() != 0) return std::string();
        EXPECT_EQ(refused.status.code(), Code::duplicate_id) << refused.status.message();
        return refused.status.message();
      };
      const auto tell = [&](std::int64_t step, const Json& more) {
        const std::string one = told(step, 1, more), same = told(step, 3, more), others = told(step, 4, more);
        if (comm.rank() != 0) return;
        EXPECT_EQ(one, "id 7 occurs more than once");
        EXPECT_EQ(same, "seat 1 pushes id 7 twice");
        EXPECT_EQ(others, "id 7 is pushed by seat 2 and by seat 3");
      };
      tell(0, Json::object());
      const Response pushed = driver.push(particles, dealt(comm, particles, path), 0, true, 1);
      EXPECT_TRUE(comm.rank() != 0 || pushed.status.ok()) << pushed.status.message();
      tell(1, flow(1, 1));
      keep_rows(twins, first_rows(48));
      tell(1, flow(0, 2));
    }
  });
}

// Whoever knows the sum that clients compare can choose ids for it. Twins would be the end of a search.
TEST(Blocks, TwinsMadeForTheSumOfIdsAreFound) {
  on_ranks([](comm::Comm& comm) {
    for (const Path path : kAnyRankPaths) {
      Refusing scene(comm, {{"parts", 4}, {"dims", 2}, {"tolerance", 0}});
      const Particles particles = with_ids(6, 60, 2);
      const Particles twins = with_twins_of_the_same_sum(particles);
      std::uint64_t sums[2] = {0, 0};
      for (std::size_t row = 0; row < 60; ++row) {
        sums[0] += mix64(static_cast<std::uint64_t>(particles.ids[row]));
        sums[1] += mix64(static_cast<std::uint64_t>(twins.ids[row]));
      }
      EXPECT_EQ(sums[0], sums[1]);
      scene.taken(particles, dealt(comm, particles, path), 0, true, 1);
      scene.refused(Code::not_conserved, {}, twins, dealt(comm, twins, path), 1, true, 1);
      scene.taken(particles, dealt(comm, particles, path), 1, true, 1, flow(0, 0));
    }
  });
}

TEST(Blocks, ARowListedTwiceIsATwin) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "t", {{"parts", 3}, {"dims", 2}});
    const Particles particles = random_particles(9, 50, 2);
    for (const std::int64_t step : {0, 1}) {
      Json request{{"command", "push"}, {"scene", "t"}, {"step", step}, {"attempt", 0}};
      std::vector<PushSlice> slices;
      Blocks(comm, particles, dealt(comm, particles, Path::listed, 8), false).put(request, slices);
      const SharedMemory& good = *slices[0].shared[0].memory;
      auto made = SharedMemory::create(good.size());
      EXPECT_TRUE(made.ok());
      std::ranges::copy(good.bytes(), made->writable().begin());
      const api::SharedArray list = slices[0].shared.back().where;
      std::memcpy(made->writable().data() + list.offset, good.bytes().data() + list.offset + list.stride, 8);
      const auto memory = std::make_shared<const SharedMemory>(std::move(*made));
      for (api::SharedColumn& column : slices[0].shared) column.memory = memory;
      const Response refused = driver.service.execute(request, std::move(slices));
      const Response works = driver.push(particles, step);
      if (comm.rank() != 0) continue;
      EXPECT_EQ(refused.status.code(), step == 0 ? Code::duplicate_id : Code::not_conserved)
          << refused.status.message();
      EXPECT_TRUE(works.status.ok()) << works.status.message();
    }
  });
}

// Wherever in a vector's lanes it is, and whichever rank reads it.
TEST(Blocks, NoBadValueHides) {
  on_ranks({1, 3}, [](comm::Comm& comm) {
    for (const Path path : {Path::gateway, Path::direct, Path::listed, Path::held}) {
      Refusing scene(comm, {{"parts", 4}, {"tolerance", 0.3}});
      Particles particles = random_particles(2, 200, 3);
      particles.weights.assign(200, 1.5);
      particles.weights[9] = 3;
      scene.taken(particles, dealt(comm, particles, path), 0, false, 1);
      for (const std::size_t row : {0U, 1U, 3U, 4U, 7U, 8U, 63U, 64U, 127U, 199U})
        for (std::size_t a = 0; a < 4; ++a)
          for (const double bad : {std::nan(""), HUGE_VAL, -HUGE_VAL, -1.0}) {
            if (bad == -1.0 && a < 3) continue;
            Particles pushed = particles;
            (a < 3 ? pushed.position[a] : pushed.weights)[row] = bad;
            scene.refused(
                bad == -1.0 ? Code::invalid_argument : Code::not_finite,
                {fmt::format("particle {}", row), fmt::format("{} is {}", a < 3 ? kAxisNames[a] : "weight", bad)},
                pushed, dealt(comm, pushed, path, row), 1, false, 1);
          }
      Particles many = particles;  // the least id is named
      for (const std::size_t row : {150U, 11U, 60U}) many.position[row % 3][row] = std::nan("");
      scene.refused(Code::not_finite, {"particle 11"}, many, dealt(comm, many, path, 5), 1, false, 1);
      scene.taken(particles, dealt(comm, particles, path, 6), 1, false, 1);
    }
  });
}

TEST(Blocks, ABadValueOfAFirstPushIsNamedByItsId) {
  on_ranks([](comm::Comm& comm) {
    for (const Path path : kAnyRankPaths)
      for (const std::size_t row : {0U, 8U, 29U}) {
        OwnDriver driver(comm, "f", {{"parts", 4}, {"dims", 2}});
        const Particles good = with_ids(2, 30, 2);
        Particles nan = good, negative = good;
        nan.position[1][row] = std::nan("");
        negative.ids[row] = -4;
        const Response not_finite = driver.push(nan, dealt(comm, nan, path), 0, true, 1);
        const Response below = driver.push(negative, dealt(comm, negative, path), 0, true, 1);
        const Response works = driver.push(good, dealt(comm, good, path), 0, true, 1);
        if (comm.rank() != 0) continue;
        EXPECT_EQ(not_finite.status.code(), Code::not_finite);
        EXPECT_EQ(not_finite.status.message(), fmt::format("particle {}: y is nan", good.ids[row]));
        EXPECT_EQ(below.status.code(), Code::invalid_argument);
        EXPECT_NE(below.status.message().find("id is -4"), std::string::npos) << below.status.message();
        EXPECT_TRUE(works.status.ok()) << works.status.message();
      }
  });
}

TEST(Blocks, RowNumbersMayComeAsIds) {
  on_ranks([](comm::Comm& comm) {
    Refusing scene(comm, {{"parts", 4}, {"dims", 2}, {"tolerance", 0.1}});
    Particles rows = random_particles(6, 80, 2);
    Random random(8);
    scene.taken(rows, dealt(comm, rows, Path::gateway), 0, false, 1);
    for (const std::int64_t step : {1, 2, 3}) {  // with ids in any order, then without
      drift(rows, static_cast<std::uint64_t>(step), 0.05);
      Block block = all_rows(rows, step == 2 ? Path::direct : Path::gateway);
      if (step < 3) block.rows = shuffled(80, random);
      scene.taken(rows, std::vector<Block>{block}, step, step < 3, 1);
      const Response shown = scene.driver().ask("scene.show"), fetched = scene.driver().ask("fetch");
      if (comm.rank() != 0) continue;
      EXPECT_FALSE(shown.json["ids"]);
      check_particles(fetched, rows);
    }
    Particles other = rows;
    for (int row = 0; row < 80; ++row) other.ids.push_back(row == 9 ? 80 : row);
    scene.taken(other, dealt(comm, other, Path::direct), 4, true, 1, flow(1, 1));
    const Response shown = scene.driver().ask("scene.show");
    EXPECT_TRUE(comm.rank() != 0 || shown.json["ids"].get<bool>());
  });
}

TEST(Blocks, OfASceneWithWeightsHaveThem) {
  on_ranks([](comm::Comm& comm) {
    Refusing scene(comm, {{"parts", 4}, {"tolerance", 0.5}});
    Particles plain = random_particles(3, 70, 3), weighted = plain;
    Random random(3);
    for (int k = 0; k < 70; ++k) weighted.weights.push_back(random.uniform(0, 2));
    scene.taken(weighted, dealt(comm, weighted, Path::direct), 0, false, 1);
    drift(plain, 4, 0.1);
    weighted.position = plain.position;
    scene.taken(plain, dealt(comm, plain, Path::held), 1, false, 1);  // leaves them as they are
    const Response left = scene.driver().ask("fetch");
    if (comm.rank() == 0) check_particles(left, weighted);
    for (double& weight : weighted.weights) weight = random.uniform(0, 2);
    scene.taken(weighted, dealt(comm, weighted, Path::held), 2, false, 1);
    const Response changed = scene.driver().ask("fetch");
    if (comm.rank() == 0) check_particles(changed, weighted);
  });
}

TEST(Blocks, OfAnEmptySceneMayBeAny) {
  on_ranks([](comm::Comm& comm) {
    Refusing scene(comm, {{"parts", 3}, {"dims", 2}, {"tolerance", "inf"}});
    Particles none;
    none.dims = 2;
    none.position.resize(2);
    Particles some = with_ids(4, 30, 2);
    some.weights.assign(30, 2);
    some.weights[4] = 5;
    for (const std::int64_t step : {0, 1}) scene.taken(none, std::vector<Block>{}, step, false, 1);
    const Json first = scene.taken(some, dealt(comm, some, Path::direct), 2, true, 1, flow(30, 0));
    const Json gone = scene.taken(none, std::vector<Block>{}, 3, false, 3, flow(0, 30));
    const Particles rows = random_particles(1, 12, 2);
    const Json others = scene.taken(rows, dealt(comm, rows, Path::held), 4, false, 1, flow(12, 0));
    const Response fetched = scene.driver().ask("fetch"), shown = scene.driver().ask("scene.show");
    if (comm.rank() != 0) return;
    check_particles(fetched, rows);
    for (const Json& report : {first, others}) {
      EXPECT_EQ(report.value("repartitioned", false), true) << report;
      EXPECT_TRUE(report.value("reason", "").starts_with("the scene had no particles before")) << report;
    }
    EXPECT_EQ(gone.value("n", 1), 0);
    EXPECT_EQ(gone.value("way", ""), "endpoint");
    EXPECT_FALSE(shown.json["ids"]);
    EXPECT_FALSE(shown.json["weights"]);
  });
}

// How many bytes an exchange brings at most.
class MostBrought : public ForwardingComm {
 public:
  using ForwardingComm::ForwardingComm;
  void exchange(std::span<const std::span<const std::byte>> send,
                std::span<const std::span<std::byte>> receive) override {
    std::size_t bytes = 0;
    for (const auto& from : receive) bytes += from.size();
    most = std::max(most, bytes);
    comm_.exchange(send, receive);
  }
  std::size_t most = 0;
};

TEST(Blocks, NobodyChoosesIdsThatOneRankAloneCompares) {
  on_ranks({2, 3}, [](comm::Comm& comm) {
    std::vector<particles::Id> ids;
    for (std::uint64_t id = 0; ids.size() < 3000; ++id)
      if (mix64(id) % static_cast<std::uint64_t>(comm.size()) == 0) ids.push_back(static_cast<particles::Id>(id));
    std::uint64_t greatest = 0;
    for (const std::size_t twins : {0U, 1U}) {
      MostBrought brought(comm);
      const std::span<const particles::Id> mine(ids.data(), comm.rank() == 0 ? ids.size() : twins);
      EXPECT_EQ(service::duplicate_id(brought, mine, greatest).has_value(), twins == 1);
      EXPECT_LT(brought.most, 2000 * sizeof(particles::Id));
    }
  });
}

// Memory that came over a socket is kept for the next push; of what came through the endpoint there was more.
TEST(Blocks, GiveTheirMemoryBack) {
  on_ranks({1, 2, 3}, [](comm::Comm& comm) {
    const auto spare = std::make_shared<api::SpareMemory>();
    OwnDriver driver(comm, "g", {{"parts", 4}, {"dims", 2}, {"tolerance", "inf"}}, {.spare = spare});
    Particles particles = with_ids(6, 400, 2);
    driver.push(particles, dealt(comm, particles, Path::gateway), 0, true, 1);
    for (std::int64_t step = 1; step < 9; ++step) {
      const bool direct = step % 2 == 0;
      const std::size_t seats = step % 4 < 2 ? 1 : 2;
      auto blocks = shares(comm, particles, seats, direct ? Path::direct : Path::gateway);
      for (Block& block : blocks) block.ranks.clear();
      const Response pushed = driver.push(particles, blocks, step, true, static_cast<int>(seats));
      EXPECT_TRUE(comm.rank() != 0 || pushed.status.ok()) << pushed.status.message();
      std::size_t buffers = 0;
      while (spare->take("g").capacity() > 0) ++buffers;
      // One seat's rows are used where they came, and of several ranks most change rank, which takes the memory.
      EXPECT_EQ(buffers, direct && (seats > 1 || comm.size() == 1) ? 3U : 0U) << "step " << step;
    }
  });
}

// What one rank has got isn't what the order says.
TEST(Blocks, AreComparedWithTheOrder) {
  on_ranks([](comm::Comm& comm) {
    OwnDriver driver(comm, "c", {{"parts", 4}, {"dims", 2}});
    const Particles particles = random_particles(5, 90, 2);
    const auto refused = [&](Path path, std::int64_t step, const char* why, const auto& spoil) {
      Json request{{"command", "push"}, {"scene", "c"}, {"step", step}, {"attempt", 0}};
      std::vector<PushSlice> slices;
      Blocks(comm, particles, {all_rows(particles, path)}, false).put(request, slices);
      if (comm.rank() == (path == Path::gateway ? 0 : comm.size() - 1)) spoil(slices);
      const Response pushed = driver.service.execute(request, std::move(slices));
      EXPECT_TRUE(comm.rank() != 0 || !pushed.status.ok()) << why;
      EXPECT_TRUE(path == Path::gateway || comm.rank() != 0 || pushed.status.code() == Code::aborted ||
                  pushed.status.code() == Code::invalid_argument)
          << why << ": " << pushed.status.message();
    };
    for (const std::int64_t step : {0, 1}) {
      for (const Path path : {Path::gateway, Path::direct, Path::listed, Path::held})
        refused(path, step, "no slice", [](auto& slices) { slices.clear(); });
      for (const Path path : {Path::gateway, Path::direct}) {
        refused(path, step, "a row too few", [](auto& slices) {
          --slices[0].count;
          for (wire::Array& array : slices[0].arrays) {
            array.bytes.resize(array.bytes.size() - 8);
            --array.shape[0];
          }
        });
        refused(path, step, "an array too few", [](auto& slices) { slices[0].arrays.pop_back(); });
        refused(path, step, "a short array", [](auto& slices) { slices[0].arrays[1].bytes.resize(8); });
      }
      for (const Path path : {Path::listed, Path::held}) {
        refused(path, step, "no memory", [](auto& slices) { slices[0].shared[0].memory.reset(); });
        refused(path, step, "beyond the memory", [](auto& slices) { slices[0].shared[1].where.stride = 1 << 12; });
      }
      refused(Path::listed, step, "rows that aren't there", [](auto& slices) {
        slices[0].shared.back().where.offset = slices[0].shared[0].where.offset;  // bits of positions
      });
      const Response works = driver.push(particles, step);
      EXPECT_TRUE(works.status.ok()) << works.status.message();
    }
  });
}

}  // namespace
}  // namespace rcb::testing
