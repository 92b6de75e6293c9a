// The pass where no cuts are in force: it makes the points of all particles, bucket by bucket.
#pragma once

#include "common/partition/buckets/buckets.hpp"
#include "common/partition/sample/guide.hpp"

namespace rcb::partition {

// Without splitters all particles are in bucket 0, and neither its box nor its load is told. Local.
OwnShare put_all(const particles::ParticleView& particles, const Guide& guide, const AxisMaps& maps,
                 const Tuning& tuning, PointStore& points);

}  // namespace rcb::partition
