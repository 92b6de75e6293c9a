// Room `buckets`: one pass over the particles, before any cut is known, puts each into a bucket, as in sample sort
// (Frazer and McKellar, J. ACM 17, 1970, doi:10.1145/321592.321600). Splitters tell where cuts are expected: a particle
// that may lie on either side of one is in a bucket of that node; all others are in buckets of the parts that they are
// expected to end in. Such a bucket is treated as a whole, by its load and its box, until a cut meets the box.
//
// Invariants
// 1. What bucket a particle is in changes the time of a search, and no answer.
// 2. Boxes are exact: a particle lies on each face.
#pragma once

#include <cstdint>
#include <vector>

#include "common/comm/comm.hpp"
#include "common/partition/balance/load.hpp"
#include "common/partition/points/point_store.hpp"
#include "common/partition/rules/request.hpp"

namespace rcb::partition {

// The particles of all ranks in a bucket; the same on each rank. Buckets are numbered by the splitters' nodes and
// leaves; where cuts are in force, a bucket for each part comes behind these, with the particles that are expected to
// stay in it.
struct Bucket {
  int first = 0;  // the parts [first, last) that its particles are expected in; none: there is no such bucket
  int last = 0;
  bool has_points = false;  // its particles have quantised points
  Load load;
  geometry::Box box;
  QBounds q;  // of the box

  bool exists() const { return first < last; }
  bool empty() const { return box.lo[0] > box.hi[0]; }
};

// Without loads and boxes. Local.
//   split  there are splitters; else all particles are in bucket 0
//   held   a bucket for each part, too
std::vector<Bucket> empty_buckets(int parts, bool split, bool held);

// What one rank's pass has found.
struct OwnShare {
  explicit OwnShare(std::size_t buckets, int dims);
  // Makes the boxes hold those particles of a block whose bits are set.
  void grow(const Axes& x, const std::int32_t* bucket, std::uint64_t which);

  int dims;
  std::vector<Bounds> boxes;  // [buckets]
  std::vector<Load> loads;    // [buckets]
  // Where cuts are in force, of the particles that aren't expected to stay: [parts]; then, as a count, whether the pass
  // was given up.
  std::vector<Load> leaving;
  Lossless lossless;
};

// A bound of no particle.
Bounds no_bounds(int dims);

// Sets the loads of the splitters' buckets; returns the sum of `leaving` over all ranks. Collective (one sum; with
// weights two).
std::vector<Load> sum_loads(comm::Comm& comm, const OwnShare& own, bool weighted, std::span<Bucket> buckets,
                            SearchCost& cost);

// Sets the boxes of the buckets. Collective (one minimum).
void reduce_boxes(comm::Comm& comm, const OwnShare& own, std::span<Bucket> buckets, SearchCost& cost);

// Once the boxes are known: their integers, and the maps' ranges. Local.
void note_boxes(std::span<Bucket> buckets, AxisMaps& maps, int dims);

// Maps by value that are lossless stay so if they are for the points that a pass has made on every rank. Collective
// (one minimum).
void reduce_lossless(comm::Comm& comm, const Lossless& own, AxisMaps& maps, int dims, SearchCost& cost);

}  // namespace rcb::partition
