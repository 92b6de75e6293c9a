// Arrival: the pass over a slice's positions while they arrive, so that they are read in the cache and, when the step
// is ordered, only the blocks of particles that showed something are looked at again, by it or by a repartition.
//
// Invariants
// 1. Parts and regions of a scene are read between lend() and take_back() alone, under the loan's lock, a piece of the
//    slice at a time. Both are called on the engine thread, which takes back before it changes anything: whatever the
//    sockets do meanwhile, nothing is read while it changes.
// 2. What an arrival tells holds for the loan it was begun with. Another one, a piece that is missing or out of order,
//    or one that came after the loan was taken back: it tells nothing, and the whole slice is looked at.
// 3. Ranges are known of blocks whose particles are all of one part; of others they are everything.
// 4. A block that isn't marked holds particles strictly inside their parts' regions, hence finite (scan.hpp).
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "common/particles/block_ranges.hpp"
#include "server/service/scene.hpp"

namespace rcb::service {

// What is lent of one scene, until it is taken back.
struct Loan {
  std::mutex mutex;  // of `part` and `regions`
  bool lent = true;
  std::span<const std::int32_t> part;  // by slot
  const Regions* regions = nullptr;    // the scene's
  int dims = 3;
};

// One slice. It is filled on one thread and then handed over.
class Arrival {
 public:
  explicit Arrival(std::shared_ptr<Loan> loan);

  // The values of an axis from slot `first` on. Each axis in ascending slots.
  void add(std::size_t axis, std::uint64_t first, std::span<const double> values);
  // Whether it tells anything of this loan. If so,
  bool holds(const Loan* loan) const;
  // a byte for each block, not 0 where a particle may be outside its region,
  std::span<const std::uint8_t> marks() const { return marks_; }
  // and where the blocks are.
  const particles::BlockRanges& ranges() const { return ranges_; }

 private:
  static constexpr std::int32_t kUnknown = -2;
  static constexpr std::int32_t kMixed = -1;

  std::int32_t part_of_block(std::size_t block);
  // Of the values that are the block's.
  bool any_outside(std::size_t axis, std::size_t block, std::uint64_t first, std::span<const double> values);

  std::shared_ptr<Loan> loan_;
  std::uint64_t count_ = 0;
  std::array<std::uint64_t, 3> seen_{};  // particles, by axis
  bool whole_ = true;                    // so far
  std::vector<std::uint8_t> marks_;
  particles::BlockRanges ranges_;
  std::vector<std::int32_t> block_part_;  // where all have the same
};

// What the scenes have lent.
class Loans {
 public:
  // Engine thread. The scene's parts and regions stay as they are until take_back(). Instead of what it lent before.
  void lend(const Scene& scene);
  // Engine thread. The loan, which names what an arrival was held against; null: there was none.
  std::shared_ptr<const Loan> take_back(const std::string& scene);
  void take_back_all();
  // Any thread. Null where nothing is lent, or a slice of this form isn't one of the scene's.
  std::shared_ptr<Arrival> begin(const std::string& scene, int dims, std::uint64_t count);

 private:
  std::mutex mutex_;
  std::map<std::string, std::shared_ptr<Loan>> loans_;
};

}  // namespace rcb::service
