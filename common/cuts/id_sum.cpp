#include "common/cuts/id_sum.hpp"

#include "common/base/cpu.hpp"
#include "common/base/random.hpp"

namespace rcb::cuts {
namespace {

// Compilers make vectors of this, as wide as the caller may use.
[[gnu::always_inline]] inline IdSums sum_all_ids(std::span<const particles::Id> ids, std::uint64_t key) {
  IdSums sums;
  particles::Id sign = 0;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const std::uint64_t mixed = mix64(static_cast<std::uint64_t>(ids[i]) + key);
    sums.any_order += mixed;
    sums.in_order += mixed * (i + 1);
    sign |= ids[i];
  }
  sums.negative = sign < 0;
  return sums;
}

#if defined(__x86_64__)
[[gnu::target(RCB_AVX2)]] IdSums sum_ids_avx2(std::span<const particles::Id> ids, std::uint64_t key) {
  return sum_all_ids(ids, key);
}
[[gnu::target(RCB_AVX512)]] IdSums sum_ids_avx512(std::span<const particles::Id> ids, std::uint64_t key) {
  return sum_all_ids(ids, key);
}
#endif

}  // namespace

IdSums sum_ids(std::span<const particles::Id> ids, std::uint64_t key) {
#if defined(__x86_64__)
  if (has_avx512()) return sum_ids_avx512(ids, key);
  if (has_avx2()) return sum_ids_avx2(ids, key);
#endif
  return sum_all_ids(ids, key);
}

}  // namespace rcb::cuts
