// The push: all ranks prepare it, then all commit it or all give it up.
#include <malloc.h>

#include "server/service/commands/cuts_json.hpp"
#include "server/service/step/exchange.hpp"
#include "server/service/step/step.hpp"

namespace rcb::service {
namespace {

// Returns memory to the system that only a full change needs. Under a sanitizer the C library's allocator is unused,
// and sets itself up at its first call, which ranks that are threads must not make at once.
void return_freed_memory() {
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  ::malloc_trim(0);
#endif
}

Response push(Context& context, Scene& scene, const wire::Json& request) {
  const auto push = read_order(request, context.comm.size());
  if (!push.ok()) return failed(push.status());
  auto staged = prepare(context, scene, *push);
  if (!staged.ok()) return failed(staged.status());
  const std::optional<std::int64_t> previous_step = scene.step;
  scene::Stepped stepped = commit(context, scene, *staged, *push);
  give_back(context, scene, *staged, push->way);
  if (!previous_step || is_full_change(staged->sums.exported, scene.n)) return_freed_memory();
  if (!context.root()) return {};  // only rank 0's response is used
  Response response = done({{"report", to_json(stepped.report)}, {"previous_step", wire::or_null(previous_step)}});
  put_cuts_unless_known(context, response, scene, *push);
  response.change = {scene.name, std::move(stepped)};
  return response;
}

constexpr Command kPushCommands[] = {{"push", push, Needs::scene}};

}  // namespace

std::span<const Command> push_commands() { return kPushCommands; }

}  // namespace rcb::service
