// Records: what the search reads and moves instead of the particles themselves: 16 bytes each, the coordinates as
// 31-bit integers and the particle's number. The records of a tree node lie side by side, so that a level of the tree
// is a few plain passes over memory, and the particles stay where they are.
//
// Invariants
// 1. A coordinate's integer rises with it: q(a) < q(b) implies a < b. Equal integers decide nothing: the particles do.
// 2. The map from coordinates to integers is the same on every rank.
// 3. Records come in chunks, since a particle's number in its chunk has 32 bits.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/partition/key.hpp"

namespace rcb::partition {

struct alignas(16) Record {
  std::array<std::int32_t, geometry::kDimsMax> q{};
  std::uint32_t index = 0;
};

// A node's records in one chunk. What lies before `middle` is known to go left, what lies from `upper` on to go right.
struct Span {
  Record* first = nullptr;
  Record* middle = nullptr;
  Record* upper = nullptr;
  Record* last = nullptr;
  // Whose integers on the cut axis stand for another key word for now.
  Record* keyed = nullptr;
  Record* keyed_last = nullptr;
  std::uint64_t base = 0;  // the chunk's first particle

  std::size_t size() const { return static_cast<std::size_t>(last - first); }
  std::span<Record> all() const { return {first, last}; }
  std::span<Record> open() const { return {middle, upper}; }
};

// By how many bits 0..span must be shifted to fit in `bits`.
constexpr unsigned shift_to(std::uint64_t span, unsigned bits) {
  const auto width = static_cast<unsigned>(std::bit_width(span));
  return width > bits ? width - bits : 0;
}

// Coordinates as integers in [0, kTop], in steps of equal length or, where those would put too many particles into one,
// in steps of the image.
class AxisMap {
 public:
  static constexpr std::int32_t kTop = 0x7FFFFFFE;

  AxisMap() = default;
  // By value, in steps of a power of two, where that can be (the range is neither a point nor tiny), else by image.
  // lo <= hi, finite.
  static AxisMap by_value(double lo, double hi);
  static AxisMap by_image(double lo, double hi);
  static AxisMap of_ids(Id lo, Id hi);

  bool even() const { return scale_ > 0; }
  double half_base() const { return half_base_; }
  double scale() const { return scale_; }

  std::int32_t operator()(double value) const {
    return even() ? static_cast<std::int32_t>((value * 0.5 - half_base_) * scale_) : of_word(geometry::image(value));
  }
  std::int32_t operator()(Id id) const { return of_word(static_cast<std::uint64_t>(id)); }

  // Whether an integer tells the coordinate: known of images in single steps; of values it may be found to hold for a
  // set (lattices, few digits).
  bool exact() const { return exact_; }
  // It does, and all integers are multiples of 2^zeros.
  void set_exact(unsigned zeros) {
    exact_ = true;
    zeros_ = zeros;
  }
  unsigned zeros() const { return zeros_; }
  // The coordinate, if the integer tells it.
  double value(std::int32_t q) const {
    return even() ? 2 * (half_base_ + q / scale_)
                  : geometry::value_of_image(lo_ + (static_cast<std::uint64_t>(q) << shift_));
  }
  // Every coordinate whose integer is q lies in [least(q), most(q)].
  double least(std::int32_t q) const;
  double most(std::int32_t q) const;
  // The least double whose integer is at least q.
  double first_value(std::int32_t q) const;

 private:
  std::int32_t of_word(std::uint64_t word) const { return static_cast<std::int32_t>((word - lo_) >> shift_); }

  double half_base_ = 0;
  double scale_ = 0;
  std::uint64_t lo_ = 0;  // images, or ids
  std::uint64_t hi_ = 0;
  unsigned shift_ = 0;
  bool exact_ = false;
  unsigned zeros_ = 0;
};

using AxisMaps = std::array<AxisMap, geometry::kDimsMax>;

// Bounds of records' integers; lo > hi: no record.
struct QBounds {
  static constexpr std::int32_t kNone = 0x7FFFFFFF;
  std::array<std::int32_t, geometry::kDimsMax> lo{kNone, kNone, kNone};
  std::array<std::int32_t, geometry::kDimsMax> hi{-1, -1, -1};

  bool empty() const { return lo[0] > hi[0]; }
};

class Records {
 public:
  // One record a particle. axes: 0 makes records of the ids alone. Returns zeros_of_told of every axis where `tell`
  // asks for any (all maps are by value then), found in the same pass; else -1. Local.
  std::array<int, geometry::kDimsMax> build(const particles::ParticleView& particles, int axes, const AxisMaps& maps,
                                            std::size_t chunk_max, bool tell);

  std::size_t chunks() const { return chunks_.size(); }
  // Everything, one span a chunk.
  std::vector<Span> spans();
  // Turns the records into the parts of their particles. ends[chunk * parts + p]: where the records of part p end.
  // Memory stays within that of the records.
  Buffer<std::int32_t> into_parts(std::span<const std::size_t> ends, int parts);

 private:
  std::vector<Buffer<Record>> chunks_;
};

// If the integers of a map by value tell each coordinate: the trailing zero bits that all integers have; else -1.
// Local.
int zeros_of_told(const AxisMap& map, std::span<const double> x);

// Passes over records.

// Moves those below `at` on an axis to the front; returns where the others begin.
Record* split(std::span<Record> records, std::size_t axis, std::int32_t at);
// Moves those up to `at` (few, as a rule) to the front; returns where the others begin.
Record* split_few(std::span<Record> records, std::size_t axis, std::int32_t at);
// Adds one to bins[(q - lo) >> shift] for each; q in [lo, lo + (bins << shift)).
void count_bins(std::span<const Record> records, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint32_t> bins);
void widen(QBounds& bounds, std::span<const Record> records);

}  // namespace rcb::partition
