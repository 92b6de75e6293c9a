// 128-bit integers for sums of loads and products of counts.
#pragma once

namespace rcb {
__extension__ using u128 = unsigned __int128;
}  // namespace rcb
