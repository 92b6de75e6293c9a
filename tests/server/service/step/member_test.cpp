// Members' shares, pushed together, leave the scene that one client's push leaves, on any number of ranks; and each
// member is told of its own particles which changed part.
#include <algorithm>
#include <limits>
#include <map>
#include <numeric>
#include <set>

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
                      const Split& split, const Json& more = Json::object()) {
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
               {"moved_by", std::vector<std::string>(split.size(), "all")}};
  request.update(more);
  return service.execute(request, comm.rank() == 0 ? shares(particles, split) : std::vector<PushSlice>());
}

using Parts = std::map<std::int64_t, std::int32_t>;

Parts parts_of(const wire::Array& id, const wire::Array& part) {
  Parts parts;
  for (std::size_t i = 0; i < values<std::int64_t>(id).size(); ++i)
    parts[values<std::int64_t>(id)[i]] = values<std::int32_t>(part)[i];
  return parts;
}

// What the members are told of changes together, each only of particles that it has.
Parts changes_told(const Particles& particles, const Response& response, const Split& split) {
  constexpr std::size_t kEach = 2;
  EXPECT_EQ(response.arrays.size(), kEach * split.size());
  Parts all;
  for (std::size_t k = 0; k < split.size(); ++k) {
    std::set<std::int64_t> mine;
    for (const std::size_t row : split[k]) mine.insert(id_of(particles, row));
    EXPECT_TRUE(std::ranges::is_sorted(values<std::int64_t>(response.arrays[kEach * k])));
    for (const auto& [id, part] : parts_of(response.arrays[kEach * k], response.arrays[kEach * k + 1])) {
      EXPECT_TRUE(mine.contains(id)) << "member " << k << " is told of another's particle " << id;
      all[id] = part;
    }
  }
  return all;
}

// Each member then has the particles of its parts.
Split handed_over(const Particles& particles, const Parts& parts, int part_count, int members) {
  Split split(static_cast<std::size_t>(members));
  for (std::size_t row = 0; row < particles.count(); ++row)
    split[static_cast<std::size_t>(layout::rank_of_part(parts.at(id_of(particles, row)), part_count, members))]
        .push_back(row);
  return split;
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
      const Response answer = push_members(comm, many, particles, step, split);
      EXPECT_TRUE(answer.status.ok()) << answer.status.message();
      const Response a = single.ask("assign"), b = team.ask("assign");
      const Response shown = single.ask("scene.show"), shown_too = team.ask("scene.show");
      if (comm.rank() != 0) continue;
      for (const char* name : {"hash", "counts", "epoch", "error", "plan", "ids", "step", "weights"})
        EXPECT_EQ(shown.json[name], shown_too.json[name]) << name << " at step " << step;
      for (const char* name : {"repartitioned", "drifted", "moved", "migrated", "error_before", "reason", "n"})
        EXPECT_EQ(expected.json["report"][name], answer.json["report"][name]) << name << " at step " << step;
      const Parts parts = parts_of(a.arrays[0], a.arrays[1]);
      EXPECT_EQ(parts, parts_of(b.arrays[0], b.arrays[1]));
      EXPECT_EQ(changes_told(particles, answer, split), parts_of(expected.arrays[0], expected.arrays[1]));
      split = handed_over(particles, parts, kParts, members);
    }
  });
}

TEST(Members, OfIdsByRow) {
  for (const int members : {1, 2, 3, 5}) same_scene(members, false, false);
}

TEST(Members, OfOwnIdsAndWeights) {
  for (const int members : {1, 2, 3, 5}) same_scene(members, true, true);
}

// Two members have each other's particles; the third has its own, which stand still.
TEST(Members, WhoPushedAParticleIsToldOfItThoughAnotherPushesFew) {
  on_ranks({1, 2, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "m", {{"parts", 3}, {"dims", 2}, {"tolerance", 0.05}});
    Particles particles = random_particles(kSharesSeed, 60, 2);
    push_members(comm, driver.service, particles, 0, random_split(kSharesSeed, 60, 3));
    Response assigned = driver.ask("assign");
    std::size_t told = 0;
    for (std::int64_t step = 1; step < 4; ++step) {
      Split split(3);
      std::uint64_t count = 0;
      if (comm.rank() == 0) {
        split = handed_over(particles, parts_of(assigned.arrays[0], assigned.arrays[1]), 3, 3);
        std::swap(split[0], split[1]);
        count = split[0].size() + split[1].size();
        const Particles before = particles;
        drift(particles, kSharesSeed + static_cast<std::uint64_t>(step), 0.1);
        for (const std::size_t row : split[2])
          for (std::size_t a = 0; a < 2; ++a) particles.position[a][row] = before.position[a][row];
      }
      comm.all_max({&count, 1});
      Split pushed = split;
      pushed[2].clear();
      const Json some{{"ids", false},
                      {"base_step", step - 1},
                      {"moved", "some"},
                      {"moved_by", {"all", "all", "none"}},
                      {"counts", {count}}};
      const Response answer = push_members(comm, driver.service, particles, step, pushed, some);
      ASSERT_TRUE(answer.status.ok()) << answer.status.message();
      Response now = driver.ask("assign");
      if (comm.rank() == 0) {
        Parts changed = parts_of(now.arrays[0], now.arrays[1]);
        for (const auto& [id, part] : parts_of(assigned.arrays[0], assigned.arrays[1]))
          if (changed.at(id) == part) changed.erase(id);
        EXPECT_EQ(changes_told(particles, answer, split), changed);
        told += changed.size();
      }
      assigned = std::move(now);
    }
    EXPECT_EQ(told > 0, comm.rank() == 0) << "the test is too tame";
  });
}

TEST(Members, AFaultLeavesTheSceneAsItWas) {
  on_ranks({1, 3}, [](comm::Comm& comm) {
    OwnDriver driver(comm, "m", {{"parts", 3}, {"dims", 2}});
    Particles particles = random_particles(kSharesSeed, 60, 2);
    const Split split = random_split(kSharesSeed, 60, 3);
    const auto refused = [&](const Particles& pushed, const Split& by, std::int64_t step, const char* word) {
      const Response before = driver.ask("scene.show");
      const Response answer = push_members(comm, driver.service, pushed, step, by);
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
    EXPECT_TRUE(push_members(comm, driver.service, particles, 0, split).status.ok());
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
