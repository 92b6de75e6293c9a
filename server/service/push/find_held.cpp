#include "server/service/push/find_held.hpp"

#include <new>

#include <fmt/format.h>

#include "server/service/context/collective.hpp"

namespace rcb::service {

Status make_index(comm::Comm& comm, Scene& scene) {
  Status made;
  IdIndex& index = scene.index;
  if (index.plan_version != scene.plan_version) try {
      index.slot.clear();
      index.slot.reserve(scene.particles.count());
      for (std::size_t i = 0; i < scene.particles.count(); ++i) index.slot.emplace(scene.particles.id[i], i);
      index.plan_version = scene.plan_version;
    } catch (const std::bad_alloc&) {
      index = {};
      made = {Code::too_large,
              fmt::format("rank {} has no memory to find {} particles by id", comm.rank(), scene.particles.count())};
    }
  return agree_status(comm, made);
}

Status not_held(particles::Id id, const char* doing) {
  return {Code::not_found, fmt::format("particle {} is to be {}, and the scene has none of that id", id, doing),
          "the previous step stands"};
}

}  // namespace rcb::service
