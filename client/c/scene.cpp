// Scenes: making or opening them, and their shared arrays.
#include "client/c/scene.hpp"

#include <chrono>
#include <memory>
#include <thread>

#include <fmt/format.h>

#include "client/c/call.hpp"
#include "client/c/positions.hpp"
#include "client/c/structs.hpp"
#include "common/wire/message.hpp"

namespace rcb::c {
namespace {

constexpr std::chrono::duration<double> kBetweenLooks(0.05);  // for a scene that seat 0 has still to make

const char* text_or(const char* given, const char* otherwise) { return given == nullptr ? otherwise : given; }

client::SceneOptions options_of(const rcbd_scene_options& given) {
  client::SceneOptions options{.parts = given.parts,
                               .dims = given.dims,
                               .method = text_or(given.method, "rcb"),
                               .tolerance = given.tolerance,
                               .axis_hysteresis = given.axis_hysteresis,
                               .cut_tolerance = given.cut_tolerance,
                               .policy = text_or(given.policy, "tolerance"),
                               .positions = text_or(given.positions, "every-step"),
                               .threads = given.threads,
                               .replace = given.replace != 0};
  const auto sizes = optional_array(given.part_sizes, static_cast<std::size_t>(given.parts));
  options.part_sizes.assign(sizes.begin(), sizes.end());
  return options;
}

// Whether the scene that is there has these options.
Status check_same(client::Client& client, const std::string& name, const client::SceneOptions& asked, double seconds) {
  const auto reply = client.call("scene.show", wire::dump_json({{"scene", name}}), seconds);
  if (!reply) return reply.status();
  const auto there = wire::parse_json(reply->json);
  if (!there) return there.status();
  const wire::Json wanted{{"parts", asked.parts},
                          {"dims", asked.dims},
                          {"method", asked.method},
                          {"tolerance", wire::number_json(asked.tolerance)},
                          {"axis_hysteresis", wire::number_json(asked.axis_hysteresis)},
                          {"cut_tolerance", wire::number_json(asked.cut_tolerance)},
                          {"policy", asked.policy},
                          {"positions", asked.positions}};
  for (const auto& [option, value] : wanted.items())
    if (const auto found = there->find(option); found == there->end() || *found != value)
      return {Code::already_exists,
              fmt::format("scene '{}' is there already: its {} is {}, not {}", name, option,
                          found == there->end() ? "not told" : wire::dump_json(*found), wire::dump_json(value)),
              "go on with the options that it has (parts = 0), make it anew (replace), or take another name"};
  return {};
}

// One of several seats may come before the one that makes the scene.
Result<client::Scene> open_when_there(rcbd_client& client, const std::string& name, const rcbd_scene_options& given,
                                      const Left& left) {
  while (true) {
    auto scene = client.client->open_scene(name, {given.seat, given.seats, left.seconds()});
    if (scene || scene.status().code() != Code::not_found || given.seat == 0 || left.seconds() < kBetweenLooks.count())
      return scene;
    if (client.interrupts.answer())
      return Status(Code::interrupted, fmt::format("interrupted; scene '{}' is not there yet", name));
    std::this_thread::sleep_for(kBetweenLooks);
  }
}

Result<client::Scene> make_or_open(rcbd_client& client, const std::string& name, const rcbd_scene_options& given,
                                   const Left& left) {
  client::Client& service = *client.client;
  const client::SceneOptions options = options_of(given);
  if (given.seat == 0 && given.parts > 0) {
    const Status made = service.create_scene(name, options, left.seconds());
    if (!made && (made.code() != Code::already_exists || options.replace)) return made;
  }
  auto scene = open_when_there(client, name, given, left);
  if (scene && given.parts > 0)
    if (Status same = check_same(service, name, options, left.seconds()); !same) return same;
  return scene;
}

Status check_options(const rcbd_scene_options& options) {
  if (options.parts < 0) return {Code::invalid_argument, fmt::format("{} parts", options.parts), "give 1 or more"};
  if (options.parts == 0 && options.replace != 0)
    return {Code::invalid_argument, "a scene that is to be replaced, without its parts", "say how many parts it has"};
  if (options.threads < 1)
    return {Code::invalid_argument, fmt::format("{} threads", options.threads), "give 1 or more"};
  return check_deadline(options.deadline_seconds);
}

template <typename T>
Status take_arrays(client::Scene& scene, std::size_t count, rcbd_layout layout, rcbd_arrays& to) {
  const auto ask = [&](auto rows, auto axes) -> Status {
    const std::size_t room = std::max<std::size_t>(count, 1);  // which says the dims
    if (layout == RCBD_AXES) {
      const auto given = (scene.*axes)(room);
      if (!given) return given.status();
      to.positions.dims = static_cast<std::int32_t>(given->size());
      for (std::size_t a = 0; a < given->size(); ++a) to.positions.axis[a] = (*given)[a].data();
      return {};
    }
    const auto given = (scene.*rows)(room);
    if (!given) return given.status();
    to.positions.dims = static_cast<std::int32_t>(given->size() / room);
    to.positions.stride = to.positions.dims;
    for (std::int32_t a = 0; a < to.positions.dims; ++a) to.positions.axis[a] = given->data() + a;
    return {};
  };
  if constexpr (sizeof(T) == sizeof(float))
    return ask(&client::Scene::position_rows_f4, &client::Scene::position_axes_f4);
  else
    return ask(&client::Scene::position_rows, &client::Scene::position_axes);
}

}  // namespace
}  // namespace rcb::c

rcb::Status rcbd_scene::close() {
  client->turns.take();
  const rcbd_client::Turn turn(*client);
  client->scenes.erase(this);
  scene.reset();
  return {};
}

int rcbd_scene_open(rcbd_client* client, const char* name, const rcbd_scene_options* options, rcbd_scene** to) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the scene: a null pointer"};
    *to = nullptr;
    if (Status usable = c::check(client); !usable) return usable;
    if (name == nullptr) return {Code::invalid_argument, "the name of the scene is NULL"};
    const auto given = c::read_struct(options, rcbd_scene_options RCBD_SCENE_OPTIONS, "RCBD_SCENE_OPTIONS");
    if (!given) return given.status();
    if (Status fits = c::check_options(*given); !fits) return fits;
    auto made = std::make_unique<rcbd_scene>(*client, name, given->threads);
    const c::Left left(given->deadline_seconds);
    Status status = client->in_turn(left, [&] {
      auto scene = c::make_or_open(*client, made->name, *given, left);
      if (!scene) return scene.status();
      client->scenes.insert(made.get());
      made->scene.emplace(std::move(*scene));
      made->opened = true;
      return Status();
    });
    if (status) *to = made.release();
    return status;
  });
}

int rcbd_scene_drop(rcbd_client* client, const char* name) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    if (Status usable = c::check(client); !usable) return usable;
    if (name == nullptr) return {Code::invalid_argument, "the name of the scene is NULL"};
    const c::Left left;
    return client->in_turn(left, [&] { return client->client->drop_scene(name, left.seconds()); });
  });
}

int rcbd_last_step(rcbd_scene* scene, std::int64_t* step) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    if (step == nullptr) return {Code::invalid_argument, "no room for the step: a null pointer"};
    *step = -1;
    if (Status usable = c::check(scene); !usable) return usable;
    return scene->in_turn(c::Left(), [&](client::Scene& open) {
      *step = open.last_step().value_or(-1);
      return Status();
    });
  });
}

int rcbd_arrays_new(rcbd_scene* scene, std::int64_t count, rcbd_layout layout, std::int32_t single, rcbd_arrays** to) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    if (to == nullptr) return {Code::invalid_argument, "no room for the arrays: a null pointer"};
    *to = nullptr;
    if (Status usable = c::check(scene); !usable) return usable;
    if (count < 0) return {Code::invalid_argument, fmt::format("arrays for {} positions", count)};
    if (layout != RCBD_ROWS && layout != RCBD_AXES)
      return {Code::invalid_argument, fmt::format("the layout {}", static_cast<int>(layout)), "RCBD_ROWS or RCBD_AXES"};
    if (single != 0 && single != 1) return {Code::invalid_argument, fmt::format("single is {}, not 0 or 1", single)};
    auto made = std::make_unique<rcbd_arrays>();
    made->positions.count = count;
    made->positions.single = single;
    Status status = scene->in_turn(c::Left(), [&](client::Scene& open) {
      const auto take = single != 0 ? c::take_arrays<float> : c::take_arrays<double>;
      if (Status given = take(open, static_cast<std::size_t>(count), layout, *made); !given) return given;
      made->memory = open.position_memory();
      return Status();
    });
    if (status) *to = made.release();
    return status;
  });
}

int rcbd_arrays_positions(rcbd_arrays* arrays, rcbd_positions* positions) {
  using namespace rcb;  // NOLINT
  return c::call([&]() -> Status {
    if (Status usable = c::check(arrays); !usable) return usable;
    return c::write_struct(arrays->positions, positions, "RCBD_POSITIONS");
  });
}
