#include "server/net/push/push.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/field_reader.hpp"
#include "common/wire/limits.hpp"

namespace rcb::net {

namespace {

Status check_plan(const PushTerms& terms, const scene::SceneState& scene) {
  if (terms.plan == PlanId{scene.plan_version, scene.plan_checksum}) return {};
  return {Code::stale_plan,
          fmt::format("the push follows plan {} ({}), the scene is at plan {} ({})", terms.plan.version,
                      wire::hex64(terms.plan.checksum), scene.plan_version, wire::hex64(scene.plan_checksum)),
          "fetch the plan and push again"};
}

using Expected = std::vector<std::pair<std::string, std::string>>;  // names and types of arrays, in order

// Of a slice.
Expected expected_arrays(const PushTerms& terms, int rank) {
  Expected arrays;
  if (rank == wire::kRemovedSlice) return {{"id", "<i8"}};
  for (int axis = 0; axis < terms.dims; ++axis)
    arrays.emplace_back(kAxisNames[static_cast<std::size_t>(axis)], terms.is_float32 ? "<f4" : "<f8");
  const bool inserted = rank == wire::kInsertedSlice;
  if (inserted ? terms.scene_weights : terms.weights) arrays.emplace_back("w", "<f8");
  if (inserted ? terms.inserted_ids : terms.ids || (terms.by_id && terms.moved == Moved::some))
    arrays.emplace_back("id", "<i8");
  else if (!inserted && terms.moved == Moved::some)
    arrays.emplace_back("slot", "<u8");
  return arrays;
}

std::string in_words(const Expected& arrays) {
  std::string names;
  for (const auto& [name, dtype] : arrays) names += fmt::format("{}{} {}", names.empty() ? "" : ", ", name, dtype);
  return names;
}

std::string name_of(int rank) {
  if (rank == wire::kInsertedSlice) return "the inserted particles";
  if (rank == wire::kRemovedSlice) return "the removed particles";
  return fmt::format("rank {}", rank);
}

// Checks the number of slices that follow on the control connection.
Status check_slice_count(const PushTerms& terms) {
  const std::uint64_t edits = terms.edit_slices();
  const std::uint64_t moved = terms.slices - std::min(terms.slices, edits);
  const bool none = terms.to_ranks() || terms.moved == Moved::none;
  const bool too_many = moved > (none ? 0U : static_cast<std::uint64_t>(terms.ranks));
  const bool too_few = terms.slices < edits || (!none && terms.moving() > 0 && (terms.by_id ? moved != 1 : moved == 0));
  if (!too_many && !too_few) return {};
  return {Code::invalid_argument,
          fmt::format("field 'slices': {} can't carry {} particles in order \"{}\", and {} slices of inserted and "
                      "removed ones",
                      terms.slices, none ? 0 : terms.moving(), terms.by_id ? "id" : "plan", edits)};
}

Status check_base(const PushTerms& terms, const scene::SceneState& scene) {
  if (!terms.base_step || (scene.step == terms.base_step && scene.positions_step == scene.step)) return {};
  return {Code::base_lost,
          fmt::format("the push builds on step {}, {}", *terms.base_step,
                      !scene.step                     ? "the scene has no positions yet"
                      : scene.step != terms.base_step ? fmt::format("the scene is at step {}", *scene.step)
                                                      : "whose positions the ranks don't hold"),
          "push all particles"};
}

// Checks what a push from shared memory names. In order "id" rows are the ids; in order "plan" the push says which row
// is in which slot, as a member always does.
Status check_shared(const PushTerms& terms, const scene::SceneState& scene, Pusher pusher) {
  const std::string hint = "push by the path \"direct\" or \"gateway\"";
  if (terms.moved != Moved::all) return {Code::unsupported, "from shared memory all particles are pushed", hint};
  if (terms.by_id && pusher == Pusher::member)
    return {Code::unsupported, "a member pushes from shared memory in order \"plan\"", hint};
  const bool first = !scene.step || terms.refill;
  if (!terms.by_id && first) return {Code::unsupported, "a first push from shared memory is in order \"id\"", hint};
  if (!first && scene.ids && terms.by_id)
    return {Code::unsupported, "the scene has ids of its own (scene.show: ids), so they name no rows of the memory",
            "push in order \"plan\", or by another path"};
  if (!terms.by_id && terms.counts.size() != static_cast<std::size_t>(terms.ranks))
    return {Code::invalid_argument, "field 'counts': the numbers of rows on each rank, where 'row' lists them"};
  auto expected = expected_arrays(terms, 0);
  if (!terms.by_id) expected.emplace_back("row", "<u8");
  bool match = terms.shared.size() == expected.size();
  for (std::size_t a = 0; match && a < expected.size(); ++a) {
    const api::SharedArray& array = terms.shared[a];
    const std::uint64_t width = expected[a].second == "<f4" ? 4 : 8;
    match = array.name == expected[a].first && array.offset % width == 0 && array.stride % width == 0;
  }
  if (match) return {};
  return {Code::invalid_argument,
          fmt::format("field 'memory': the arrays must be {}, aligned to their elements", in_words(expected))};
}

// Checks a member's push. One that doesn't say which particles the member has must fit the parts after the last step,
// and on the direct path the layout.
Status check_share(const wire::Json& request, const scene::SceneState& scene, const PushTerms& terms) {
  const bool all = terms.moved == Moved::all;
  if (!all && !terms.base_step)
    return {Code::unsupported,
            "a member that pushes few of its particles, or none, names the last step as 'base_step'"};
  if (!all && terms.weights)
    return {Code::unsupported, "weights are replaced all together", "push all particles with their weights"};
  if (terms.to_ranks() ? terms.ids : !terms.by_id || terms.ids != all)
    return {Code::unsupported,
            "members push in order \"id\", with \"ids\" true if they push all their particles, or by the paths "
            "\"direct\" and \"shared\" without ids"};
  if (!terms.to_ranks() && all) return {};
  if (!scene.step) return {Code::stale_plan, "the scene has no plan yet", "push in order \"id\""};
  const auto epoch = wire::integer_field(request, "epoch", 0, wire::kIntegerMax);
  if (!epoch.ok()) return epoch.status();
  if (static_cast<std::uint64_t>(*epoch) != scene.epoch)
    return {terms.to_ranks() ? Code::stale_plan : Code::base_lost,
            fmt::format("the push follows epoch {}, the scene is at {}", *epoch, scene.epoch),
            "push all particles in order \"id\""};
  if (!terms.to_ranks()) return {};
  if (!terms.base_step)
    return {Code::invalid_argument, "field 'base_step': a member's direct push names the last step"};
  const auto together = std::accumulate(terms.counts.begin(), terms.counts.end(), std::uint64_t{0});
  if (terms.counts.empty())
    return {Code::invalid_argument,
            "field 'counts' is missing: the push's particles on each rank, zeros if it has none"};
  if (terms.moved != Moved::some && together != terms.n)
    return {Code::invalid_argument,
            fmt::format("field 'counts': {} particles together, the push has {}", together, terms.n)};
  for (std::size_t rank = 0; rank < terms.counts.size(); ++rank)
    if (terms.counts[rank] > scene.rank_counts[rank])
      return {Code::stale_plan,
              fmt::format("the push has {} particles of rank {}, which holds {}", terms.counts[rank], rank,
                          scene.rank_counts[rank]),
              "push in order \"id\""};
  return {};
}

}  // namespace

std::uint64_t PushTerms::bytes() const {
  const auto point = static_cast<std::uint64_t>(dims);
  return 8 * (moving() * (point + (weights ? 1U : 0U) + (last_array() ? 1U : 0U)) +
              inserted * (point + (scene_weights ? 1U : 0U) + (inserted_ids ? 1U : 0U)) + removed);
}

Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const scene::SceneState& scene,
                                  int ranks, std::uint64_t bytes_max, Pusher pusher) {
  auto push = api::read_push(request, id, ranks);
  if (!push.ok()) return push.status();
  PushTerms terms{std::move(*push), ranks, scene.options.dims, scene.weights};
  if (!scene.step) terms.scene_weights = terms.weights;
  wire::FieldReader needed(request);
  for (const char* name : {"n", "slices"}) needed.integer(name, 0, wire::kParticlesMax);
  needed.text("order", 16);
  if (!needed.ok()) return needed.status();
  if (terms.direct() && terms.by_id)
    return Status(Code::invalid_argument, "slices in order \"id\" can't go to the ranks directly",
                  "push in order \"plan\", or by the path \"gateway\"");
  if (scene.step && !scene.filled && !terms.refill)
    return Status(Code::base_lost,
                  fmt::format("the ranks hold no particles of scene '{}' since the service was started", id.scene),
                  "bring all of them first: push.begin with \"refill\"");
  if (Status base = check_base(terms, scene); !base.ok()) return base;
  if (scene.weights && !terms.weights && scene.positions_step && scene.positions_step != scene.step)
    return Status(Code::invalid_argument,
                  fmt::format("the push brings no weights, and the ranks hold those of an older step of scene '{}'",
                              id.scene),
                  "push all weights");
  if (terms.direct() && terms.moved == Moved::none && pusher == Pusher::client)
    return Status(Code::invalid_argument, "a push without slices for the ranks can't go to them",
                  "push by the path \"gateway\"");
  if (Status counted = check_slice_count(terms); !counted.ok()) return counted;
  if (terms.from_memory())
    if (Status shared = check_shared(terms, scene, pusher); !shared.ok()) return shared;
  if (pusher == Pusher::member)
    if (Status share = check_share(request, scene, terms); !share.ok()) return share;
  if (pusher == Pusher::client && scene.step && terms.n != scene.n)
    return Status(Code::invalid_argument,
                  fmt::format("the push has {} particles, scene '{}' has {}", terms.n, id.scene, scene.n),
                  scene.n == 0 ? "insert them, into a push of no particles"
                               : "insert and remove particles, or create the scene anew for another number of them");
  const bool planned = !terms.by_id && terms.moved != Moved::none && scene.step && !terms.refill;
  if (planned || (!terms.by_id && terms.direct()))
    if (const auto plan = read_plan(request); !plan.ok()) return plan.status();
  if (planned)
    if (const Status plan = check_plan(terms, scene); !plan.ok()) return plan;
  if (terms.bytes() > bytes_max)
    return Status(Code::too_large, fmt::format("the push has {} bytes, at most {} are taken", terms.bytes(), bytes_max),
                  "start the service with a larger --bulk-bytes, or on a larger machine");
  return terms;
}

Status not_lacking(const PushId& id) {
  return {Code::stale_step,
          fmt::format("the ranks don't lack the particles of step {} of scene '{}'", id.step, id.scene),
          "ask scene.show, and push a step"};
}

bool may_bring_slices(const wire::Json& request) {
  return request.value("path", wire::Json()) == "direct" || request.contains("sockets");
}

Result<Slice> make_slice(const wire::Json& request, std::uint64_t bulk_bytes, const PushTerms& terms, int rank,
                         std::uint64_t count) {
  const auto specs = wire::array_specs(request, bulk_bytes);
  if (!specs.ok()) return specs.status();
  Slice slice{rank, count, {}};
  const auto expected = expected_arrays(terms, rank);
  bool match = specs->size() == expected.size();
  for (std::size_t i = 0; match && i < expected.size(); ++i) {
    const wire::ArraySpec& spec = (*specs)[i];
    match = spec.name == expected[i].first && spec.dtype == expected[i].second && spec.shape.size() == 1 &&
            spec.shape[0] == slice.count;
    slice.arrays.push_back({spec.name, spec.dtype, spec.shape, {}});
  }
  if (match) return slice;
  return Status(Code::invalid_argument, fmt::format("the slice of {} must have the arrays {}, each of shape [{}]",
                                                    name_of(slice.rank), in_words(expected), slice.count));
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

Result<Slice> PushSlices::begin_slice(const wire::Json& request, std::uint64_t bulk_bytes) const {
  if (const auto specs = wire::array_specs(request, bulk_bytes); !specs.ok()) return specs.status();
  wire::FieldReader fields(request);
  const std::string holds = fields.word("holds", {"moved", "inserted", "removed"});
  const std::int64_t count = fields.integer("count", 0, wire::kParticlesMax);
  if (!fields.ok()) return fields.status();
  const auto particles = static_cast<std::uint64_t>(count);
  if (holds != "moved") {
    const bool inserted = holds == "inserted";
    const int which = inserted ? wire::kInsertedSlice : wire::kRemovedSlice;
    const std::uint64_t announced = inserted ? terms_.inserted : terms_.removed;
    if (particles == 0 || particles != announced || ranks_.contains(which))
      return Status(Code::invalid_argument,
                    fmt::format("a slice of {} {} particles, {} were announced once", particles, holds, announced));
    return make_slice(request, bulk_bytes, terms_, which, particles);
  }
  const auto rank = wire::integer_field(request, "rank", 0, terms_.ranks - 1);
  if (!rank.ok()) return rank.status();
  if (terms_.to_ranks())
    return Status(Code::invalid_argument, fmt::format("the particles of rank {} don't come by this connection", *rank));
  if (ranks_.contains(static_cast<int>(*rank)))
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} came twice", *rank));
  if (terms_.by_id && *rank != 0)
    return Status(Code::invalid_argument, fmt::format("order \"id\" has a slice for rank 0 alone, not {}", *rank));
  if (particles > terms_.moving() - count_)
    return Status(Code::invalid_argument,
                  fmt::format("the slice of rank {} has {} particles, only {} of {} are still to come", *rank,
                              particles, terms_.moving() - count_, terms_.moving()));
  if (!terms_.counts.empty() && particles != terms_.counts[static_cast<std::size_t>(*rank)])
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} has {} particles, {} were announced", *rank,
                                                      particles, terms_.counts[static_cast<std::size_t>(*rank)]));
  return make_slice(request, bulk_bytes, terms_, static_cast<int>(*rank), particles);
}

Status PushSlices::add(Slice slice) {
  if (slice.rank >= 0) count_ += slice.count;
  ranks_.insert(slice.rank);
  slices_.push_back(std::move(slice));
  if (whole() && !terms_.to_ranks() && count_ != terms_.moving())
    return {Code::invalid_argument,
            fmt::format("the slices have {} particles together, {} were announced", count_, terms_.moving())};
  return {};
}

std::string PushSlices::progress() const { return fmt::format("{} of {} slices", slices_.size(), terms_.slices); }

}  // namespace rcb::net
