#include "common/partition/kernels/kernels.hpp"

#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "common/partition/kernels/kernels.cpp"
#include "common/base/highway.hpp"
// Behind Highway, which it needs.
#include "common/base/vectors-inl.hpp"

HWY_BEFORE_NAMESPACE();
namespace rcb::partition::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using rcb::HWY_NAMESPACE::any_lane, rcb::HWY_NAMESPACE::bits_of, rcb::HWY_NAMESPACE::look_up;

// Four values of particle i side by side, then those of particle i + 1, ...
template <typename D, typename V>
void store_side_by_side(D d, V x, V y, V z, V w, hn::TFromD<D>* to) {
  if constexpr (hn::MaxLanes(d) > 1) {
    StoreInterleaved4(x, y, z, w, d, to);
  } else {
    hn::StoreU(x, d, to);
    hn::StoreU(y, d, to + 1);
    hn::StoreU(z, d, to + 2);
    hn::StoreU(w, d, to + 3);
  }
}

template <typename V>
auto lies_outside(V x, V lo, V hi) {
  return hn::Or(hn::Lt(x, lo), hn::Gt(x, hi));
}

template <typename DF>
hn::Vec<DF> rounded(DF df, const RoundedAxes& axes, std::size_t axis, const double* x) {
  const hn::Repartition<double, DF> d;
  const hn::Half<DF> half;
  const auto origin = hn::Set(d, axes.origin[axis]);
  const auto scale = hn::Set(d, axes.scale[axis]);
  const auto low = hn::DemoteTo(half, hn::Mul(hn::Sub(hn::LoadU(d, x), origin), scale));
  const auto high = hn::DemoteTo(half, hn::Mul(hn::Sub(hn::LoadU(d, x + hn::Lanes(d)), origin), scale));
  return hn::Min(Combine(df, high, low), hn::Set(df, std::numeric_limits<float>::max()));
}

// A level of the way down for as many particles as a vector has floats.
template <std::size_t kLevel, typename DF, typename VU>
void step_down(DF df, const WalkTables& tables, const hn::Vec<DF>* own, VU& node, VU& found) {
  if constexpr (kLevel < Splitters::kLevels) {
    const hn::DFromV<VU> du;
    const LevelTable& table = tables.levels[kLevel];
    // A node's bit of a table's word becomes the sign bit.
    const auto up = hn::AndNot(node, hn::Set(du, std::uint32_t{LevelTable::kPlaces - 1}));
    const auto on_axis = [&](std::size_t axis)
                             HWY_ATTR { return hn::BitCast(df, hn::Shl(hn::Set(du, table.on[axis]), up)); };
    auto on = hn::IfNegativeThenElse(on_axis(1), own[1], own[0]);
    on = hn::IfNegativeThenElse(on_axis(2), own[2], on);
    const auto before = hn::Lt(on, look_up<std::size_t{1} << kLevel>(df, table.least.data(), node));
    const auto right = hn::Gt(on, look_up<std::size_t{1} << kLevel>(df, table.most.data(), node));
    found = hn::Min(found, hn::Or(node, hn::BitCast(du, hn::VecFromMask(df, hn::Or(before, right)))));
    node = hn::Sub(hn::Add(hn::Add(node, node), hn::Set(du, 1U)), hn::BitCast(du, hn::VecFromMask(df, right)));
    step_down<kLevel + 1>(df, tables, own, node, found);
  }
}

inline std::int32_t walk_one(const WalkTables& tables, const Axes& x, std::size_t i) {
  std::uint32_t node = 0;
  for (const LevelTable& table : tables.levels) {
    const std::size_t place = node % LevelTable::kPlaces;
    const std::size_t axis = (table.on[1] >> place & 1U) + 2 * (table.on[2] >> place & 1U);
    const float on = tables.rounded(axis, x[axis][i]);
    if (on >= table.least[place] && on <= table.most[place]) break;
    node = 2 * node + (on > table.most[place] ? 2 : 1);
  }
  return static_cast<std::int32_t>(node);
}

template <typename DF>
void walk_all(DF df, const WalkTables& tables, const Axes& x, std::int32_t* bucket) {
  if constexpr (hn::MaxLanes(df) < 8) {
    for (std::size_t i = 0; i < kBlock; ++i) bucket[i] = walk_one(tables, x, i);
  } else {
    const hn::RebindToUnsigned<DF> du;
    const hn::RebindToSigned<DF> di;
    for (std::size_t i = 0; i < kBlock; i += hn::Lanes(df)) {
      hn::Vec<DF> own[geometry::kDimsMax];
      for (std::size_t a = 0; a < x.size(); ++a) own[a] = rounded(df, tables.rounded, a, x[a] + i);
      auto node = hn::Zero(du);
      auto found = hn::Set(du, ~0U);
      step_down<0>(df, tables, own, node, found);
      hn::StoreU(hn::BitCast(di, hn::Min(found, node)), di, bucket + i);
    }
  }
}

void walk(const WalkTables& tables, const Axes& x, std::int32_t* bucket) {
  walk_all(hn::ScalableTag<float>(), tables, x, bucket);
}

std::uint64_t outside_own(const Axes& x, const std::int32_t* bucket, const Bounds* boxes) {
  const hn::CappedTag<double, 4> d;  // a particle is one vector of four lanes, or as many as it takes
  const hn::RebindToUnsigned<decltype(d)> du;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  HWY_ALIGN std::array<double, 4 * kLanes> point;
  // Bits are collected in lanes, since a step from a vector to a word for each particle would be slow.
  auto bit = hn::Set(du, std::uint64_t{1});
  auto outside = hn::Zero(du);
  for (std::size_t i = 0; i < kBlock; i += kLanes) {
    const auto z = hn::LoadU(d, x[2] + i);
    store_side_by_side(d, hn::LoadU(d, x[0] + i), hn::LoadU(d, x[1] + i), z, z, point.data());
    for (std::size_t k = 0; k < kLanes; ++k) {
      const Bounds& box = boxes[bucket[i + k]];
      for (std::size_t a = 0; a < 4; a += kLanes) {
        const auto out = lies_outside(hn::Load(d, point.data() + 4 * k + a), hn::Load(d, box.lo.data() + a),
                                      hn::Load(d, box.hi.data() + a));
        outside = hn::Or(outside, hn::IfThenElseZero(hn::RebindMask(du, out), bit));
      }
      bit = hn::Add(bit, bit);
    }
  }
  return any_lane(outside);
}

std::uint64_t outside(const Axes& x, const Bounds& box) {
  const hn::ScalableTag<double> d;
  std::uint64_t outside = 0;
  for (std::size_t i = 0; i < kBlock; i += hn::Lanes(d)) {
    auto out = lies_outside(hn::LoadU(d, x[0] + i), hn::Set(d, box.lo[0]), hn::Set(d, box.hi[0]));
    for (std::size_t a = 1; a < x.size(); ++a)
      out = hn::Or(out, lies_outside(hn::LoadU(d, x[a] + i), hn::Set(d, box.lo[a]), hn::Set(d, box.hi[a])));
    outside |= bits_of(d, out) << i;
  }
  return outside;
}

template <bool kCheck>
void quantise_all(const Axes& x, const std::uint32_t* index, const LinearMaps& maps, QuantisedPoint* points,
                  Lossless* lossless) {
  const hn::ScalableTag<double> d;
  const hn::RebindToSigned<decltype(d)> dw;
  const hn::Rebind<std::int32_t, decltype(d)> di;
  const auto half = hn::Set(d, 0.5);
  const auto top = hn::Set(d, double{LinearMaps::kTop});
  hn::Vec<decltype(dw)> differ[geometry::kDimsMax];
  hn::Vec<decltype(di)> bits[geometry::kDimsMax];
  for (std::size_t a = 0; a < x.size(); ++a) {
    differ[a] = hn::Zero(dw);
    bits[a] = hn::Zero(di);
  }
  for (std::size_t i = 0; i < kBlock; i += hn::Lanes(d)) {
    hn::Vec<decltype(di)> q[geometry::kDimsMax];
    for (std::size_t a = 0; a < x.size(); ++a) {
      const auto own = hn::LoadU(d, x[a] + i);
      const auto base = hn::Set(d, maps.base[a]);
      const auto scaled = hn::Mul(hn::Sub(hn::Mul(own, half), base), hn::Set(d, maps.scale[a]));
      q[a] = hn::DemoteTo(di, hn::Min(hn::Max(scaled, hn::Zero(d)), top));
      if constexpr (kCheck) {
        const auto again = hn::Add(base, hn::Mul(hn::PromoteTo(d, q[a]), hn::Set(d, maps.step[a])));
        differ[a] = hn::Or(differ[a], hn::BitCast(dw, hn::Sub(hn::Add(again, again), own)));
        bits[a] = hn::Or(bits[a], q[a]);
      }
    }
    const auto own_index = hn::LoadU(di, reinterpret_cast<const std::int32_t*>(index + i));
    store_side_by_side(di, q[0], q[1], q[2], own_index, reinterpret_cast<std::int32_t*>(points + i));
  }
  for (std::size_t a = 0; kCheck && a < x.size(); ++a) {
    HWY_ALIGN std::array<std::int64_t, hn::MaxLanes(d)> differs;
    HWY_ALIGN std::array<std::int32_t, hn::MaxLanes(d)> set;
    hn::Store(differ[a], dw, differs.data());
    hn::Store(bits[a], di, set.data());
    for (const std::int64_t lane : differs) lossless->differ[a] |= lane;
    for (const std::int32_t lane : set) lossless->bits[a] |= lane;
  }
}

void quantise(const Axes& x, const std::uint32_t* index, const LinearMaps& maps, QuantisedPoint* points,
              Lossless* lossless) {
  (lossless == nullptr ? quantise_all<false> : quantise_all<true>)(x, index, maps, points, lossless);
}

void widen(QBounds& bounds, std::span<const QuantisedPoint> points) {
  const hn::CappedTag<std::int32_t, 4> d;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  HWY_ALIGN std::array<std::int32_t, 4> least{bounds.lo[0], bounds.lo[1], bounds.lo[2]};
  HWY_ALIGN std::array<std::int32_t, 4> most{bounds.hi[0], bounds.hi[1], bounds.hi[2]};
  for (std::size_t a = 0; a < least.size(); a += kLanes) {
    // Two each, since every minimum depends on the one before it.
    auto lo = hn::Load(d, least.data() + a);
    auto hi = hn::Load(d, most.data() + a);
    auto other_lo = lo;
    auto other_hi = hi;
    for (std::size_t i = 0; i < points.size(); i += 2) {
      const auto own = hn::Load(d, points[i].q.data() + a);
      const auto other = hn::Load(d, points[std::min(i + 1, points.size() - 1)].q.data() + a);
      lo = hn::Min(lo, own);
      hi = hn::Max(hi, own);
      other_lo = hn::Min(other_lo, other);
      other_hi = hn::Max(other_hi, other);
    }
    hn::Store(hn::Min(lo, other_lo), d, least.data() + a);
    hn::Store(hn::Max(hi, other_hi), d, most.data() + a);
  }
  std::copy_n(least.begin(), bounds.lo.size(), bounds.lo.begin());
  std::copy_n(most.begin(), bounds.hi.size(), bounds.hi.begin());
}

constexpr Kernels kKernels{walk, outside_own, outside, quantise, widen};

}  // namespace rcb::partition::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace rcb::partition {

WalkTables::WalkTables(const Splitters& splitters) : rounded(splitters.rounded) {
  for (std::size_t level = 0; level < levels.size(); ++level)
    for (std::size_t place = 0; place < LevelTable::kPlaces; ++place) {
      const std::size_t count = std::size_t{1} << level;
      const Splitters::Node& node = splitters.nodes[count - 1 + (place + 1) % count];
      const auto axis = static_cast<std::size_t>(node.axis);
      const auto end = [&](double x) { return std::isinf(x) ? static_cast<float>(x) : rounded(axis, x); };
      levels[level].least[place] = end(node.least);
      levels[level].most[place] = end(node.most);
      levels[level].on[axis] |= std::uint32_t{1} << place;
    }
}

const Kernels& kernels(InstructionSet set) { return RCB_OF_INSTRUCTION_SET(kKernels, set); }

}  // namespace rcb::partition
#endif
