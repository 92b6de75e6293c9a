// Members' shares, pushed together, leave the scene that one client's push leaves, on any number of ranks; and what
// members are told of leaving and entering is exactly what their parts ask.
#include <algorithm>
#include <limits>
#include <map>
#include <numeric>

#include <gtest/gtest.h>

#include "common/base/clock.hpp"
#include "tests/server/service/driver.hpp"
#include "tests/server/service/members.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

constexpr std::uint64_t kSharesSeed = 20261121;
constexpr int kSharesSteps = 4;

// Rows of the particles, by member.
using Split = std::vector<std::vector<std::size_t>>;

Split random_split(std::uint64_t seed, std::size_t n, int members) {
  Random random(seed);
  Split split(static_cast<std::size_t>(members));
  for (std::size_t row = 0; row < n; ++row) split[static_cast<std::size_t>(random.uniform() * members)].push_back(row);
  for (auto& rows : split) std::reverse(rows.begin(), rows.end());  // any order
  return split;
}

std::vector<PushSlice> shares(const Particles& particles, const Split& split) {
  std::vector<PushSlice> slices;
  for (std::size_t k = 0; k < split.size(); ++k) {
    if (split[k].empty()) continue;
    PushSlice slice = slice_of_rows(particles, 0, static_cast<int>(k), split[k]);
    std::vector<std::int64_t> ids;
    for (const std::size_t row : split[k]) ids.push_back(id_of(particles, row));
    slice.arrays.push_back(array_of("id", "<i8", ids));
    slices.push_back(std::move(slice));
  }
  return slices;
}

Response push_members(comm::Comm& comm, Service& service, const Particles& particles, std::int64_t step,
                      const Split& split, bool follow, const Json& more = Json::object()) {
  Json request{{"command", "push.members"},
               {"scene", "m"},
               {"session", "members"},
               {"step", step},
               {"n", particles.count()},
               {"order", "id"},
               {"weights", !particles.weights.empty()},
               {"ids", true},
               {"changes", true},
               {"members", split.size()},
               {"moved_by", std::vector<std::string>(split.size(), "all")},
               {"follow", follow}};
  request.update(more);
  return service.execute(request, comm.rank() == 0 ? shares(particles, split) : std::vector<PushSlice>());
}

// After the hand-over each member has exactly the particles of its parts.
void exchange_particles(const Particles& particles, const Response& response,
                        const std::map<std::int64_t, std::int32_t>& parts, int part_count, Split& split) {
  constexpr std::size_t kEach = 7;
  const int members = static_cast<int>(split.size());
  ASSERT_EQ(response.arrays.size(), kEach * split.size());
  std::map<std::int64_t, std::size_t> row_of;
  for (std::size_t row = 0; row < particles.count(); ++row) row_of[id_of(particles, row)] = row;
  std::vector<std::vector<std::size_t>> next(split.size());
  std::map<std::int64_t, std::pair<int, int>> moves;  // (from, to), as the leavers see it
  for (int k = 0; k < members; ++k) {
    const auto* of = &response.arrays[kEach * static_cast<std::size_t>(k)];
    const auto leave = values<std::int64_t>(of[2]);
    const auto to = values<std::int32_t>(of[3]);
    EXPECT_TRUE(std::is_sorted(leave.begin(), leave.end()));
    for (std::size_t i = 0; i < leave.size(); ++i) moves[leave[i]] = {k, to[i]};
    for (const std::size_t row : split[static_cast<std::size_t>(k)]) {
      const std::int64_t id = id_of(particles, row);
      if (!std::binary_search(leave.begin(), leave.end(), id)) next[static_cast<std::size_t>(k)].push_back(row);
    }
  }
  std::size_t entered = 0;
  for (int k = 0; k < members; ++k) {
    const auto* of = &response.arrays[kEach * static_cast<std::size_t>(k)];
    const auto enter = values<std::int64_t>(of[4]);
    const auto from = values<std::int32_t>(of[5]);
    const auto part = values<std::int32_t>(of[6]);
    EXPECT_TRUE(std::is_sorted(enter.begin(), enter.end()));
    for (std::size_t i = 0; i < enter.size(); ++i, ++entered) {
      EXPECT_EQ(moves[enter[i]], (std::pair{from[i], k}));
      EXPECT_EQ(part[i], parts.at(enter[i]));
      next[static_cast<std::size_t>(k)].push_back(row_of[enter[i]]);
    }
    std::size_t wanted = 0;
    for (const auto& [id, p] : parts) wanted += layout::rank_of_part(p, part_count, members) == k ? 1U : 0U;
    EXPECT_EQ(next[static_cast<std::size_t>(k)].size(), wanted) << "member " << k;
    for (const std::size_t row : next[static_cast<std::size_t>(k)])
      EXPECT_EQ(layout::rank_of_part(parts.at(id_of(particles, row)), part_count, members), k);
  }
  EXPECT_EQ(entered, moves.size());
  split = std::move(next);
}

void same_scene(int members, bool own_ids, bool weighted) {
  constexpr int kParts = 6;
  on_ranks({1, 2, 3, 4}, [&](comm::Comm& comm) {
    Service one(comm, kClock), many(comm, kClock);
    Driver single(comm, one, "m"), team(comm, many, "m");
    for (Driver* driver : {&single, &team}) driver->create({{"parts", kParts}, {"dims", 2}, {"tolerance", 0.05}});
    Particles particles = random_particles(kSharesSeed, 300, 2);
    if (own_ids)
      for (std::size_t row = 0; row < 300; ++row)
        particles.ids.push_back(static_cast<std::int64_t>((row * 7919) % 300) * 11 + 3);
    if (weighted)
      for (std::size_t row = 0; row < 300; ++row) particles.weights.push_back(1.0 + static_cast<double>(row % 5));
    Split split = random_split(kSharesSeed + 1, 300, members);
    for (int step = 0; step < kSharesSteps; ++step) {
      if (step > 0) drift(particles, kSharesSeed + static_cast<std::uint64_t>(step), step == 2 ? 0.3 : 0.02);
      const Response expected = single.push(particles, step);
      const Response answer = push_members(comm, many, particles, step, split, true);
      EXPECT_TRUE(answer.status.ok()) << answer.status.message();
      const Response a = single.ask("assign"), b = team.ask("assign");
      const Response shown = single.ask("scene.show"), shown_too = team.ask("scene.show");
      if (comm.rank() != 0) continue;
      for (const char* name : {"hash", "counts", "epoch", "error", "plan", "ids", "step", "weights"})
        EXPECT_EQ(shown.json[name], shown_too.json[name]) << name << " at step " << step;
      for (const char* name : {"repartitioned", "drifted", "moved", "migrated", "error_before", "reason", "n"})
        EXPECT_EQ(expected.json["report"][name], answer.json["report"][name]) << name << " at step " << step;
      std::map<std::int64_t, std::int32_t> parts;
      const auto ids = values<std::int64_t>(a.arrays[0]);
      const auto part = values<std::int32_t>(a.arrays[1]);
      EXPECT_EQ(part, values<std::int32_t>(b.arrays[1]));
      EXPECT_EQ(ids, values<std::int64_t>(b.arrays[0]));
      for (std::size_t i = 0; i < ids.size(); ++i) parts[ids[i]] = part[i];
      exchange_particles(particles, answer, parts, kParts, split);
    }
  });
}

TEST(Members, OfIdsByRow) {
  for (const int members : {1, 2, 3, 5}) same_scene(members, false, false);
}

TEST(Members, OfOwnIdsAndWeights) {
  for (const int members : {1, 2, 3, 5}) same_scene(members, true, true);
}

// Two members have not exchanged what they were told to; the third has, and then nothing of it moved.
TEST(Members, WhatWasNotHandedOverIsNamedAgainThoughAnotherPushesFew) {
  on_ranks({1, 2, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "m", {{"parts", 3}, {"dims", 2}});
    const Particles particles = random_particles(kSharesSeed, 60, 2);
    Split split = random_split(kSharesSeed, 60, 3);
    push_members(comm, driver.service, particles, 0, split, true);
    const Response assigned = driver.ask("assign");
    std::map<std::int64_t, std::int32_t> parts;
    std::uint64_t counts[2] = {0, 0};  // of the third member, and of the others
    if (comm.rank() == 0) {
      const auto part = values<std::int32_t>(assigned.arrays[1]);
      Split held(3);
      for (std::size_t k = 0; k < 3; ++k)
        for (const std::size_t row : split[k]) {
          parts[static_cast<std::int64_t>(row)] = part[row];
          const std::size_t keeper = part[row] == 2 ? 2 : k == 2 ? static_cast<std::size_t>(part[row]) : k;
          held[keeper].push_back(row);
          ++counts[keeper == 2 ? 0 : 1];
        }
      split = held;
    }
    comm.all_max(counts);
    Split pushed = split;
    pushed[2].clear();
    for (std::int64_t step = 1; step < 3; ++step) {
      const Json some{{"ids", false},
                      {"base_step", step - 1},
                      {"moved", "some"},
                      {"moved_by", {"all", "all", "none"}},
                      {"counts", {counts[1]}}};
      const Response answer = push_members(comm, driver.service, particles, step, pushed, true, some);
      ASSERT_TRUE(answer.status.ok()) << answer.status.message();
      Split next = split;
      if (comm.rank() == 0) exchange_particles(particles, answer, parts, 3, next);
      if (comm.rank() == 0) {
        EXPECT_NE(next, split);
      }
    }
  });
}

TEST(Members, AFaultLeavesTheSceneAsItWas) {
  on_ranks({1, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "m", {{"parts", 3}, {"dims", 2}});
    Particles particles = random_particles(kSharesSeed, 60, 2);
    const Split split = random_split(kSharesSeed, 60, 3);
    const auto refused = [&](const Particles& pushed, const Split& by, std::int64_t step, const char* word) {
      const Response before = driver.ask("scene.show");
      const Response answer = push_members(comm, driver.service, pushed, step, by, false);
      const Response after = driver.ask("scene.show");
      if (comm.rank() != 0) return;
      EXPECT_FALSE(answer.status.ok());
      EXPECT_NE(answer.status.message().find(word), std::string::npos) << answer.status.message();
      EXPECT_EQ(before.json, after.json);
    };
    Split twice = split;
    twice[0].push_back(split[1][0]);
    refused(particles, twice, 0, "61 particles");  // not what was announced
    Particles nan = particles;
    nan.position[1][31] = std::numeric_limits<double>::quiet_NaN();
    refused(nan, split, 0, "31");
    EXPECT_TRUE(push_members(comm, driver.service, particles, 0, split, false).status.ok());
    refused(nan, split, 1, "31");
    Particles other = particles;
    other.ids.resize(60);
    std::iota(other.ids.begin(), other.ids.end(), 0);
    other.ids[59] = 4;
    refused(other, split, 1, "id 4 is pushed");
    other.ids[59] = 60;
    refused(other, split, 1, "id 59");
  });
}

}  // namespace
}  // namespace rcb::testing
