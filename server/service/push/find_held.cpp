#include "server/service/push/find_held.hpp"

#include <fmt/format.h>

namespace rcb::service {

const IdIndex& index_of(Scene& scene) {
  IdIndex& index = scene.index;
  if (index.plan_version == scene.plan_version) return index;
  index.slot.clear();
  index.slot.reserve(scene.particles.count());
  for (std::size_t i = 0; i < scene.particles.count(); ++i) index.slot.emplace(scene.particles.id[i], i);
  index.plan_version = scene.plan_version;
  return index;
}

Status not_held(particles::Id id, const char* doing) {
  return {Code::not_found, fmt::format("particle {} is to be {}, and the scene has none of that id", id, doing),
          "the previous step stands"};
}

}  // namespace rcb::service
