// Members' pushes that come straight to the ranks leave the scene that one client's push leaves, whatever the numbers
// of members and ranks; places and hand-over lists are those that the plan and the parts tell.
#include <algorithm>
#include <map>

#include <gtest/gtest.h>

#include "common/base/clock.hpp"
#include "tests/server/service/members.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

constexpr std::uint64_t kDirectSeed = 20261122;
constexpr std::size_t kPoints = 300;
constexpr int kDirectParts = 6;
constexpr int kDirectSteps = 7;

// Rank 0's values, on every rank.
template <typename T>
std::vector<T> everywhere(comm::Comm& comm, std::vector<T> of_root) {
  std::uint64_t size = comm.rank() == 0 ? of_root.size() : 0;
  comm.all_max({&size, 1});
  of_root.resize(size);
  comm.broadcast(std::as_writable_bytes(std::span(of_root)), 0);
  return of_root;
}

// The scene's particles in the plan's order, rank after rank.
struct Truth {
  std::vector<std::int64_t> id;
  std::vector<std::int32_t> part;
  std::vector<std::uint64_t> counts;
  Json plan;
};

Truth ask_truth(comm::Comm& comm, Driver& driver) {
  const Response answer = driver.ask("plan");
  Truth truth;
  if (comm.rank() == 0) {
    truth.id = values<std::int64_t>(answer.arrays[0]);
    truth.part = values<std::int32_t>(answer.arrays[1]);
    truth.counts = answer.json["counts"].get<std::vector<std::uint64_t>>();
    truth.plan = answer.json["plan"];
  }
  truth.id = everywhere(comm, truth.id);
  truth.part = everywhere(comm, truth.part);
  truth.counts = everywhere(comm, truth.counts);
  const auto text = everywhere(comm, [&] {
    const std::string dumped = comm.rank() == 0 ? truth.plan.dump() : "";
    return std::vector<char>(dumped.begin(), dumped.end());
  }());
  truth.plan = Json::parse(text);
  return truth;
}

using Place = std::pair<int, std::uint64_t>;  // rank and slot

// By member: what it holds, and where.
std::vector<std::map<std::int64_t, Place>> places_of(const Truth& truth, int members) {
  std::vector<std::map<std::int64_t, Place>> places(static_cast<std::size_t>(members));
  std::size_t at = 0;
  for (std::size_t rank = 0; rank < truth.counts.size(); ++rank)
    for (std::uint64_t slot = 0; slot < truth.counts[rank]; ++slot, ++at)
      places[static_cast<std::size_t>(layout::rank_of_part(truth.part[at], kDirectParts, members))][truth.id[at]] = {
          static_cast<int>(rank), slot};
  return places;
}

class Team {
 public:
  Team(comm::Comm& comm, Service& service, int members)
      : comm_(comm), service_(service), members_(members), places_(static_cast<std::size_t>(members)) {}

  // Every member has some block of rows.
  Response push_by_id(const Particles& particles, std::int64_t step) {
    std::vector<PushSlice> slices;
    for (int k = 0; k < members_ && comm_.rank() == 0; ++k) {
      std::vector<std::size_t> rows;
      std::vector<std::int64_t> ids;
      for (std::uint64_t row = layout::row_begin(k, kPoints, members_);
           row < layout::row_begin(k + 1, kPoints, members_); ++row) {
        rows.push_back(row);
        ids.push_back(id_of(particles, row));
      }
      slices.push_back(slice_of_rows(particles, 0, k, rows));
      slices.back().arrays.push_back(array_of("id", "<i8", ids));
    }
    Response answer = service_.execute(begin(particles, step, "id"), std::move(slices));
    if (answer.status.ok()) take(answer, false);
    return answer;
  }

  // Of each member what it has on this rank, in ascending slots. short_of: brings one particle too few. unmoved: brings
  // nothing.
  Response push_directly(const Particles& particles, std::int64_t step, const Truth& truth, int short_of = -1,
                         int unmoved = -1) {
    std::map<std::int64_t, std::size_t> row_of;
    for (std::size_t row = 0; row < kPoints; ++row) row_of[id_of(particles, row)] = row;
    std::vector<std::vector<std::size_t>> rows(static_cast<std::size_t>(members_));
    std::size_t at = 0;
    for (int rank = 0; rank < comm_.size(); ++rank)
      for (std::uint64_t slot = 0; slot < truth.counts[static_cast<std::size_t>(rank)]; ++slot, ++at)
        if (rank == comm_.rank())
          rows[static_cast<std::size_t>(layout::rank_of_part(truth.part[at], kDirectParts, members_))].push_back(
              row_of[truth.id[at]]);
    std::vector<PushSlice> slices;
    for (int k = 0; k < members_; ++k) {
      auto& mine = rows[static_cast<std::size_t>(k)];
      if (k == short_of && !mine.empty()) mine.pop_back();
      if (!mine.empty() && k != unmoved) slices.push_back(slice_of_rows(particles, comm_.rank(), k, mine));
    }
    std::reverse(slices.begin(), slices.end());  // any order
    Json request = begin(particles, step, "plan");
    request["staged"] = std::vector<int>(places_.size(), 1);
    request["base_step"] = step - 1;
    if (unmoved >= 0) request["moved_by"][static_cast<std::size_t>(unmoved)] = "none";
    if (unmoved >= 0 && members_ == 1) request["moved"] = "none";
    request["plan"] = truth.plan;
    Response answer = service_.execute(request, std::move(slices));
    if (answer.status.ok()) take(answer, true);
    return answer;
  }

  // As the answers tell; on rank 0.
  const std::vector<std::map<std::int64_t, Place>>& places() const { return places_; }
  std::map<std::int64_t, std::int32_t>& changed() { return changed_; }

 private:
  static constexpr std::size_t kEach = 5;

  Json begin(const Particles& particles, std::int64_t step, const char* order) const {
    return {{"command", "push.members"},
            {"scene", "m"},
            {"session", "members"},
            {"step", step},
            {"n", particles.count()},
            {"order", order},
            {"weights", !particles.weights.empty()},
            {"ids", order == std::string("id")},
            {"changes", true},
            {"places", true},
            {"members", members_},
            {"moved_by", std::vector<std::string>(places_.size(), "all")}};
  }

  void take(const Response& answer, bool changes_alone) {
    if (comm_.rank() != 0) return;
    ASSERT_EQ(answer.arrays.size(), kEach * places_.size());
    changed_.clear();
    for (std::size_t k = 0; k < places_.size(); ++k) {
      const auto* of = &answer.arrays[kEach * k];
      const auto changed = values<std::int64_t>(of[0]), placed = values<std::int64_t>(of[2]);
      if (!changes_alone) places_[k].clear();
      for (std::size_t i = 0; i < changed.size(); ++i) {
        const std::int32_t part = values<std::int32_t>(of[1])[i];
        changed_[changed[i]] = part;
        if (!changes_alone) continue;
        EXPECT_TRUE(places_[k].contains(changed[i])) << "told another's change";
        if (layout::rank_of_part(part, kDirectParts, members_) != static_cast<int>(k)) places_[k].erase(changed[i]);
      }
      for (const auto* list : {&changed, &placed}) EXPECT_TRUE(std::is_sorted(list->begin(), list->end()));
      for (std::size_t i = 0; i < placed.size(); ++i)
        places_[k][placed[i]] = {values<std::int32_t>(of[3])[i], values<std::uint64_t>(of[4])[i]};
    }
  }

  comm::Comm& comm_;
  Service& service_;
  int members_;
  std::vector<std::map<std::int64_t, Place>> places_;
  std::map<std::int64_t, std::int32_t> changed_;
};

void same_scene_as_one_client(int members, bool own_ids, bool weighted) {
  on_ranks({1, 2, 3, 4}, [&](comm::Comm& comm) {
    Service one(comm, kClock), many(comm, kClock);
    Driver single(comm, one, "m"), asks(comm, many, "m");
    for (Driver* driver : {&single, &asks}) driver->create({{"parts", kDirectParts}, {"dims", 2}, {"tolerance", 0.08}});
    Particles particles = random_particles(kDirectSeed, kPoints, 2);
    if (own_ids)
      for (std::size_t row = 0; row < kPoints; ++row)
        particles.ids.push_back(static_cast<std::int64_t>((row * 7919) % kPoints) * 11 + 3);
    if (weighted)
      for (std::size_t row = 0; row < kPoints; ++row) particles.weights.push_back(1.0 + static_cast<double>(row % 5));
    Team team(comm, many, members);
    std::uint64_t few = 0, full = 0;  // changes of rank
    for (int step = 0; step < kDirectSteps; ++step) {
      const Truth before = step == 0 ? Truth{} : ask_truth(comm, asks);
      // A little, so that a few change their rank; much once; not at all once.
      const Particles old = particles;
      if (step > 0 && step != 5)
        drift(particles, kDirectSeed + static_cast<std::uint64_t>(step), step == 3 ? 0.4 : 0.004);
      const int unmoved = step == 4 || step == 6 ? members / 2 : -1;
      for (std::size_t k = 0; unmoved >= 0 && k < kPoints; ++k) {
        if (layout::rank_of_part(before.part[k], kDirectParts, members) != unmoved) continue;
        std::size_t row = 0;
        while (id_of(particles, row) != before.id[k]) ++row;
        for (std::size_t a = 0; a < 2; ++a) particles.position[a][row] = old.position[a][row];
      }
      Particles pushed = particles;
      if (unmoved >= 0) pushed.weights.clear();
      const Response expected = single.push(pushed, step);
      const Response answer =
          step == 0 ? team.push_by_id(pushed, step) : team.push_directly(pushed, step, before, -1, unmoved);
      EXPECT_TRUE(answer.status.ok()) << answer.status.message();
      const Truth truth = ask_truth(comm, asks);
      const Response shown = single.ask("scene.show"), shown_too = asks.ask("scene.show");
      if (comm.rank() != 0) continue;
      for (const char* name : {"hash", "counts", "epoch", "error", "plan", "ids", "step", "weights"})
        EXPECT_EQ(shown.json[name], shown_too.json[name]) << name << " at step " << step;
      for (const char* name :
           {"repartitioned", "drifted", "moved", "migrated", "error_before", "reason", "n", "skipped"}) {
        if (name == std::string("skipped") && unmoved >= 0 && members == 1) continue;  // nothing came at all: `motion`
        EXPECT_EQ(expected.json["report"][name], answer.json["report"][name]) << name << " at step " << step;
      }
      EXPECT_EQ(team.places(), places_of(truth, members)) << "step " << step << ", " << comm.size() << " ranks";
      std::map<std::int64_t, std::int32_t> changed;
      const auto id = values<std::int64_t>(expected.arrays[0]);
      for (std::size_t i = 0; i < id.size(); ++i) changed[id[i]] = values<std::int32_t>(expected.arrays[1])[i];
      EXPECT_EQ(team.changed(), changed);
      const auto migrated = answer.json["report"]["migrated"].get<std::uint64_t>();
      if (step > 0 && migrated > 0) ++(layout::is_full_change(migrated, kPoints) ? full : few);
    }
    if (comm.rank() == 0 && comm.size() > 1) {
      EXPECT_GT(few, 0U) << "no step changes a few ranks: the test is too tame";
      EXPECT_GT(full, 0U) << "no step changes many ranks: the test is too tame";
    }
  });
}

TEST(MembersDirect, OfIdsByRow) {
  for (const int members : {1, 2, 3, 5, 9}) same_scene_as_one_client(members, false, false);
}

TEST(MembersDirect, OfOwnIdsAndWeights) {
  for (const int members : {1, 2, 3, 5, 9}) same_scene_as_one_client(members, true, true);
}

TEST(MembersDirect, AShareThatIsNotWhatItsPartsHaveIsRefused) {
  on_ranks({1, 2, 3}, [](comm::Comm& comm) {
    Service service(comm, kClock);
    Driver asks(comm, service, "m");
    asks.create({{"parts", kDirectParts}, {"dims", 2}});
    Particles particles = random_particles(kDirectSeed, kPoints, 2);
    Team team(comm, service, 3);
    EXPECT_TRUE(team.push_by_id(particles, 0).status.ok());
    const Truth truth = ask_truth(comm, asks);
    const Response before = asks.ask("scene.show");
    const auto refused = [&](const Truth& by, int short_of, const char* word) {
      const Response answer = team.push_directly(particles, 1, by, short_of);
      const Response after = asks.ask("scene.show");
      if (comm.rank() != 0) return;
      EXPECT_EQ(answer.status.code(), Code::stale_plan);
      EXPECT_NE(answer.status.message().find(word), std::string::npos) << answer.status.message();
      EXPECT_EQ(before.json, after.json);
    };
    refused(truth, 2, "members bring");
    Truth other = truth;
    other.plan["version"] = 9;
    refused(other, -1, "plan version 9");
    EXPECT_TRUE(team.push_directly(particles, 1, truth).status.ok());
  });
}

}  // namespace
}  // namespace rcb::testing
