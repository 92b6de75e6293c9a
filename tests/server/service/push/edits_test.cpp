// Few moved, none moved, inserted and removed: random sequences against a plain model of the particles, and against the
// plan that a client derives. One answer on any rank count, in either order, and the cuts of a cold start at the end.
#include <limits>
#include <map>
#include <mutex>
#include <numeric>

#include <gtest/gtest.h>

#include "tests/server/service/driver.hpp"
#include "tests/support/on_ranks.hpp"

namespace rcb::testing {
namespace {


struct Particle {
  std::array<double, 3> at;
  double weight;
};

// What one step does; drawn alike on every rank.
struct Deed {
  std::string moved = "all";
  std::vector<std::int64_t> who;  // that moved, ascending
  std::vector<std::int64_t> removed;
  std::vector<Particle> inserted;
  std::vector<std::int64_t> inserted_ids;  // empty: the service's
};

class Walk {
 public:
  Walk(comm::Comm& comm, Service& service, std::string scene, int dims, bool weighted, bool by_id)
      : comm_(comm), service_(service), scene_(std::move(scene)), dims_(dims), weighted_(weighted), by_id_(by_id) {}

  void begin(Random& random, std::size_t n, const Json& options) {
    Json create = options;
    create.update({{"command", "scene.create"}, {"scene", scene_}, {"dims", dims_}});
    service_.execute(create);
    for (std::size_t i = 0; i < n; ++i) model_[static_cast<std::int64_t>(i)] = draw(random);
    plan_ = layout::Layout::blocks(n, comm_.size(), {});
    Deed all;
    for (const auto& [id, particle] : model_) all.who.push_back(id);
    push(all, true);
  }

  Deed choose(Random& random, bool edits) {
    Deed deed;
    const std::uint64_t kind = random.below(4);
    deed.moved = kind == 0 ? "all" : kind == 1 ? "none" : "some";
    const std::uint64_t share = kind == 2 ? 40 : 4;
    for (auto& [id, particle] : model_) {
      if (kind == 1 || (kind >= 2 && random.below(share) != 0)) continue;
      for (double& x : particle.at) x += random.uniform(-0.05, 0.05);
      deed.who.push_back(id);
    }
    if (!edits) return deed;
    const bool many = random.below(6) == 0;
    for (const auto& [id, particle] : model_)
      if (random.below(many ? 2 : 30) == 0) deed.removed.push_back(id);
    for (std::uint64_t k = random.below(many ? 120 : 12); k > 0; --k) deed.inserted.push_back(draw(random));
    if (random.below(2) == 0) return deed;
    for (std::size_t k = 0; k < deed.inserted.size(); ++k)
      deed.inserted_ids.push_back(static_cast<std::int64_t>(1000000 * (random.next() >> 44U) + 999 - k));
    return deed;
  }

  // The answer, on rank 0.
  Response send(const Deed& deed, bool first = false) {
    ++step_;
    Json request{{"command", "push"},
                 {"scene", scene_},
                 {"session", "s"},
                 {"step", step_},
                 {"attempt", 0},
                 {"n", model_.size()},
                 {"order", by_id_ ? "id" : "plan"},
                 {"weights", first && weighted_},
                 {"moved", deed.moved},
                 {"changes", true},
                 {"inserted", deed.inserted.size()},
                 {"removed", deed.removed.size()},
                 {"inserted_ids", !deed.inserted_ids.empty()}};
    request["plan"] = {{"version", plan_.version()}, {"checksum", wire::hex64(plan_.checksum())}};
    if (!first) request["base_step"] = step_ - 1;
    std::vector<PushSlice> slices = slices_of(deed, first, request);
    return service_.execute(request, comm_.rank() == 0 ? std::move(slices) : std::vector<PushSlice>{});
  }

  // The report, on rank 0.
  Json push(const Deed& deed, bool first = false) {
    Response response = send(deed, first);
    std::uint64_t ok = comm_.rank() == 0 && !response.status.ok() ? 0 : 1;
    comm_.all_min({&ok, 1});
    EXPECT_EQ(ok, 1U) << response.status.message();
    if (ok == 1) follow(deed, first, response);
    return comm_.rank() == 0 ? response.json["report"] : Json();
  }

  // The service holds exactly the model, in parts whose loads it reports.
  void check() {
    const Response fetched = ask("fetch");
    const Response counts = ask("counts");
    const Response shown = ask("scene.show");
    if (comm_.rank() != 0) return;
    ASSERT_EQ(fetched.json["n"].get<std::size_t>(), model_.size());
    const auto ids = values<std::int64_t>(fetched, "id");
    const auto parts = values<std::int32_t>(fetched, "part");
    std::vector<std::uint64_t> number(counts.json["counts"].size(), 0);
    std::vector<double> loads(number.size(), 0);
    std::vector<std::vector<double>> position;
    for (int a = 0; a < dims_; ++a)
      position.push_back(values<double>(fetched, std::string(1, static_cast<char>('x' + a))));
    std::size_t i = 0;
    for (const auto& [id, particle] : model_) {
      ASSERT_EQ(ids[i], id);
      for (std::size_t a = 0; a < position.size(); ++a) ASSERT_EQ(position[a][i], particle.at[a]);
      ++number[static_cast<std::size_t>(parts[i])];
      loads[static_cast<std::size_t>(parts[i])] += particle.weight;
      ++i;
    }
    EXPECT_EQ(counts.json["counts"].get<std::vector<std::uint64_t>>(), number);
    if (weighted_) {
      EXPECT_EQ(counts.json["loads"].get<std::vector<double>>(), loads);
    }
    EXPECT_EQ(shown.json["plan"]["version"].get<std::uint64_t>(), plan_.version());
    EXPECT_EQ(shown.json["plan"]["checksum"].get<std::string>(), wire::hex64(plan_.checksum()));
  }

  Response ask(const std::string& command, Json arguments = Json::object()) {
    arguments.update({{"command", command}, {"scene", scene_}});
    return service_.execute(arguments);
  }

  const std::map<std::int64_t, Particle>& model() const { return model_; }

 private:
  static Particle draw(Random& random) {
    Particle particle{};
    for (double& x : particle.at) x = random.uniform();
    particle.weight = static_cast<double>(random.below(5));
    return particle;
  }

  template <typename T>
  static std::vector<T> values(const Response& response, const std::string& name) {
    const wire::Array* array = wire::find_array(response.arrays, name);
    if (array == nullptr) return {};
    std::vector<T> out(array->bytes.size() / sizeof(T));
    if (!out.empty()) std::memcpy(out.data(), array->bytes.data(), array->bytes.size());
    return out;
  }

  template <typename T>
  static void add(PushSlice& slice, const char* name, const char* dtype, const std::vector<T>& given) {
    wire::Array array{name, dtype, {given.size()}, {}};
    array.bytes.assign(std::as_bytes(std::span(given)));
    slice.arrays.push_back(std::move(array));
  }

  PushSlice slice_of(int rank, const std::vector<Particle>& particles, bool weights) const {
    PushSlice slice{rank, particles.size(), {}};
    constexpr const char* kNames[] = {"x", "y", "z"};
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a) {
      std::vector<double> axis;
      for (const Particle& particle : particles) axis.push_back(particle.at[a]);
      add(slice, kNames[a], "<f8", axis);
    }
    std::vector<double> weight;
    for (const Particle& particle : particles) weight.push_back(particle.weight);
    if (weights) add(slice, "w", "<f8", weight);
    return slice;
  }

  std::vector<PushSlice> slices_of(const Deed& deed, bool first, Json& request) const {
    std::vector<PushSlice> slices;
    const bool some = deed.moved == "some";
    if (some) request["counts"] = Json::array();
    for (int rank = 0; rank < (by_id_ ? 1 : comm_.size()); ++rank) {
      std::vector<Particle> particles;
      std::vector<std::int64_t> ids;
      std::vector<std::uint64_t> slots;
      const std::size_t held = by_id_ ? model_.size() : plan_.rows(rank).size();
      auto next = model_.begin();
      for (std::size_t slot = 0; slot < held; ++slot) {
        const std::int64_t id = by_id_ ? (next++)->first : plan_.id_of_row(plan_.rows(rank)[slot]);
        if (some && !std::binary_search(deed.who.begin(), deed.who.end(), id)) continue;
        particles.push_back(model_.at(id));
        ids.push_back(id);
        slots.push_back(slot);
      }
      if (some) request["counts"].push_back(particles.size());
      if (deed.moved == "none") continue;
      PushSlice slice = slice_of(rank, particles, first && weighted_);
      if (some && by_id_) add(slice, "id", "<i8", ids);
      if (some && !by_id_) add(slice, "slot", "<u8", slots);
      slices.push_back(std::move(slice));
    }
    if (!deed.inserted.empty()) {
      slices.push_back(slice_of(wire::kInsertedSlice, deed.inserted, weighted_));
      if (!deed.inserted_ids.empty()) add(slices.back(), "id", "<i8", deed.inserted_ids);
    }
    if (!deed.removed.empty()) {
      slices.push_back({wire::kRemovedSlice, deed.removed.size(), {}});
      add(slices.back(), "id", "<i8", deed.removed);
    }
    return slices;
  }

  template <typename T>
  std::vector<T> everywhere(const Response& response, const std::string& name) {
    std::vector<T> out = values<T>(response, name);
    std::uint64_t count = out.size();
    comm_.all_max({&count, 1});
    out.resize(count);
    comm_.broadcast(std::as_writable_bytes(std::span(out)), 0);
    return out;
  }

  // The model and the plan as a client brings them up to date.
  void follow(const Deed& deed, bool first, const Response& response) {
    const Response counts = ask("counts");
    std::uint64_t parts = comm_.rank() == 0 ? counts.json["counts"].size() : 0;
    comm_.all_max({&parts, 1});
    const auto rank_of = [&](std::int32_t part) {
      return layout::rank_of_part(part, static_cast<int>(parts), comm_.size());
    };
    std::vector<std::int64_t> ids = deed.inserted_ids;
    if (ids.empty() && !deed.inserted.empty()) {
      std::uint64_t chosen = comm_.rank() == 0 ? response.json["report"]["first_id"].get<std::uint64_t>() : 0;
      comm_.all_max({&chosen, 1});
      ids.resize(deed.inserted.size());
      std::iota(ids.begin(), ids.end(), static_cast<std::int64_t>(chosen));
      EXPECT_GT(ids.front(), greatest_);
    }
    std::vector<std::int32_t> ranks;
    for (const std::int32_t part : everywhere<std::int32_t>(response, "inserted_part")) ranks.push_back(rank_of(part));
    std::vector<std::uint64_t> rows;
    for (const std::int64_t id : deed.removed) rows.push_back(plan_.row_of_id(id).value());
    std::sort(rows.begin(), rows.end());
    const auto edited = plan_.edit(rows, ids, ranks);
    EXPECT_TRUE(edited.ok()) << edited.status().message();
    for (const std::int64_t id : deed.removed) model_.erase(id);
    for (std::size_t k = 0; k < ids.size(); ++k) model_[ids[k]] = deed.inserted[k];
    if (!model_.empty()) greatest_ = std::max(greatest_, model_.rbegin()->first);

    const auto changed = everywhere<std::int64_t>(response, "changed_id");
    const auto part = everywhere<std::int32_t>(response, "changed_part");
    rows.clear();
    ranks.clear();
    for (std::size_t k = 0; k < changed.size(); ++k) {
      rows.push_back(plan_.row_of_id(changed[k]).value());
      ranks.push_back(rank_of(part[k]));
    }
    EXPECT_TRUE(plan_.apply(rows, ranks, first).ok());
  }

  comm::Comm& comm_;
  Service& service_;
  std::string scene_;
  int dims_;
  bool weighted_;
  bool by_id_;
  std::int64_t step_ = -1;
  std::int64_t greatest_ = 0;
  std::map<std::int64_t, Particle> model_;
  layout::Layout plan_ = layout::Layout::blocks(0, 1, {});
};

Json edits_and_cuts(Json report) {
  for (const char* name : {"seconds", "migrated", "skipped", "scene", "bytes", "searched", "rounds", "reductions"})
    report.erase(name);
  return report;
}

TEST(Changes, RandomSequencesAgainstAModel) {
  Reference same;
  on_ranks([&](comm::Comm& comm) {
    for (std::uint64_t seed = 1; seed <= 8; ++seed) {
      SCOPED_TRACE(::testing::Message() << "seed " << seed << ", " << comm.size() << " ranks");
      const int dims = 1 + static_cast<int>(seed % 3);
      const bool weighted = seed % 4 == 3;
      const Json options{{"parts", 6}, {"tolerance", seed % 2 == 0 ? Json(0.15) : Json("inf")}};
      for (const bool by_id : {false, true}) {
        Random random(seed);
        Service service(comm, kClock);
        Walk walk(comm, service, "walk", dims, weighted, by_id);
        walk.begin(random, 60 * seed, options);
        for (int step = 1; step < 14; ++step) {
          const Json report = walk.push(walk.choose(random, step > 4));
          walk.check();
          if (comm.rank() == 0)
            same.check("seed " + std::to_string(seed) + " step " + std::to_string(step), edits_and_cuts(report));
          if (::testing::Test::HasFailure()) return;
        }
        const Response assigned = walk.ask("assign", {{"checksum", true}});
        walk.ask("rebalance");
        const Response incremental = walk.ask("scene.show");
        if (comm.rank() != 0) continue;
        same.check("seed " + std::to_string(seed), assigned.json);
        same.check("warm of seed " + std::to_string(seed), Json{incremental.json["hash"], incremental.json["counts"]});
      }
    }
  });
}

// The cuts that the last test's rebalance finds are those of a scene that never knew anything else.
TEST(Changes, AColdSceneOfTheSameParticlesCutsTheSame) {
  on_ranks([](comm::Comm& comm) {
    for (const std::uint64_t seed : {21U, 22U, 23U}) {
      Random random(seed);
      Service service(comm, kClock);
      Walk walk(comm, service, "walk", 3, seed == 22, seed == 23);
      walk.begin(random, 300, {{"parts", 5}, {"tolerance", 0.1}});
      for (int step = 1; step < 10; ++step) walk.push(walk.choose(random, true));
      walk.ask("rebalance");
      const Response incremental = walk.ask("scene.show");
      Particles particles;
      particles.position.assign(3, {});
      for (const auto& [id, particle] : walk.model()) {
        for (std::size_t a = 0; a < 3; ++a) particles.position[a].push_back(particle.at[a]);
        particles.ids.push_back(id);
        if (seed == 22) particles.weights.push_back(particle.weight);
      }
      Driver full(comm, service, "cold");
      full.create({{"parts", 5}});
      full.push(particles, 0);
      const Response shown = full.ask("scene.show");
      if (comm.rank() != 0) continue;
      for (const char* name : {"hash", "counts", "n", "error"})
        EXPECT_EQ(incremental.json[name], shown.json[name]) << name << ", seed " << seed;
    }
  });
}

TEST(Changes, AnUnmovedStepLooksAtNothing) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Walk walk(comm, service, "still", 3, false, false);
    Random random(3);
    walk.begin(random, 200, {{"parts", 4}, {"tolerance", "inf"}});
    Deed deed = walk.choose(random, false);
    while (deed.moved != "all") deed = walk.choose(random, false);
    const Json moved = walk.push(deed);
    const Json still = walk.push({.moved = "none"});
    if (comm.rank() == 0) {
      EXPECT_EQ(still["error"], moved["error"]);
      EXPECT_EQ(still["scanned"], 0);
      EXPECT_EQ(still["bytes"], 0);
      EXPECT_FALSE(still["repartitioned"]);
      EXPECT_NE(std::find(still["skipped"].begin(), still["skipped"].end(), "motion"), still["skipped"].end());
    }
    walk.check();
  });
}

TEST(Changes, AllMayGoAndOthersCome) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Walk walk(comm, service, "tide", 2, false, comm.size() % 2 == 0);
    Random random(8);
    walk.begin(random, 40, {{"parts", 3}, {"tolerance", 0.5}});
    Deed ebb{.moved = "none"};
    for (std::int64_t id = 0; id < 40; ++id) ebb.removed.push_back(id);
    const Json empty = walk.push(ebb);
    walk.check();
    if (comm.rank() == 0) {
      EXPECT_EQ(empty["n"], 0);
    }
    Deed flood{.moved = "none"};
    for (int k = 0; k < 50; ++k) flood.inserted.push_back({{random.uniform(), random.uniform(), 0}, 1});
    const Json full = walk.push(flood);
    walk.check();
    if (comm.rank() == 0) {
      EXPECT_EQ(full["n"], 50);
      EXPECT_EQ(full["first_id"], 40);  // none of the ids is used again by itself
    }
    walk.push(walk.choose(random, true));
    walk.check();
  });
}

// Ids are rows as long as what is inserted goes on where they end, without a gap.
TEST(Changes, OneIdTooHighAndTheSceneHasIdsOfItsOwn) {
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Walk walk(comm, service, "gap", 2, false, comm.size() % 2 == 0);
    Random random(5);
    walk.begin(random, 40, {{"parts", 3}, {"tolerance", "inf"}});
    std::vector<bool> own;
    for (const std::vector<std::int64_t>& ids : {std::vector<std::int64_t>{40, 41}, {42, 44}}) {
      Deed deed{.moved = "none"};
      deed.inserted.assign(2, {{0.5, 0.5, 0}, 1});
      deed.inserted_ids = ids;
      walk.push(deed);
      const Response shown = walk.ask("scene.show");
      own.push_back(comm.rank() == 0 && shown.json["ids"].get<bool>());
    }
    if (comm.rank() == 0) {
      EXPECT_EQ(own, (std::vector<bool>{false, true}));
    }
  });
}

TEST(Changes, WhatIsInsertedHasGoodValues) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  struct Bad {
    Particle particle;
    std::vector<std::int64_t> ids;
    Code code;
    std::string words;
  };
  for (const Bad& bad :
       {Bad{{{0, nan, 0}, 1}, {}, Code::not_finite, "inserted particle 1 (index, from 0): y is nan"},
        Bad{{{}, nan}, {}, Code::not_finite, "inserted particle 1 (index, from 0): weight is nan"},
        Bad{{{}, -1}, {}, Code::invalid_argument, "inserted particle 1 (index, from 0): weight is -1"},
        Bad{{{}, 1}, {7, -2}, Code::invalid_argument, "inserted particle 1 (index, from 0): id is -2"}})
    on_ranks([&](comm::Comm& comm) {
      Service service(comm, kClock);
      Walk walk(comm, service, "bad", 2, true, comm.size() % 2 == 0);
      Random random(4);
      walk.begin(random, 20, {{"parts", 3}, {"tolerance", 0.5}});
      Deed deed{.moved = "none"};
      deed.inserted = {{{0.5, 0.5, 0}, 1}, bad.particle};
      deed.inserted_ids = bad.ids;
      const Response refused = walk.send(deed);
      walk.check();
      if (comm.rank() != 0) return;
      EXPECT_EQ(refused.status.code(), bad.code) << refused.status.message();
      EXPECT_EQ(refused.status.message(), bad.words);
    });
}

TEST(Changes, ManyAtOnceGoRoundInPieces) {
  constexpr std::int64_t kMany = 140000;  // more than two pieces of them
  on_ranks([](comm::Comm& comm) {
    Service service(comm, kClock);
    Walk walk(comm, service, "many", 2, comm.size() % 2 == 0, comm.size() % 3 == 0);
    Random random(9);
    walk.begin(random, 40, {{"parts", 5}, {"tolerance", 0.5}});
    Deed flood{.moved = "none"};
    for (int k = 0; k < kMany; ++k) flood.inserted.push_back({{random.uniform(), random.uniform(), 0}, 1});
    const Json full = walk.push(flood);
    walk.check();
    if (comm.rank() == 0) {
      EXPECT_EQ(full["n"], 40 + kMany);
    }
    Deed ebb{.moved = "none"};
    for (std::int64_t id = 40; id < 40 + kMany - 7; ++id) ebb.removed.push_back(id);
    const Json left = walk.push(ebb);
    walk.check();
    if (comm.rank() == 0) {
      EXPECT_EQ(left["n"], 47);
    }
  });
}

}  // namespace
}  // namespace rcb::testing
