// Passes over quantised points.
#pragma once

#include <cstdint>
#include <span>

#include "common/partition/kernels/block.hpp"

namespace rcb::partition {

// Moves the points with q < first_right on this axis to the front; returns where the others begin. Local.
QuantisedPoint* divide(std::span<QuantisedPoint> points, std::size_t axis, std::int32_t first_right);

// Adds one to bin (q - lo) >> shift of one of two tables for each point; q in [lo, lo + (bins << shift)). Two, since
// neighbours often fall into the same bin, and its increments would wait for each other. Local.
void count_bins(std::span<const QuantisedPoint> points, std::size_t axis, std::int32_t lo, unsigned shift,
                std::span<std::uint64_t> even, std::span<std::uint64_t> odd);

}  // namespace rcb::partition
