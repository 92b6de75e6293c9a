#include "server/net/push/push.hpp"

#include <cstring>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::net {

namespace {

using Expected = std::vector<std::pair<std::string, std::string>>;  // names and types of arrays, in order

Expected expected_arrays(const PushTerms& terms) {
  Expected arrays;
  for (int axis = 0; axis < terms.dims; ++axis)
    arrays.emplace_back(kAxisNames[static_cast<std::size_t>(axis)], terms.is_float32 ? "<f4" : "<f8");
  if (terms.weights) arrays.emplace_back("w", "<f8");
  if (terms.ids) arrays.emplace_back("id", "<i8");
  return arrays;
}

std::string in_words(const Expected& arrays) {
  std::string names;
  for (const auto& [name, dtype] : arrays) names += fmt::format("{}{} {}", names.empty() ? "" : ", ", name, dtype);
  return names;
}

Status wrong(std::string what, std::string hint) { return {Code::invalid_argument, std::move(what), std::move(hint)}; }

Status check_step(const PushTerms& terms, const scene::SceneState& scene) {
  const PushId& id = terms.id;
  if (terms.incarnation && *terms.incarnation != scene.incarnation) return scene::made_anew(id.scene);
  if (scene.step && id.step <= *scene.step) return scene::stale_step(id.scene, id.step, *scene.step);
  return {};
}

// Whether the ranks read from shared memory those rows whose particles they hold.
bool by_held(const PushTerms& terms, const scene::SceneState& scene) {
  return terms.by_held() && scene.filled && scene.n > 0 && !scene.others;
}

// Checks which arrays come besides the positions.
Status check_arrays(const PushTerms& terms, const scene::SceneState& scene, std::size_t seats) {
  const std::string with_ids = "give the ids of the particles (on the wire: \"ids\", and the array id)";
  if (terms.n == 0) return {};
  if (!terms.ids && seats > 1) return wrong("the push of a seat has no ids", with_ids);
  if (!scene.step || scene.n == 0) return {};
  if (!terms.ids && terms.flows()) return wrong("particles come or go, and the push has no ids", with_ids);
  if (!terms.ids && scene.ids)
    return wrong(fmt::format("the particles of scene '{}' have ids, and the push has none", terms.id.scene), with_ids);
  if (terms.weights == scene.weights) return {};
  if (terms.weights)
    return wrong(fmt::format("the push has weights, scene '{}' has none", terms.id.scene),
                 "weights are there from the first push on, or never");
  if (!by_held(terms, scene))
    return wrong(fmt::format("scene '{}' has weights, and the push has none", terms.id.scene), "push all weights");
  if (scene.positions_step != scene.step)
    return wrong(fmt::format("the push brings no weights, and the ranks hold those of an older step of scene '{}'",
                             terms.id.scene),
                 "push all weights");
  return {};
}

// Checks what a push from shared memory names.
Status check_shared(const PushTerms& terms, const scene::SceneState& scene, std::size_t seats) {
  if (by_held(terms, scene) && (scene.ids || terms.ids || seats > 1 || terms.flows()))
    return {Code::unsupported,
            "without the array 'row' the row k of the memory is the particle k, of one client and without ids",
            "push with 'row' and 'counts', or by the way \"sockets\" or \"endpoint\""};
  auto expected = expected_arrays(terms);
  if (!terms.counts.empty()) expected.emplace_back("row", "<u8");
  bool match = terms.shared.size() == expected.size();
  for (std::size_t a = 0; match && a < expected.size(); ++a) {
    const api::SharedArray& array = terms.shared[a];
    const std::uint64_t width = expected[a].second == "<f4" ? 4 : 8;
    match = array.name == expected[a].first && array.offset % width == 0 && array.stride % width == 0;
  }
  if (match) return {};
  return wrong(fmt::format("field 'memory': the arrays must be {}, aligned to their elements", in_words(expected)),
               "'row' is there if 'counts' says how many rows go to each rank");
}

}  // namespace

Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const scene::SceneState& scene,
                                  int ranks, std::uint64_t bytes_max, std::size_t seats) {
  auto push = api::read_push(request, id, ranks);
  if (!push.ok()) return push.status();
  PushTerms terms{std::move(*push), ranks, scene.options.dims};
  if (Status step = check_step(terms, scene); !step.ok()) return step;
  if (Status arrays = check_arrays(terms, scene, seats); !arrays.ok()) return arrays;
  if (terms.from_memory() && terms.n > 0)
    if (Status shared = check_shared(terms, scene, seats); !shared.ok()) return shared;
  if (terms.bytes() > bytes_max)
    return Status(Code::too_large, fmt::format("the push has {} bytes, at most {} are taken", terms.bytes(), bytes_max),
                  "start the service with a larger --bulk-bytes, or on a larger machine");
  return terms;
}

bool may_bring_slices(const wire::Json& request) {
  return request.value("way", wire::Json()) == "sockets" || request.contains("sockets");
}

Result<Slice> make_slice(const wire::Json& request, std::uint64_t bulk_bytes, const PushTerms& terms,
                         std::uint64_t count) {
  const auto specs = wire::array_specs(request, bulk_bytes);
  if (!specs.ok()) return specs.status();
  Slice slice{.count = count};
  const auto expected = expected_arrays(terms);
  bool match = specs->size() == expected.size();
  for (std::size_t i = 0; match && i < expected.size(); ++i) {
    const wire::ArraySpec& spec = (*specs)[i];
    match = spec.name == expected[i].first && spec.dtype == expected[i].second && spec.shape.size() == 1 &&
            spec.shape[0] == count;
    slice.arrays.push_back({spec.name, spec.dtype, spec.shape, {}});
  }
  if (match) return slice;
  return Status(Code::invalid_argument,
                fmt::format("the slice must have the arrays {}, each of shape [{}]", in_words(expected), count));
}

void widen(std::span<const std::byte> floats, std::span<std::byte> doubles) {
  constexpr std::size_t kTogether = 8;
  using Floats = float __attribute__((vector_size(kTogether * sizeof(float))));
  using Doubles = double __attribute__((vector_size(kTogether * sizeof(double))));
  const std::size_t count = doubles.size() / sizeof(double);
  std::size_t i = 0;
  for (; i + kTogether <= count; i += kTogether) {  // all are read before they are written: the two may overlap
    Floats from;
    std::memcpy(&from, floats.data() + i * sizeof(float), sizeof from);
    const auto to = __builtin_convertvector(from, Doubles);
    std::memcpy(doubles.data() + i * sizeof(double), &to, sizeof to);
  }
  for (; i < count; ++i) {
    float from = 0;
    std::memcpy(&from, floats.data() + i * sizeof(float), sizeof from);
    const double to = from;
    std::memcpy(doubles.data() + i * sizeof(double), &to, sizeof to);
  }
}

}  // namespace rcb::net
