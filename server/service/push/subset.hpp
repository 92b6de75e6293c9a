// Pushes in which only some particles moved: brings these to the ranks that hold them. Work is proportional to their
// number.
#pragma once

#include <cstdint>

#include "common/base/status.hpp"
#include "server/service/context/context.hpp"
#include "server/service/push/request.hpp"

namespace rcb::service {

// Of a push in which only some particles moved, those of this rank: element k of the staged arrays is the new position
// of the particle in this slot of the scene.
struct Subset {
  Buffer<std::uint64_t> slot;  // ascending
};

// Collective. Brings the moved particles of a push to their ranks: positions and ids into `arrays`, their slots into
// `subset`. `ready` gets a fault that only this rank knows of; the reduction that follows lets all ranks agree on it.
// Errors: faults of the slices, the same on every rank.
Status receive_subset(Context& context, Scene& scene, const PushRequest& push, particles::ParticleSet& arrays,
                      Subset& subset, Status& ready);

}  // namespace rcb::service
