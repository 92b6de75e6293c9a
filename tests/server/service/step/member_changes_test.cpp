// Members that insert, remove, and push few of their particles, by ids and straight to the ranks, leave the scene that
// one client's push of the same leaves, on any number of ranks; and each is told the places of what is then its own.
#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <set>

#include <gtest/gtest.h>

#include "common/base/clock.hpp"
#include "common/wire/limits.hpp"
#include "tests/server/service/members.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {

constexpr int kChangesParts = 6;
constexpr std::size_t kAtFirst = 240;

using Point2 = std::array<double, 2>;
using Where = std::pair<int, std::uint64_t>;  // rank and slot

// What one member does in a step.
struct Deeds {
  std::string moved = "all";
  std::vector<std::int64_t> few;  // ascending; of "some"
  std::vector<std::int64_t> removed;
  std::vector<std::pair<std::int64_t, Point2>> inserted;  // the id counts where ids are given
};

// Several spans of values, one behind the other.
struct Columns {
  std::vector<std::int64_t> id;
  std::vector<std::uint64_t> slot;
  std::vector<double> x, y, w;

  void add(const Point2& at, double weight) {
    x.push_back(at[0]);
    y.push_back(at[1]);
    w.push_back(weight);
  }
};

double weight_of(std::int64_t id) { return 1.0 + static_cast<double>(id % 3); }

class TeamWorld {
 public:
  TeamWorld(comm::Comm& comm, int members, bool weighted, std::uint64_t seed)
      : comm_(comm),
        one_(comm, clock_),
        many_(comm, clock_),
        single_(comm, one_, "m"),
        team_(comm, many_, "m"),
        members_(members),
        weighted_(weighted),
        random_(seed),
        held_(static_cast<std::size_t>(members)) {
    for (Driver* driver : {&single_, &team_})
      driver->create({{"parts", kChangesParts}, {"dims", 2}, {"tolerance", 0.1}});
  }

  void first_push() {
    std::vector<PushSlice> whole(1), shares;
    Columns all;
    std::vector<Columns> of(static_cast<std::size_t>(members_));
    for (std::size_t k = 0; k < kAtFirst; ++k) {
      const auto id = static_cast<std::int64_t>(k);
      world_[id] = draw();
      const std::size_t member = random_.below(held_.size());
      held_[member].insert(id);
      for (Columns* columns : {&all, &of[member]}) {
        columns->add(world_[id], weight_of(id));
        columns->id.push_back(id);
      }
    }
    all.id.clear();
    whole[0] = slice(0, 0, all, weighted_);
    for (std::size_t m = 0; m < of.size(); ++m)
      if (!of[m].id.empty()) shares.push_back(slice(0, static_cast<int>(m), of[m], weighted_));
    const std::vector<Deeds> none(held_.size());
    Json by_one = begin("push", "id", none);
    Json by_many = begin("push.members", "id", none);
    for (Json* request : {&by_one, &by_many}) (*request)["weights"] = weighted_;
    by_one["ids"] = false;
    compare(execute(one_, by_one, std::move(whole)), execute(many_, by_many, std::move(shares)), none, false);
  }

  // chosen_ids: the service chooses the ids of what is inserted.
  void step(bool direct, bool chosen_ids, bool all_few) {
    std::vector<Deeds> deeds;
    std::int64_t next_id = world_.empty() ? 0 : std::max(world_.rbegin()->first + 1, greatest_ + 1);
    for (const auto& held : held_) {
      Deeds& mine = deeds.emplace_back();
      const std::uint64_t kind = random_.below(3) + (all_few ? 1 : 0);
      mine.moved = kind == 0 ? "all" : kind == 1 ? "some" : "none";
      for (const std::int64_t id : held) {
        const bool moves = kind == 0 || (kind == 1 && random_.below(5) == 0);
        if (moves) world_[id] = nearby(world_[id]);
        if (moves && kind == 1) mine.few.push_back(id);
        if (random_.below(20) == 0) mine.removed.push_back(id);
      }
      if (kind == 1 && mine.few.empty()) mine.moved = "none";
      for (std::uint64_t k = random_.below(7); k > 0; --k) {
        mine.inserted.emplace_back(next_id, draw());
        next_id += chosen_ids ? 1 : 1 + static_cast<std::int64_t>(random_.below(3));
      }
      std::reverse(mine.removed.begin(), mine.removed.end());  // any order
    }
    ++step_;
    Json by_one = begin("push", "id", deeds), by_many = begin("push.members", direct ? "plan" : "id", deeds);
    for (Json* request : {&by_one, &by_many}) {
      (*request)["base_step"] = step_ - 1;
      (*request)["inserted_ids"] = !chosen_ids;
      (*request)["weights"] = false;
    }
    by_one["moved"] = "all";
    by_one["ids"] = false;
    if (direct) by_many["plan"] = team_plan_;
    if (direct) by_many["staged"] = std::vector<int>(held_.size(), 1);
    const Response expected = execute(one_, by_one, slices_of_one(deeds, chosen_ids));
    const Response answer =
        execute(many_, by_many, direct ? slices_of_ranks(deeds, chosen_ids) : slices_by_ids(deeds, chosen_ids));
    for (std::size_t m = 0; m < deeds.size(); ++m) {
      for (const std::int64_t id : deeds[m].removed) world_.erase(id), held_[m].erase(id);
      for (const auto& [id, at] : deeds[m].inserted) {
        world_[id] = at;
        held_[m].insert(id);
        greatest_ = std::max(greatest_, id);
      }
    }
    const auto pushes_all = [](const Deeds& mine) { return mine.moved == "all"; };
    compare(expected, answer, deeds, direct || std::none_of(deeds.begin(), deeds.end(), pushes_all));
  }

 private:
  Point2 draw() { return {random_.uniform(), random_.uniform()}; }
  Point2 nearby(Point2 at) {
    for (double& value : at) value += random_.uniform(-0.03, 0.03);
    return at;
  }

  static PushSlice slice(int rank, int member, const Columns& of, bool weights) {
    PushSlice slice{.rank = rank, .count = of.x.size(), .member = member};
    slice.arrays = {array_of("x", "<f8", of.x), array_of("y", "<f8", of.y)};
    if (weights) slice.arrays.push_back(array_of("w", "<f8", of.w));
    if (!of.id.empty()) slice.arrays.push_back(array_of("id", "<i8", of.id));
    if (!of.slot.empty()) slice.arrays.push_back(array_of("slot", "<u8", of.slot));
    return slice;
  }

  Response execute(Service& service, const Json& request, std::vector<PushSlice> slices) {
    const bool staged = request.contains("staged");
    return service.execute(request, comm_.rank() == 0 || staged ? std::move(slices) : std::vector<PushSlice>());
  }

  // The order that rank 0 makes of the members' pushes.
  Json begin(const char* command, const char* order, const std::vector<Deeds>& deeds) const {
    Json request{{"command", command},      {"scene", "m"},   {"session", "s"},  {"step", step_},
                 {"n", world_.size()},      {"order", order}, {"changes", true}, {"places", true},
                 {"members", deeds.size()}, {"attempt", 0}};
    std::uint64_t inserted = 0, removed = 0, all = 0, none = 0, sent = 0;
    std::vector<std::uint64_t> few(static_cast<std::size_t>(comm_.size()), 0);
    for (std::size_t m = 0; m < deeds.size(); ++m) {
      request["moved_by"].push_back(deeds[m].moved);
      inserted += deeds[m].inserted.size();
      removed += deeds[m].removed.size();
      all += deeds[m].moved == "all" ? 1U : 0U;
      none += deeds[m].moved == "none" ? 1U : 0U;
      sent += deeds[m].moved == "all" ? held_[m].size() : deeds[m].few.size();
      for (const std::int64_t id : deeds[m].few)
        if (const auto found = places_.find(id); found != places_.end())
          ++few[static_cast<std::size_t>(found->second.first)];
    }
    request["inserted"] = inserted;
    request["removed"] = removed;
    const bool direct = order == std::string("plan");
    request["moved"] = none == deeds.size() ? "none" : (direct ? all == 0 : all < deeds.size()) ? "some" : "all";
    request["ids"] = !direct && request["moved"] == "all";
    if (command == std::string("push.members") && request["moved"] == "some")
      request["counts"] = direct ? few : std::vector<std::uint64_t>{sent};
    return request;
  }

  // Those of inserted and removed particles. split: of each member its own; else of one client.
  void add_edits(const std::vector<Deeds>& deeds, bool chosen_ids, bool split, std::vector<PushSlice>& slices) const {
    if (comm_.rank() != 0) return;
    Columns inserted, removed;
    for (std::size_t m = 0; m < deeds.size(); ++m) {
      for (const auto& [id, at] : deeds[m].inserted) {
        inserted.add(at, weight_of(id));
        if (!chosen_ids) inserted.id.push_back(id);
      }
      removed.id.insert(removed.id.end(), deeds[m].removed.begin(), deeds[m].removed.end());
      if (!split && m + 1 < deeds.size()) continue;
      const auto member = static_cast<int>(m);
      if (!inserted.x.empty()) slices.push_back(slice(wire::kInsertedSlice, member, inserted, weighted_));
      if (!removed.id.empty()) {
        slices.push_back({.rank = wire::kRemovedSlice, .count = removed.id.size(), .member = member});
        slices.back().arrays = {array_of("id", "<i8", removed.id)};
      }
      inserted = removed = {};
    }
  }

  std::vector<PushSlice> slices_of_one(const std::vector<Deeds>& deeds, bool chosen_ids) const {
    Columns all;
    for (const auto& [id, at] : world_) all.add(at, weight_of(id));
    std::vector<PushSlice> slices;
    if (!world_.empty()) slices.push_back(slice(0, 0, all, false));
    add_edits(deeds, chosen_ids, false, slices);
    return slices;
  }

  std::vector<PushSlice> slices_by_ids(const std::vector<Deeds>& deeds, bool chosen_ids) const {
    std::vector<PushSlice> slices;
    for (std::size_t m = 0; m < deeds.size(); ++m) {
      Columns mine;
      mine.id = deeds[m].moved == "all" ? std::vector(held_[m].begin(), held_[m].end()) : deeds[m].few;
      std::reverse(mine.id.begin(), mine.id.end());  // any order
      for (const std::int64_t id : mine.id) mine.add(world_.at(id), 0);
      if (!mine.id.empty()) slices.push_back(slice(0, static_cast<int>(m), mine, false));
    }
    add_edits(deeds, chosen_ids, true, slices);
    std::reverse(slices.begin(), slices.end());
    return slices;
  }

  // This rank's, by the places that the members have been told.
  std::vector<PushSlice> slices_of_ranks(const std::vector<Deeds>& deeds, bool chosen_ids) const {
    std::vector<PushSlice> slices;
    for (std::size_t m = 0; m < deeds.size(); ++m) {
      std::map<std::uint64_t, std::int64_t> here;
      for (const std::int64_t id : held_[m])
        if (places_.at(id).first == comm_.rank()) here[places_.at(id).second] = id;
      Columns mine;
      const bool all = deeds[m].moved == "all";
      for (const auto& [slot, id] : here) {
        if (!all && !std::binary_search(deeds[m].few.begin(), deeds[m].few.end(), id)) continue;
        mine.add(world_.at(id), 0);
        if (!all) mine.slot.push_back(slot);
      }
      if (!mine.x.empty()) slices.push_back(slice(comm_.rank(), static_cast<int>(m), mine, false));
    }
    add_edits(deeds, chosen_ids, true, slices);
    return slices;
  }

  // Both services are in the same state; the members are told what they should be, and hand over as told.
  void compare(const Response& expected, const Response& answer, const std::vector<Deeds>& deeds, bool changes_alone) {
    ASSERT_TRUE(expected.status.ok()) << expected.status.message();
    ASSERT_TRUE(answer.status.ok()) << answer.status.message();
    const Response plan = team_.ask("plan"), plan_of_one = single_.ask("plan");
    const Response shown = single_.ask("scene.show"), shown_too = team_.ask("scene.show");
    std::vector<std::int64_t> id;
    std::vector<std::int32_t> part;
    std::vector<std::uint64_t> counts;
    if (comm_.rank() == 0) {
      for (const char* name : {"hash", "n", "counts", "epoch", "error", "plan", "ids", "step"})
        EXPECT_EQ(shown.json[name], shown_too.json[name]) << name << " at step " << step_;
      for (const char* name : {"repartitioned", "drifted", "moved", "migrated", "inserted", "removed", "error", "n"})
        EXPECT_EQ(expected.json["report"][name], answer.json["report"][name]) << name << " at step " << step_;
      EXPECT_EQ(answer.json["places"], changes_alone ? "changed" : "all");
      id = values<std::int64_t>(plan.arrays[0]);
      EXPECT_EQ(id, values<std::int64_t>(plan_of_one.arrays[0]));
      part = values<std::int32_t>(plan.arrays[1]);
      counts = plan.json["counts"].get<std::vector<std::uint64_t>>();
    }
    spread(id);
    spread(part);
    spread(counts);
    std::string text = comm_.rank() == 0 ? plan.json["plan"].dump() : "";
    std::vector<char> letters(text.begin(), text.end());
    spread(letters);
    team_plan_ = Json::parse(letters);
    if (comm_.rank() == 0) check_told(expected, answer, deeds, changes_alone, id, part, counts);
    for (auto& held : held_) held.clear();
    places_.clear();
    std::size_t at = 0;
    for (std::size_t rank = 0; rank < counts.size(); ++rank)
      for (std::uint64_t slot = 0; slot < counts[rank]; ++slot, ++at) {
        places_[id[at]] = {static_cast<int>(rank), slot};
        held_[static_cast<std::size_t>(layout::rank_of_part(part[at], kChangesParts, members_))].insert(id[at]);
      }
  }

  template <typename T>
  void spread(std::vector<T>& values) {
    std::uint64_t size = comm_.rank() == 0 ? values.size() : 0;
    comm_.all_max({&size, 1});
    values.resize(size);
    comm_.broadcast(std::as_writable_bytes(std::span(values)), 0);
  }

  void check_told(const Response& expected, const Response& answer, const std::vector<Deeds>& deeds, bool changes_alone,
                  const std::vector<std::int64_t>& id, const std::vector<std::int32_t>& part,
                  const std::vector<std::uint64_t>& counts) {
    std::map<std::int64_t, std::int32_t> part_of;
    std::map<std::int64_t, Where> truth;
    std::size_t at = 0;
    for (std::size_t rank = 0; rank < counts.size(); ++rank)
      for (std::uint64_t slot = 0; slot < counts[rank]; ++slot, ++at) {
        truth[id[at]] = {static_cast<int>(rank), slot};
        part_of[id[at]] = part[at];
      }
    const std::size_t each = answer.arrays.size() / held_.size();
    std::map<std::int64_t, std::int32_t> changed;
    for (std::size_t m = 0; m < held_.size(); ++m) {
      std::map<std::string, const wire::Array*> told;
      for (std::size_t a = 0; a < each; ++a) told[answer.arrays[m * each + a].name] = &answer.arrays[m * each + a];
      const auto ids = [&](const char* name) { return values<std::int64_t>(*told.at(name)); };
      std::map<std::int64_t, Where> places;
      for (const std::int64_t held : held_[m])
        if (changes_alone && places_.contains(held)) places[held] = places_.at(held);
      const auto placed = ids("place_id"), mine = ids("changed_id");
      for (std::size_t i = 0; i < mine.size(); ++i) {
        EXPECT_TRUE(held_[m].contains(mine[i])) << "told another's change";
        changed[mine[i]] = values<std::int32_t>(*told.at("changed_part"))[i];
        if (layout::rank_of_part(changed[mine[i]], kChangesParts, members_) != static_cast<int>(m))
          places.erase(mine[i]);
      }
      for (std::size_t i = 0; i < placed.size(); ++i)
        places[placed[i]] = {values<std::int32_t>(*told.at("place_rank"))[i],
                             values<std::uint64_t>(*told.at("place_slot"))[i]};
      std::map<std::int64_t, Where> wanted;
      for (const auto& [one, where] : truth)
        if (layout::rank_of_part(part_of.at(one), kChangesParts, members_) == static_cast<int>(m)) wanted[one] = where;
      EXPECT_EQ(places, wanted) << "member " << m << ", step " << step_;
      std::vector<std::int64_t> inserted;
      for (const auto& [one, where] : deeds[m].inserted) inserted.push_back(one);
      if (told.contains("inserted_id")) {
        EXPECT_EQ(ids("inserted_id"), inserted);
      } else {
        EXPECT_TRUE(inserted.empty());
      }
    }
    std::map<std::int64_t, std::int32_t> changed_of_one;
    const auto find = [&](const char* name) { return *std::ranges::find(expected.arrays, name, &wire::Array::name); };
    for (std::size_t i = 0; i < values<std::int64_t>(find("changed_id")).size(); ++i)
      changed_of_one[values<std::int64_t>(find("changed_id"))[i]] = values<std::int32_t>(find("changed_part"))[i];
    EXPECT_EQ(changed, changed_of_one);
  }

  comm::Comm& comm_;
  const SteadyClock clock_;
  Service one_, many_;
  Driver single_, team_;
  int members_;
  bool weighted_;
  Random random_;
  std::map<std::int64_t, Point2> world_;
  std::vector<std::set<std::int64_t>> held_;  // by member
  std::map<std::int64_t, Where> places_;
  Json team_plan_;
  std::int64_t step_ = 0;
  std::int64_t greatest_ = -1;
};

TEST(MemberChanges, LeaveTheSceneOfOneClient) {
  constexpr std::uint64_t kSeed = 20261123;
  for (const int members : {1, 2, 3, 5})
    for (const bool weighted : {false, true})
      on_ranks({1, 2, 3, 4}, [&](comm::Comm& comm) {
        TeamWorld world(comm, members, weighted, kSeed + static_cast<std::uint64_t>(members));
        world.first_push();
        for (int step = 0; step < 12 && !::testing::Test::HasFailure(); ++step)
          world.step(step % 2 == 1, step % 3 == 0, step % 4 >= 2);
      });
}

}  // namespace
}  // namespace rcb::testing
