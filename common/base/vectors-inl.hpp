// What kernels have in common. As for Highway's own such headers, there is a copy for each instruction set.
#if defined(RCB_VECTORS_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef RCB_VECTORS_INL
#undef RCB_VECTORS_INL
#else
#define RCB_VECTORS_INL
#endif

#include <array>
#include <bit>
#include <cstdint>

HWY_BEFORE_NAMESPACE();
namespace rcb::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// A bit for each lane, of at most eight.
template <typename D, typename M>
std::uint64_t bits_of(D d, M mask) {
  std::uint8_t bits = 0;
  hn::StoreMaskBits(d, mask, &bits);
  return bits;
}
// The bits of the first lanes together.
template <std::size_t kLanes = 64, typename V>
std::uint64_t any_lane(V bits) {
  const hn::DFromV<V> d;
  HWY_ALIGN std::array<std::uint64_t, hn::MaxLanes(d)> lanes;
  hn::Store(bits, d, lanes.data());
  std::uint64_t all = 0;
  for (std::size_t k = 0; k < std::min(kLanes, lanes.size()); ++k) all |= lanes[k];
  return all;
}

// Looks places up, by their low bits, in a table of kPlaces values, or of as many as a vector has if that is more.
// kPlaces: a power of two.
template <std::size_t kPlaces, typename D, typename VI>
hn::Vec<D> look_up(D d, const hn::TFromD<D>* table, VI place) {
  using I = hn::TFromV<VI>;
  constexpr std::size_t kLanes = hn::MaxLanes(d);
  if constexpr (kPlaces <= kLanes) {
    const auto within = hn::And(place, hn::Set(hn::DFromV<VI>(), static_cast<I>(kLanes - 1)));
    return TableLookupLanes(hn::LoadU(d, table), IndicesFromVec(d, within));
  } else {
    constexpr int kUp = 8 * int{sizeof(I)} - std::bit_width(kPlaces / 2);
    return hn::IfNegativeThenElse(hn::BitCast(d, hn::ShiftLeft<kUp>(place)),
                                  look_up<kPlaces / 2>(d, table + kPlaces / 2, place),
                                  look_up<kPlaces / 2>(d, table, place));
  }
}

}  // namespace rcb::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
