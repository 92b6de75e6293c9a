// Zoltan RCB along a trajectory: KEEP_CUTS=1, RCB_REUSE=1, else the settings of contender_zoltan.cpp.
#include <algorithm>
#include <array>

#include "common/base/clock.hpp"
#include "common/partition/balance/load.hpp"
#include "tests/bench/dynamic/dynamic_peers.hpp"
#include "tests/bench/peers/zoltan_field.hpp"

namespace rcb::bench {
namespace {

// This rank's particles, and what Zoltan knows of them.
class Field : private ZoltanField {
 public:
  Field(int ranks, int parts) : ranks_(ranks), parts_(parts) {}

  Status start(std::uint64_t n) {
    if (Status status = create("RCB", parts_, {{"KEEP_CUTS", "1"}, {"RCB_REUSE", "1"}}); !status.ok()) return status;
    Zoltan_Set_Part_Multi_Fn(zoltan_, parts_of, this);
    const auto r = static_cast<std::uint64_t>(rank_);
    const auto ranks = static_cast<std::uint64_t>(ranks_);
    for (std::uint64_t row = n * r / ranks; row < n * (r + 1) / ranks; ++row)
      ids_.push_back(static_cast<particles::Id>(row));
    resize(ids_.size());
    std::fill(part_.begin(), part_.end(), rank_ * parts_ / ranks_);  // its rank's first one, before there are cuts
    show_own();
    return {};
  }

  // The solver's own work: each of its particles is where the frame says.
  void move(const io::Points& frame) {
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t i = 0; i < ids_.size(); ++i) at_[a][i] = frame.position[a][static_cast<std::size_t>(ids_[i])];
  }

  // Which particles left their part; their new parts are written down. Returns how many.
  std::uint64_t find_drift() {
    refresh_boxes();
    exports_.clear();
    std::uint64_t drifted = 0;
    for (std::size_t i = 0; i < ids_.size(); ++i) {
      const Box& box = boxes_[static_cast<std::size_t>(part_[i])];
      bool inside = true;
      for (std::size_t a = 0; a < 3; ++a) inside &= (at_[a][i] > box.lo[a]) & (at_[a][i] < box.hi[a]);
      if (inside) continue;
      std::array<double, 3> point{at_[0][i], at_[1][i], at_[2][i]};
      int owner = rank_;
      int part = part_[i];
      if (zoltan_failed(Zoltan_LB_Point_PP_Assign(zoltan_, point.data(), &owner, &part)) || part == part_[i]) continue;
      ++drifted;
      part_[i] = part;
      if (owner != rank_) exports_.push_back({static_cast<ZOLTAN_ID_TYPE>(i), owner});
    }
    return drifted;
  }
  std::uint64_t leaving() const { return exports_.size(); }

  // Hands over those that find_drift() found on another rank. Collective.
  Status exchange_particles() {
    std::vector<ZOLTAN_ID_TYPE> global, local;
    std::vector<int> to_rank, to_part;
    for (const auto& [slot, owner] : exports_) {
      global.push_back(static_cast<ZOLTAN_ID_TYPE>(ids_[slot]));
      local.push_back(slot);
      to_rank.push_back(owner);
      to_part.push_back(part_[slot]);
    }
    return status_of("Zoltan_Migrate",
                     Zoltan_Migrate(zoltan_, -1, nullptr, nullptr, nullptr, nullptr, static_cast<int>(global.size()),
                                    global.data(), local.data(), to_rank.data(), to_part.data()));
  }

  // New cuts; the parts of what they moved are written down. Collective.
  Status balance() {
    release_lists();
    if (Status status = find_cuts(); !status.ok()) return status;
    moved_ = 0;
    for (int k = 0; k < export_.count; ++k) {
      int& part = part_[export_.local[k]];
      moved_ += part != export_.part[k] ? 1U : 0U;
      part = export_.part[k];
    }
    boxes_.clear();
    return {};
  }
  std::uint64_t moved() const { return moved_; }  // to another part
  std::uint64_t exported_away() const {
    return static_cast<std::uint64_t>(
        std::count_if(export_.rank, export_.rank + export_.count, [this](int to) { return to != rank_; }));
  }

  // What the new cuts moved. Collective.
  Status follow_lists() { return migrate_by_lists(); }

  // Particles of each part on this rank.
  void count(std::vector<std::uint64_t>& counts) const {
    counts.assign(static_cast<std::size_t>(parts_), 0);
    for (const int part : part_) ++counts[static_cast<std::size_t>(part)];
  }

 private:
  struct Box {
    std::array<double, 3> lo;
    std::array<double, 3> hi;
  };
  struct Exported {
    ZOLTAN_ID_TYPE slot;
    int owner;
  };

  void refresh_boxes() {
    if (!boxes_.empty()) return;
    boxes_.resize(static_cast<std::size_t>(parts_));
    for (int p = 0; p < parts_; ++p) {
      int dims = 3;
      Box& box = boxes_[static_cast<std::size_t>(p)];
      if (zoltan_failed(Zoltan_RCB_Box(zoltan_, p, &dims, &box.lo[0], &box.lo[1], &box.lo[2], &box.hi[0], &box.hi[1],
                                       &box.hi[2])))
        box = {{1, 1, 1}, {0, 0, 0}};  // nothing is inside: all are asked
    }
  }

  static void parts_of(void* data, int, int, int count, ZOLTAN_ID_PTR, ZOLTAN_ID_PTR local, int* parts, int* error) {
    const auto& me = *static_cast<Field*>(data);
    for (int k = 0; k < count; ++k) parts[k] = me.part_[local[k]];
    *error = ZOLTAN_OK;
  }

  int ranks_;
  int parts_;
  std::vector<Box> boxes_;  // of the parts; empty: new cuts since
  std::vector<Exported> exports_;
  std::uint64_t moved_ = 0;
};

// One run, step by step.
class Drive {
 public:
  Drive(comm::Comm& comm, int parts, double tolerance, std::uint64_t n)
      : comm_(comm),
        field_(comm.size(), parts),
        parts_(static_cast<std::size_t>(parts)),
        tolerance_(tolerance),
        quota_error_(partition::summarise_counts(partition::quotas(n, {}, parts), {}).error) {}

  Status start(std::uint64_t n) { return field_.start(n); }

  // Collective.
  Status first(const io::Points& frame, DynamicRun& run) {
    field_.move(frame);
    comm_.barrier();
    const double start = clock_.seconds();
    if (Status status = rebalance(nullptr, nullptr); !status.ok()) return status;
    comm_.barrier();
    run.seconds_first = clock_.seconds() - start;
    return {};
  }

  Status step(const io::Points& frame, DynamicRun& run) {
    field_.move(frame);
    comm_.barrier();
    const double start = clock_.seconds();
    StepTimes times{};  // seconds, search, migrate, exchange, client
    const std::uint64_t drifted = field_.find_drift();
    sum({drifted, field_.leaving()});
    run.drifted += sums_[parts_];
    const double before = loads_.error;
    const bool balances = before >= tolerance_ && before > quota_error_;
    if (!balances && sums_[parts_ + 1] > 0) {  // else the new cuts' lists take them straight to their rank
      const double exchanging = clock_.seconds();
      if (Status status = field_.exchange_particles(); !status.ok()) return status;
      times[3] = clock_.seconds() - exchanging;
      run.migrated += sums_[parts_ + 1];
    }
    if (balances) {
      if (Status status = rebalance(&run, &times); !status.ok()) return status;
    }
    comm_.barrier();
    times[0] = times[4] = clock_.seconds() - start;
    run.add(times);
    run.arrival_mean += before;
    run.arrival_max = std::max(run.arrival_max, before);
    run.error_mean += loads_.error;
    run.error_max = std::max(run.error_max, loads_.error);
    return {};
  }

  double imbalance() const { return loads_.imbalance; }

 private:
  // The parts' counts and two numbers more over all ranks, in one reduction. Collective.
  void sum(std::array<std::uint64_t, 2> more) {
    field_.count(sums_);
    sums_.insert(sums_.end(), more.begin(), more.end());
    comm_.all_sum(sums_);
    loads_ = partition::summarise_counts({sums_.begin(), sums_.end() - 2}, {});
  }

  // run and times: null at the first partition. Collective.
  Status rebalance(DynamicRun* run, StepTimes* times) {
    const double searching = clock_.seconds();
    Status status = field_.balance();
    if (!comm::agree(comm_, status.ok())) return status;
    const double migrating = clock_.seconds();
    sum({field_.moved(), field_.exported_away()});
    status = field_.follow_lists();
    if (!comm::agree(comm_, status.ok())) return status;
    if (run == nullptr) return {};
    ++run->repartitions;
    run->moved += sums_[parts_];
    run->migrated += sums_[parts_ + 1];
    (*times)[1] = migrating - searching;
    (*times)[2] = clock_.seconds() - migrating;
    return {};
  }

  comm::Comm& comm_;
  const SteadyClock clock_;
  Field field_;
  std::size_t parts_;
  double tolerance_;
  double quota_error_;
  std::vector<std::uint64_t> sums_;
  partition::LoadSummary loads_;
};

}  // namespace

Result<DynamicRun> drive_zoltan(comm::Comm& comm, io::TrajectoryReader& reader, const Trajectory& trajectory, int parts,
                                double tolerance) {
  float version = 0;
  Zoltan_Initialize(0, nullptr, &version);
  Drive drive(comm, parts, tolerance, trajectory.points);
  DynamicRun run;
  Status status = drive.start(trajectory.points);
  double imbalance = 1;
  std::uint64_t frames = 0;
  for (;; ++frames) {
    auto frame = status.ok() ? reader.next() : Result<std::optional<io::Points>>(status);
    if (!comm::agree(comm, frame.ok())) return frame.status();
    if (!*frame) break;
    const std::uint64_t k = frames;
    status = k == 0 ? drive.first(**frame, run) : drive.step(**frame, run);
    if (k > 0) run.seconds_lost += trajectory.solver_seconds[k] / parts * (imbalance - 1);
    imbalance = drive.imbalance();
  }
  if (!comm::agree(comm, status.ok())) return status;
  if (frames > 1) {
    run.arrival_mean /= static_cast<double>(frames - 1);
    run.error_mean /= static_cast<double>(frames - 1);
  }
  return run;
}

}  // namespace rcb::bench
