// OwnerPass: one pass over positions that tells the part of each. Rows that lie strictly inside the region of the part
// that is expected for them, the hint or the part of the row before, are decided by comparisons of vectors; others by
// the tree.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <span>

#include "common/base/index.hpp"
#include "common/base/status.hpp"
#include "common/cuts/classifier.hpp"
#include "common/cuts/positions.hpp"
#include "common/cuts/regions.hpp"
#include "common/particles/particle_set.hpp"

namespace rcb::cuts {

// What a snapshot of cuts keeps beside the tree.
struct OwnerTables {
  explicit OwnerTables(const CutTree& of)
      : tree(of), boxes(of.regions(0, of.parts)), regions(0, boxes), classifier(of) {}

  const CutTree& tree;
  std::vector<geometry::Box> boxes;
  Regions regions;
  Classifier classifier;
};

inline bool all_equal(const std::int32_t* part, std::size_t count) {
  return count == 0 || std::memcmp(part, part + 1, (count - 1) * sizeof *part) == 0;  // quicker than a loop
}

class OwnerPass {
 public:
  static constexpr std::size_t kWord = 64;  // rows that a word has a bit for

  OwnerPass(const OwnerTables& tables, const Positions& positions, std::span<const Id> ids,
            std::span<const std::int32_t> last_part)
      : tables_(tables), positions_(positions), ids_(ids), last_part_(last_part) {}

  // Sets part[i] to the part of row begin + i, for `count` rows, at most Batch::kMost. Errors: not_finite, naming the
  // row.
  Status read(std::size_t begin, std::size_t count, std::int32_t* part);

  // The same where rows are triples and nearly all lie where they are expected, without copies of them; else false, and
  // they are to be read.
  bool read_rows(std::size_t begin, std::size_t count, std::int32_t* part);

  // Of the rows that were read last: their coordinates by axis, and the part of all of them, or -1 if there are
  // several.
  particles::Axes x(std::size_t first) const { return {x_[0] + first, x_[1] + first, x_[2] + first}; }
  Point point(std::size_t i) const { return {x_[0][i], x_[1][i], x_[2][i]}; }
  std::int32_t uniform() const { return uniform_; }

 private:
  using Bits = std::array<std::uint64_t, Batch::kMost / kWord>;

  // Hints that were wrong for many rows, as those of rows in another order are, aren't looked at in so many batches.
  static constexpr int kUnhinted = 15;

  // Whether parts are expected: after rows of several parts without hints, there are none.
  bool hinted() const { return unhinted_ == 0 && (uniform_ >= 0 || !last_part_.empty()); }
  Id id(std::size_t row) const { return ids_.empty() ? static_cast<Id>(row) : ids_[row]; }
  template <typename T>
  bool read_triples(const T* rows, std::size_t begin, std::size_t count, std::int32_t* part);
  bool decide(std::size_t begin, const Bits& bits, std::int32_t* part) const;
  void settle(std::size_t count, const std::int32_t* part);
  std::int32_t expect(std::size_t begin, std::size_t count, std::int32_t* part);
  void load(std::size_t begin, std::size_t count);
  Bits outside(std::size_t count, const std::int32_t* part) const;
  Status check_finite(std::size_t begin, std::size_t count) const;

  const OwnerTables& tables_;
  const Positions& positions_;
  std::span<const Id> ids_;
  std::span<const std::int32_t> last_part_;
  Batch batch_;
  particles::Axes x_{};
  std::int32_t uniform_ = -1;
  int unhinted_ = 0;         // batches still to be read without hints
  std::int32_t before_ = 0;  // the part of the last row
};

}  // namespace rcb::cuts
