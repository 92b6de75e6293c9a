// A model of what a ledger is told of: particles that drift, and ranks that are pushed to.
#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <memory>
#include <utility>

#include "common/base/random.hpp"
#include "common/partition/partition.hpp"
#include "common/partition/repartition.hpp"
#include "server/scene/events.hpp"
#include "server/scene/policy.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::testing {

using particles::ParticleSet;

inline bool chance(Random& random, std::uint64_t one_in) { return random.below(one_in) == 0; }

template <typename T>
T one_of(Random& random, std::initializer_list<T> values) {
  return values.begin()[random.below(values.size())];
}

// Rows, of those that both have, with different parts.
inline std::uint64_t differences(const Buffer<std::int32_t>& a, const Buffer<std::int32_t>& b) {
  std::uint64_t count = 0;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) count += static_cast<std::uint64_t>(a[i] != b[i]);
  return count;
}

inline scene::SceneOptions random_options(Random& random, int dims) {
  scene::SceneOptions options;
  options.dims = dims;
  options.parts = 1 + static_cast<int>(random.below(12));
  if (chance(random, 4)) options.method = cuts::Method::bands_x;
  options.tolerance = one_of(random, {0.0, 0.05, 0.1, 0.3, 0.6, std::numeric_limits<double>::infinity()});
  options.cut_tolerance = one_of(random, {0.0, 0.0, 0.05});
  options.policy = one_of(random, {scene::Policy::tolerance, scene::Policy::cost});
  if (chance(random, 3))
    for (int p = 0; p < options.parts; ++p) options.part_sizes.push_back(random.uniform(0.2, 3));
  return options;
}

// Particles that drift, of which some go and others come.
struct World {
  explicit World(Random& random) : dims(1 + static_cast<int>(random.below(3))) {
    set.dims = dims;
    set.has_weights = chance(random, 2);
    speed = one_of(random, {0.0, 0.002, 0.02, 0.2});
    grid = chance(random, 4) ? 8 : 0;
    next_id = chance(random, 2) ? 0 : static_cast<particles::Id>(random.below(1000));
    resize(random, chance(random, 6) ? random.below(4) : 20 + random.below(100));
    weigh(random);
  }
  void resize(Random& random, std::size_t count) {
    const std::size_t before = set.count();
    set.resize(count);
    for (std::size_t i = before; i < count; ++i) {
      for (int a = 0; a < dims; ++a) set.position[static_cast<std::size_t>(a)][i] = random.uniform();
      set.id[i] = next_id++;
      if (set.has_weights) set.weight[i] = 1;
    }
  }
  void exchange(Random& random) {
    const auto go = one_of<std::uint64_t>(random, {1, 2, 20, 1000});
    const auto come = one_of<std::uint64_t>(random, {1, 2, 10, 100});
    std::size_t kept = 0;
    for (std::size_t i = 0; i < set.count(); ++i) {
      if (chance(random, go)) continue;
      for (auto* axis = set.position.data(); axis != set.position.data() + dims; ++axis) (*axis)[kept] = (*axis)[i];
      if (set.has_weights) set.weight[kept] = set.weight[i];
      set.id[kept++] = set.id[i];
    }
    set.resize(kept);
    resize(random, kept + random.below(come));
  }
  void weigh(Random& random) {
    const std::uint64_t kind = random.below(5);
    for (double& weight : set.weight)
      weight = kind == 0   ? 2.5
               : kind == 1 ? 0
               : kind == 2 ? static_cast<double>(random.below(4))
               : kind == 3 ? std::ldexp(random.uniform(), static_cast<int>(random.below(240)) - 200)
                           : random.uniform(0.5, 1.5);
  }
  void move(Random& random) {
    if (chance(random, 5)) weigh(random);
    if (chance(random, 6))
      for (double& weight : set.weight) weight *= 1024;
    for (int a = 0; a < dims; ++a)
      for (double& x : set.position[static_cast<std::size_t>(a)]) {
        x += speed * (0.3 * x + random.uniform(-1, 1));
        if (grid > 0) x = std::round(x * grid) / grid;
      }
  }

  int dims;
  ParticleSet set;
  double speed = 0;
  double grid = 0;  // positions on it have equal coordinates
  particles::Id next_id = 0;
};

// The ranks of a service, as one that holds all particles: what they do with a push.
class Ranks {
 public:
  explicit Ranks(scene::SceneOptions options) : options_(std::move(options)) {}

  const cuts::CutTree& tree() const { return tree_; }
  scene::Held held() const {
    scene::Held held;
    held.n = particles_.count();
    held.weights = particles_.has_weights;
    held.ids = held.n > 0 && particles_.id[0] != 0;
    held.epoch = epoch_;
    held.id_sum = 0;
    for (const particles::Id id : particles_.id) *held.id_sum += mix64(static_cast<std::uint64_t>(id));
    if (epoch_ == 0) return held;
    held.hash = tree_.hash();
    held.tree = std::make_shared<const cuts::CutTree>(tree_);
    held.search_rounds = 3 * epoch_;
    held.search_reductions = 2 * epoch_;
    held.loads = std::make_shared<const partition::LoadSummary>(loads_);
    return held;
  }

  scene::Stepped push(const ParticleSet& particles, std::int64_t step, const scene::DecisionTerms& terms) {
    scene::Stepped stepped;
    scene::StepReport& report = stepped.report;
    report.scene = "jet";
    report.step = step;
    report.positions_step = step;
    report.way = scene::Way::sockets;
    report.seconds.search = 0.01 * static_cast<double>(1 + step % 5);
    report.seconds.migrate = 0.005 * static_cast<double>(step % 3);
    if (epoch_ == 0) {
      particles_ = particles;
      report.repartitioned = true;
      report.reason = "first positions";
      partition_all();
    } else {
      stepped.wasted = later(particles, terms, report);
    }
    report.n = particles.count();
    report.parts = options_.parts;
    report.epoch = epoch_;
    report.error = loads_.error;
    report.imbalance = loads_.imbalance;
    report.weights_as_zero = loads_.weights_as_zero;
    stepped.held = held();
    return stepped;
  }

  scene::Rebalanced rebalance(scene::SceneOptions options) {
    options_ = std::move(options);
    partition_all();
    return {options_, held()};
  }

 private:
  partition::PartitionOptions search_options() const {
    partition::PartitionOptions search;
    search.method = options_.method;
    search.parts = options_.parts;
    search.part_sizes = options_.part_sizes;
    search.cut_tolerance = options_.cut_tolerance;
    return search;
  }
  partition::LoadSummary loads_of_parts() {
    return partition::summarise_loads(comm_, particles_.view(), part_.span(), options_.part_sizes, options_.parts);
  }
  void partition_all() {
    auto found = partition::partition(comm_, particles_.view(), search_options());
    tree_ = std::move(found->tree);
    part_ = std::move(found->part);
    loads_ = loads_of_parts();
    ++epoch_;
  }
  // Returns whether new cuts were searched in vain.
  bool later(const ParticleSet& particles, const scene::DecisionTerms& terms, scene::StepReport& report) {
    const std::size_t before = std::exchange(particles_, particles).count();
    const std::size_t count = particles.count();
    Buffer<std::int32_t> part(count);
    tree_.classify(particles_.view(), part.span());
    report.drifted = differences(part, part_);
    part_ = std::move(part);
    loads_ = loads_of_parts();
    report.error_before = loads_.error;
    const scene::Decision decision = before == 0 && count > 0
                                         ? scene::Decision{true, "the scene had no particles before"}
                                         : decide_step(options_, loads_, terms);
    report.reason = decision.reason;
    if (!decision.search) return false;
    partition::RepartitionOptions options{search_options(), true, {}};
    options.partition.axis_hysteresis = options_.axis_hysteresis;
    options.partition.previous = &tree_;
    auto found = partition::repartition(comm_, particles_.view(), options, {tree_, part_.span(), loads_, nullptr});
    if (may_be_wasted(options_, loads_) && !(found.loads.error < loads_.error)) {
      report.reason = reason_not_adopted(decision, found.loads.error);
      return true;
    }
    report.repartitioned = true;
    report.reason = reason_adopted(decision, found.loads.error);
    report.axes_flipped = cuts::axes_flipped(tree_, found.tree);
    report.moved = found.delta.slot.size();
    for (std::size_t k = 0; k < found.delta.slot.size(); ++k) part_[found.delta.slot[k]] = found.delta.part[k];
    tree_ = std::move(found.tree);
    loads_ = std::move(found.loads);
    ++epoch_;
    return false;
  }

  SelfComm comm_;
  scene::SceneOptions options_;
  ParticleSet particles_;
  Buffer<std::int32_t> part_;
  cuts::CutTree tree_;
  partition::LoadSummary loads_;
  std::uint64_t epoch_ = 0;
};

}  // namespace rcb::testing
