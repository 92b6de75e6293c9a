// HaloPass: one thread's share of a halo: the entries of its rows, in their order.
#pragma once

#include <map>
#include <vector>

#include "common/cuts/halo.hpp"
#include "common/cuts/halo_table.hpp"
#include "common/cuts/owner_pass.hpp"

namespace rcb::cuts {

struct HaloEntry {
  std::uint64_t row;
  std::int32_t target;
  std::int32_t image;

  bool operator==(const HaloEntry& other) const {
    return (row == other.row) & (target == other.target) & (image == other.image);
  }
};

class HaloPass {
 public:
  HaloPass(const OwnerTables& tables, const Reach& reach, const Positions& positions, const HaloOptions& options);

  // Errors: not_finite, invalid_argument (a width; too many images), too_large.
  Status run(std::size_t begin, std::size_t end);

  std::span<const HaloEntry> entries() const { return entries_.span().subspan(1, size_ - 1); }
  const Images& images() const { return images_; }
  // Entries of each target. [targets]
  const std::vector<std::uint64_t>& counts() const { return counts_; }

 private:
  static constexpr std::size_t kTablesMost = 16;
  static constexpr std::uint8_t kByReach = 64;  // in the place of Fence::faces(): there are no candidates for the row

  static constexpr std::size_t kPairs = 2048;
  static constexpr std::size_t kFours = HaloTable::kSpare;

  // A row of the batch, and a part that may need an image of it.
  struct Pair {
    Candidate one;
    std::uint32_t row;
  };

  std::size_t find_boundary(std::size_t count, HaloTable& table);
  std::uint8_t faces_of(const Fence& fence, const Point& x) const;
  Status add_batch(std::size_t begin, std::size_t count);
  // These return false where failure_ has been set, fail() always. i: in the batch.
  bool add_all(std::size_t count);
  bool add_each(std::size_t count);
  bool add_row(std::size_t i, HaloTable* table, std::uint8_t faces, double width);
  bool add_by_reach(std::size_t i, double width);
  bool test_pairs();
  bool reserve(std::size_t more) { return size_ + more < entries_.size() || grow(more); }
  bool grow(std::size_t more);
  bool fail(std::size_t i, const Status& status);
  HaloTable* table_for(double width);

  const Reach& reach_;
  const HaloOptions& options_;
  Targets targets_;
  OwnerPass owners_;
  Images images_;
  std::map<int, HaloTable> tables_;  // by the width's exponent
  bool periodic_;
  std::size_t begin_ = 0;  // of the batch
  Status failure_;
  std::array<std::int32_t, Batch::kMost> part_{};
  std::array<std::uint16_t, Batch::kMost> boundary_{};  // in the batch
  std::array<std::uint8_t, Batch::kMost> faces_{};      // of these
  std::array<Pair, kPairs> pairs_;                      // to be tested
  std::size_t pairs_count_ = 0;
  std::vector<Candidate> found_;
  Buffer<HaloEntry> entries_;  // the first one is no entry, and one more than are counted may be written
  std::size_t size_ = 1;
  std::vector<std::uint64_t> counts_;
};

}  // namespace rcb::cuts
