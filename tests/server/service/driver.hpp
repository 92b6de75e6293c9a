// A client of the service without sockets: holds the plan as a solver's library would, and pushes by it.
#pragma once

#include <cstring>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/clock.hpp"
#include "common/base/random.hpp"
#include "common/layout/layout.hpp"
#include "tests/server/service/service_with_ledgers.hpp"

namespace rcb::testing {

inline const SteadyClock kClock;

struct Particles {
  int dims = 3;
  std::vector<std::vector<double>> position;  // [dims][n]
  std::vector<std::int64_t> ids;              // empty: row numbers
  std::vector<double> weights;                // empty: none

  std::size_t count() const { return position.empty() ? 0 : position[0].size(); }
};

inline Particles random_particles(std::uint64_t seed, std::size_t n, int dims) {
  Random random(seed);
  Particles particles;
  particles.dims = dims;
  particles.position.assign(static_cast<std::size_t>(dims), std::vector<double>(n));
  for (auto& axis : particles.position)
    for (double& value : axis) value = random.uniform();
  return particles;
}

inline void drift(Particles& particles, std::uint64_t seed, double width) {
  Random random(seed);
  for (auto& axis : particles.position)
    for (double& value : axis) value += random.uniform(-width, width);
}

// Every rank makes one over its own Service; all do the same.
class Driver {
 public:
  Driver(comm::Comm& comm, Service& service, std::string scene)
      : comm_(comm), service_(service), scene_(std::move(scene)) {}

  Response create(Json options) {
    options["command"] = "scene.create";
    options["scene"] = scene_;
    return service_.execute(options);
  }

  Response ask(const std::string& command, Json arguments = Json::object()) {
    arguments["command"] = command;
    arguments["scene"] = scene_;
    return service_.execute(arguments);
  }

  // In the plan's order; the plan follows from the answer's changes (which all ranks are told, for the test's sake).
  Response push(const Particles& particles, std::int64_t step, const std::string& session = "s") {
    if (first_) plan_ = layout::Layout::blocks(particles.count(), comm_.size(), particles.ids);
    std::vector<PushSlice> slices;
    Json request = begin(particles, step, session, "plan");
    if (directly) {
      slices.push_back(slice_of(particles, comm_.rank()));
      request["staged"] = 1;
    } else if (comm_.rank() == 0) {
      for (int r = 0; r < comm_.size(); ++r) slices.push_back(slice_of(particles, r));
    }
    request["plan"] = {{"version", plan_.version()}, {"checksum", wire::hex64(plan_.checksum())}};
    Response response = service_.execute(request, std::move(slices));
    follow(particles, response);
    return response;
  }

  // Brings the particles of the last step to a service that lacks them.
  Response refill(const Particles& particles, std::int64_t step, const std::string& order = "plan",
                  const Json& more = Json::object()) {
    const int slices_due = order == "id" ? 1 : comm_.size();
    first_ = true;
    plan_ = layout::Layout::blocks(particles.count(), slices_due, particles.ids);
    Json request = begin(particles, step, "s", order);
    request["refill"] = true;
    std::vector<PushSlice> slices;
    for (int r = 0; r < slices_due && comm_.rank() == 0; ++r) slices.push_back(slice_of(particles, r));
    request["plan"] = {{"version", plan_.version()}, {"checksum", wire::hex64(plan_.checksum())}};
    request.update(more);
    Response response = service_.execute(request, std::move(slices));
    std::uint64_t done = comm_.rank() == 0 && response.status.ok() ? 1 : 0;
    comm_.all_max({&done, 1});
    if (done == 1) fetch_plan(particles);
    if (done == 1 && comm_.rank() == 0) {
      EXPECT_EQ(response.json["plan"]["checksum"].get<std::string>(), wire::hex64(plan_.checksum()));
    }
    return response;
  }

  // Takes the plan from the service, as after a rebalance.
  void fetch_plan(const Particles& particles) {
    Response told = ask("plan");
    if (comm_.rank() == 0) {
      auto numbers = told.json["counts"].get<std::vector<std::uint64_t>>();
      numbers.push_back(told.json["plan"]["version"].get<std::uint64_t>());
      told.arrays.push_back(api::make_array<std::uint64_t>("numbers", "<u8", numbers));
    }
    const auto ids = everywhere<std::int64_t>(told, 0);
    auto counts = everywhere<std::uint64_t>(told, 2);
    const std::uint64_t version = counts.back();
    counts.pop_back();
    plan_ = layout::Layout::full(counts, ids, particles.ids, version).value();
    rank_of_row_.resize(particles.count());
    for (std::size_t row = 0; row < rank_of_row_.size(); ++row) rank_of_row_[row] = plan_.rank_of_row(row);
    first_ = false;
  }

  // As a simple client does: one slice in ascending id.
  Response push_by_id(const Particles& particles, std::int64_t step, const std::string& session = "s") {
    std::vector<PushSlice> slices;
    if (comm_.rank() == 0) {
      const layout::Layout whole = layout::Layout::blocks(particles.count(), 1, particles.ids);
      slices.push_back(slice_by_rows(particles, 0, whole.rows(0)));
    }
    Response response = service_.execute(begin(particles, step, session, "id"), std::move(slices));
    return response;
  }

  const layout::Layout& plan() const { return plan_; }

  bool directly = false;  // pushes go straight to the ranks
  Json step_seconds;      // said with every push; null: nothing
  Json cuts_known;        // likewise

 private:
  Json begin(const Particles& particles, std::int64_t step, const std::string& session,
             const std::string& order) const {
    return {{"command", "push"},
            {"scene", scene_},
            {"session", session},
            {"step", step},
            {"attempt", 0},
            {"n", particles.count()},
            {"order", order},
            {"weights", !particles.weights.empty()},
            {"ids", first_ && !particles.ids.empty()},
            {"changes", true},
            {"step_seconds", step_seconds},
            {"cuts_known", cuts_known}};
  }

  PushSlice slice_of(const Particles& particles, int rank) const {
    std::vector<std::uint64_t> rows(plan_.rows(rank).begin(), plan_.rows(rank).end());
    std::erase_if(rows, [&](std::uint64_t row) { return row >= particles.count(); });  // a push of too few
    return slice_by_rows(particles, rank, rows);
  }

  PushSlice slice_by_rows(const Particles& particles, int rank, std::span<const std::uint64_t> rows) const {
    PushSlice slice{rank, rows.size(), {}};
    const auto add = [&](const char* name, const char* dtype, const auto& values) {
      wire::Array array{name, dtype, {rows.size()}, Buffer<std::byte>(rows.size() * 8)};
      for (std::size_t k = 0; k < rows.size(); ++k) std::memcpy(array.bytes.data() + 8 * k, &values[rows[k]], 8);
      slice.arrays.push_back(std::move(array));
    };
    constexpr const char* kNames[] = {"x", "y", "z"};
    for (std::size_t a = 0; a < particles.position.size(); ++a) add(kNames[a], "<f8", particles.position[a]);
    if (!particles.weights.empty()) add("w", "<f8", particles.weights);
    if (first_ && !particles.ids.empty()) add("id", "<i8", particles.ids);
    return slice;
  }

  template <typename T>
  std::vector<T> everywhere(const Response& response, std::size_t array) {
    std::uint64_t bytes = comm_.rank() == 0 && response.arrays.size() > array ? response.arrays[array].bytes.size() : 0;
    comm_.all_max({&bytes, 1});
    std::vector<T> values(bytes / sizeof(T));
    if (comm_.rank() == 0 && bytes > 0) std::memcpy(values.data(), response.arrays[array].bytes.data(), bytes);
    comm_.broadcast(std::as_writable_bytes(std::span(values)), 0);
    return values;
  }

  void follow(const Particles& particles, const Response& response) {
    std::uint64_t committed = comm_.rank() == 0 && response.status.ok() && !response.json.contains("repeated") ? 1 : 0;
    comm_.all_max({&committed, 1});
    if (committed == 0) return;
    const auto ids = everywhere<std::int64_t>(response, 0);
    const auto parts = everywhere<std::int32_t>(response, 1);
    std::uint64_t part_count = 0;
    const Response shown = ask("counts");
    if (comm_.rank() == 0) part_count = shown.json["counts"].size();
    comm_.all_max({&part_count, 1});
    if (first_) rank_of_row_ = block_ranks(particles.count());
    std::vector<std::uint64_t> rows;
    std::vector<std::int32_t> ranks;
    for (std::size_t k = 0; k < ids.size(); ++k) {
      const std::uint64_t row = row_of(particles, ids[k]);
      const int rank = layout::rank_of_part(parts[k], static_cast<int>(part_count), comm_.size());
      if (rank_of_row_[row] == rank) continue;
      rank_of_row_[row] = rank;
      rows.push_back(row);
      ranks.push_back(rank);
    }
    const Status applied = plan_.apply(rows, ranks, first_);
    EXPECT_TRUE(applied.ok()) << applied.message();
    first_ = false;
    if (comm_.rank() == 0) {
      EXPECT_EQ(response.json["plan"]["version"].get<std::uint64_t>(), plan_.version());
      EXPECT_EQ(response.json["plan"]["checksum"].get<std::string>(), wire::hex64(plan_.checksum()));
    }
  }

  std::vector<int> block_ranks(std::uint64_t n) const {
    std::vector<int> ranks(n);
    for (int r = 0; r < comm_.size(); ++r)
      for (std::uint64_t i = layout::row_begin(r, n, comm_.size()); i < layout::row_begin(r + 1, n, comm_.size()); ++i)
        ranks[i] = r;
    return ranks;
  }

  static std::uint64_t row_of(const Particles& particles, std::int64_t id) {
    if (particles.ids.empty()) return static_cast<std::uint64_t>(id);
    for (std::size_t row = 0; row < particles.ids.size(); ++row)
      if (particles.ids[row] == id) return row;
    ADD_FAILURE() << "unknown id " << id;
    return 0;
  }

  comm::Comm& comm_;
  Service& service_;
  std::string scene_;
  layout::Layout plan_ = layout::Layout::blocks(0, 1, {});
  std::vector<int> rank_of_row_;
  bool first_ = true;
};

// One with a service of its own, on which its scene is made.
struct OwnService {
  Service service;
};
class OwnDriver : public OwnService, public Driver {
 public:
  OwnDriver(comm::Comm& comm, const std::string& scene, const Json& options, service::ServiceOptions of_service = {})
      : OwnService{Service(comm, kClock, std::move(of_service))}, Driver(comm, service, scene) {
    create(options);
  }
};

// The first answer of a name, of any rank count, is the reference for the others.
class Reference {
 public:
  void check(const std::string& name, const Json& value) {
    const std::lock_guard lock(mutex_);
    const auto [found, added] = values_.emplace(name, value);
    EXPECT_EQ(found->second, value) << name << (added ? " (the first)" : "");
  }

 private:
  std::mutex mutex_;
  std::map<std::string, Json> values_;
};

}  // namespace rcb::testing
