// 128-bit integers, for sums of loads and products of counts.
#pragma once

namespace rcb {
__extension__ using u128 = unsigned __int128;
__extension__ using i128 = __int128;
}  // namespace rcb
