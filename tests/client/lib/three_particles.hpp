// What a member of the tests pushes.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace rcb::client {

inline const std::vector<double> kX{0.5, 1.5, 2.5};
inline const std::vector<double> kY{10, 11, 12};
inline const std::vector<std::int64_t> kIds{7, 3, 900};
inline const std::array<const double*, 2> kAxes{kX.data(), kY.data()};

}  // namespace rcb::client
