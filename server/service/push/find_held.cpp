#include "server/service/push/find_held.hpp"

#include <new>

#include <fmt/format.h>

#include "server/service/context/collective.hpp"

namespace rcb::service {

namespace {

// False if there is no memory for it; then there is none.
bool build_index(Scene& scene) try {
  IdIndex& index = scene.index;
  index.slot.clear();
  index.slot.reserve(scene.particles.count());
  for (std::size_t i = 0; i < scene.particles.count(); ++i) index.slot.emplace(scene.particles.id[i], i);
  index.plan_version = scene.plan_version;
  return true;
} catch (const std::bad_alloc&) {
  scene.index = {};
  return false;
}

}  // namespace

Status make_index(comm::Comm& comm, Scene& scene) {
  Status made;
  if (scene.index.plan_version != scene.plan_version && !build_index(scene))
    made = {Code::too_large,
            fmt::format("rank {} has no memory to find {} particles by id", comm.rank(), scene.particles.count())};
  return agree_status(comm, made);
}

Status not_held(particles::Id id, const char* doing) {
  return {Code::not_found, fmt::format("particle {} is to be {}, and the scene has none of that id", id, doing),
          "the previous step stands"};
}

}  // namespace rcb::service
