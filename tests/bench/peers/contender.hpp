// Contender: a partitioner with one setting, as the benchmark calls it. Ours and every peer stand behind the same
// calls, so what is timed is the same for all.
//
// Invariants
// 1. run() starts with the particles where they are, and ends with the part of every particle known on the rank that
//    holds it (`work: partition`), or with every particle on the rank that owns its part (`partition+migrate`).
// 2. Only run() is timed. Making the tool's objects, naming its parameters, copying particles that a migration will
//    consume and freeing results happen in prepare(), reset() and answer().
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "common/particles/particle_set.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::bench {

inline constexpr const char* kPartition = "partition";
inline constexpr const char* kPartitionMigrate = "partition+migrate";

struct Setting {
  std::string tool;    // rcbd, Zoltan, Zoltan2; floor
  std::string method;  // rcb, bands-x ...; RCB, RIB, HSFC, MJ; read
  std::string work;
  double cut_tolerance = 0;  // 0: exact, or as near as the tool comes
};

// This rank's share; it outlives the contenders that were given it.
struct Problem {
  particles::ParticleView particles;
  std::uint64_t n = 0;  // on all ranks together
  int parts = 1;
};

// What the last run said, as this rank knows it.
struct Answer {
  std::vector<std::int32_t> part;  // of each particle that this rank holds now
  // Ours alone.
  std::optional<std::uint64_t> hash;
  std::optional<partition::SearchCost> cost;  // of this rank
};

class Contender {
 public:
  explicit Contender(Setting setting) : setting_(std::move(setting)) {}
  virtual ~Contender() = default;
  Contender(const Contender&) = delete;
  Contender& operator=(const Contender&) = delete;
  const Setting& setting() const { return setting_; }

  // Once a problem, before the first run. Collective.
  virtual Status prepare(const Problem& problem) = 0;
  // Forgets the last run; before every run. Collective.
  virtual void reset() = 0;
  // The timed call. Collective. Errors: the tool's own; every rank may see another.
  virtual Status run() = 0;
  // Of the last run, which succeeded. Local.
  virtual Answer answer() = 0;
  // The part of each of the problem's particles by the tool's own question who owns a position, after the last run;
  // -1 where it has no answer. nullopt: it was not told to keep what that needs (Wish::owners). Local.
  virtual std::optional<std::vector<std::int32_t>> owners() = 0;

 private:
  Setting setting_;
};

// The floor: every rank reads each of its coordinates once, and no part comes of it.
inline constexpr const char* kFloor = "floor";
inline constexpr const char* kRead = "read";

using Contenders = std::vector<std::unique_ptr<Contender>>;

// Those of the methods asked for (by `method` names) that each tool has; tolerances: the cut tolerances to run, 0
// first. A tool or method that knows no tolerance runs once, with 0.
struct Wish {
  std::vector<std::string> methods;    // `method` names
  std::vector<double> cut_tolerances;  // 0 first
  bool migrate = false;
  bool owners = false;  // keep what the question for owners needs, at whatever cost in time

  bool has(const std::string& method) const;
};

void add_rcbd(comm::Comm& comm, const Wish& wish, Contenders& out);
void add_floor(const Wish& wish, Contenders& out);
#ifdef RCB_BENCH_ZOLTAN
void add_zoltan(const Wish& wish, Contenders& out);
#endif
#ifdef RCB_BENCH_ZOLTAN2
void add_zoltan2(const Wish& wish, Contenders& out);
#endif
// All of them that this build has.
Contenders make_contenders(comm::Comm& comm, const Wish& wish);

}  // namespace rcb::bench
