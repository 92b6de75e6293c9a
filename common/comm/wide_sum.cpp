#include "common/comm/wide_sum.hpp"

#include <algorithm>
#include <vector>

namespace rcb::comm {

void all_sum_wide(Comm& comm, std::span<u128> values) {
  std::vector<std::uint64_t> limbs(values.size() * kLimbs);
  for (std::size_t i = 0; i < values.size(); ++i)
    std::ranges::copy(limbs_of(values[i]), limbs.begin() + static_cast<std::ptrdiff_t>(i * kLimbs));
  comm.all_sum(limbs);
  for (std::size_t i = 0; i < values.size(); ++i)
    values[i] = value_of_limbs(std::span<const std::uint64_t, kLimbs>(limbs.data() + i * kLimbs, kLimbs));
}

}  // namespace rcb::comm
