#include "common/partition/buckets/buckets.hpp"

#include <bit>

#include "common/base/index.hpp"
#include "common/comm/wide_sum.hpp"
#include "common/partition/balance/bounds.hpp"

namespace rcb::partition {
namespace {

// A node of the splitters that is a leaf of the tree sends all its particles left.
void lay_out(std::vector<Bucket>& buckets, std::size_t heap, const NodeRange& range) {
  if (heap >= Splitters::kNodes || !range.leaf()) {
    buckets[heap].first = range.first;
    buckets[heap].last = range.last;
    buckets[heap].has_points = true;
  }
  if (heap >= Splitters::kNodes) return;
  lay_out(buckets, 2 * heap + 1, range.leaf() ? range : range.left());
  if (!range.leaf()) lay_out(buckets, 2 * heap + 2, range.right());
}

}  // namespace

std::vector<Bucket> empty_buckets(int parts, bool split, bool held) {
  std::vector<Bucket> buckets(Splitters::kBuckets + (held ? at(parts) : 0));
  if (split)
    lay_out(buckets, 0, {0, 0, parts});
  else
    buckets[0] = {.last = parts, .has_points = true};
  for (int p = 0; p < parts && held; ++p) {
    Bucket& own = buckets[Splitters::kBuckets + at(p)];
    own.first = p;
    own.last = p + 1;
  }
  return buckets;
}

Bounds no_bounds(int dims) { return Bounds::of(geometry::Box{}, dims); }

OwnShare::OwnShare(std::size_t buckets, int dimensions)
    : dims(dimensions), boxes(buckets, no_bounds(dimensions)), loads(buckets) {}

void OwnShare::grow(const Axes& x, const std::int32_t* bucket, std::uint64_t which) {
  for (; which != 0; which &= which - 1) {
    const std::size_t i = at(std::countr_zero(which));
    boxes[at(bucket[i])].extend(at(dims), [&](std::size_t a) { return particles::Range{x[a][i], x[a][i]}; });
  }
}

std::vector<Load> sum_loads(comm::Comm& comm, const OwnShare& own, bool weighted, std::span<Bucket> buckets,
                            SearchCost& cost) {
  const std::span<Bucket> of_splitters = buckets.first(Splitters::kBuckets);
  std::vector<std::uint64_t> counts;
  std::vector<u128> weights;
  const auto send = [&](const Load& load) {
    counts.push_back(load.count);
    if (weighted) weights.push_back(load.weight);
  };
  for (std::size_t b = 0; b < of_splitters.size(); ++b) send(own.loads[b]);
  for (const Load& load : own.leaving) send(load);
  comm.all_sum(counts);
  if (weighted) comm::all_sum_wide(comm, weights);
  cost.reductions += weighted ? 2 : 1;
  std::size_t next = 0;
  const auto receive = [&] {
    const u128 weight = weighted ? weights[next] : 0;
    return Load{counts[next++], weight};
  };
  for (Bucket& bucket : of_splitters) cost.searched += (bucket.load = receive()).count;
  std::vector<Load> leaving(own.leaving.size());
  for (Load& load : leaving) load = receive();
  return leaving;
}

void reduce_boxes(comm::Comm& comm, const OwnShare& own, std::span<Bucket> buckets, SearchCost& cost) {
  AllMinMax all;
  for (std::size_t b = 0; b < buckets.size(); ++b)
    if (buckets[b].exists()) all.add(own.boxes[b].box(own.dims), own.dims);
  cost.reductions += all.reduce(comm);
  for (Bucket& bucket : buckets)
    if (bucket.exists()) all.take(bucket.box, own.dims);
}

void note_boxes(std::span<Bucket> buckets, AxisMaps& maps, int dims) {
  geometry::Box all;
  for (const Bucket& bucket : buckets) all.extend(bucket.box);
  for (std::size_t a = 0; a < at(dims) && !all.empty(dims); ++a) {
    maps[a].set_range(all.lo[a], all.hi[a]);
    for (Bucket& bucket : buckets) {
      if (bucket.empty()) continue;
      bucket.q.lo[a] = maps[a](bucket.box.lo[a]);
      bucket.q.hi[a] = maps[a](bucket.box.hi[a]);
    }
  }
}

void reduce_lossless(comm::Comm& comm, const Lossless& own, AxisMaps& maps, int dims, SearchCost& cost) {
  if (!may_be_lossless(maps, dims)) return;
  // 1 + the trailing zeros; 0 if the axis is not lossless.
  std::array<std::uint64_t, geometry::kDimsMax> words{};
  for (std::size_t a = 0; a < at(dims); ++a)
    if (maps[a].lossless())
      words[a] = std::min(static_cast<std::uint64_t>(own.zeros(a) + 1), std::uint64_t{maps[a].zeros()} + 1);
  comm.all_min(words);
  ++cost.reductions;
  for (std::size_t a = 0; a < at(dims); ++a)
    words[a] == 0 ? maps[a].set_lossy() : maps[a].set_lossless(static_cast<unsigned>(words[a] - 1));
}

}  // namespace rcb::partition
