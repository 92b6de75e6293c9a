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
};

class HaloPass {
 public:
  HaloPass(const OwnerTables& tables, const Reach& reach, const Positions& positions, const HaloOptions& options);

  // Errors: not_finite, invalid_argument (a width; too many images), too_large.
  Status run(std::size_t begin, std::size_t end);

  std::span<const HaloEntry> entries() const { return entries_.span().first(size_); }
  const Images& images() const { return images_; }
  // Entries of each target. [targets]
  const std::vector<std::uint64_t>& counts() const { return counts_; }

 private:
  static constexpr std::size_t kTablesMost = 16;

  Status add_batch(std::size_t begin, std::size_t count);
  Status add_row(std::size_t begin, std::size_t i);
  // The same, with the particle's name.
  Status about(std::uint64_t row, const Status& status) const;
  Status reserve(std::size_t more);
  Status add_by_reach(std::uint64_t row, const Point& x, std::int32_t part, double width);
  HaloTable* table_for(double width);
  void append(std::uint64_t row, const Candidate& found, std::size_t first);

  const Reach& reach_;
  const HaloOptions& options_;
  Targets targets_;
  OwnerPass owners_;
  Images images_;
  std::map<int, HaloTable> tables_;  // by the width's exponent
  Within within_;
  std::array<std::int32_t, Batch::kMost> part_{};
  std::vector<Candidate> found_;
  Buffer<HaloEntry> entries_;
  std::size_t size_ = 0;
  std::vector<std::uint64_t> counts_;
};

}  // namespace rcb::cuts
