#include "server/net/push.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::net {

Result<PlanId> read_plan(const wire::Json& request) {
  const auto found = request.find("plan");
  if (found == request.end() || !found->is_object())
    return Status(Code::invalid_argument, "field 'plan': expected an object with 'version' and 'checksum'");
  const auto version = wire::integer_field(*found, "version", 0, std::numeric_limits<std::int64_t>::max());
  if (!version.ok()) return version.status();
  const auto text = wire::string_field(*found, "checksum", 16);
  if (!text.ok()) return text.status();
  const auto checksum = wire::parse_hex64(*text);
  if (!checksum.ok()) return checksum.status();
  return PlanId{static_cast<std::uint64_t>(*version), *checksum};
}

namespace {

Status check_plan(const wire::Json& request, const api::SceneSummary& scene) {
  const Result<PlanId> plan = read_plan(request);
  if (!plan.ok()) return plan.status();
  if (plan->version == scene.plan_version && plan->checksum == scene.plan_checksum) return {};
  return {Code::stale_plan,
          fmt::format("the push follows plan {} ({}), the scene is at plan {} ({})", plan->version,
                      wire::hex64(plan->checksum), scene.plan_version, wire::hex64(scene.plan_checksum)),
          "fetch the plan and push again"};
}

// Names and types of the arrays that the slice has, in this order.
std::vector<std::pair<std::string, std::string>> expected_arrays(const PushTerms& terms, int rank) {
  constexpr std::array kAxes{"x", "y", "z"};
  std::vector<std::pair<std::string, std::string>> arrays;
  if (rank == wire::kRemovedSlice) return {{"id", "<i8"}};
  for (int axis = 0; axis < terms.dims; ++axis)
    arrays.emplace_back(kAxes[static_cast<std::size_t>(axis)], terms.single ? "<f4" : "<f8");
  const bool inserted = rank == wire::kInsertedSlice;
  if (inserted ? terms.scene_weights : terms.weights) arrays.emplace_back("w", "<f8");
  if (inserted ? terms.inserted_ids : terms.ids || (terms.by_id && terms.moved == Moved::some))
    arrays.emplace_back("id", "<i8");
  else if (!inserted && terms.moved == Moved::some)
    arrays.emplace_back("slot", "<u8");
  return arrays;
}

std::string name_of(int rank) {
  if (rank == wire::kInsertedSlice) return "the inserted particles";
  if (rank == wire::kRemovedSlice) return "the removed particles";
  return fmt::format("rank {}", rank);
}

// "counts": how many particles each slice has.
Status read_counts(const wire::Json& request, PushTerms& terms) {
  const auto counts = wire::numbers_field_or_empty(request, "counts", static_cast<std::size_t>(terms.ranks));
  if (!counts.ok()) return counts.status();
  const std::size_t slices = terms.by_id ? 1 : static_cast<std::size_t>(terms.ranks);
  if (counts->size() != slices)
    return {Code::invalid_argument, fmt::format("field 'counts': expected {} numbers, got {}", slices, counts->size())};
  terms.moving = 0;
  for (const double count : *counts) {
    if (!(count >= 0 && count <= static_cast<double>(terms.n - terms.moving)))
      return {Code::invalid_argument, fmt::format("field 'counts': more than the {} particles of the push", terms.n)};
    terms.counts.push_back(static_cast<std::uint64_t>(count));
    terms.moving += terms.counts.back();
  }
  return {};
}

// What moved, what is inserted and removed, in which precision.
Status read_changes(const wire::Json& request, PushTerms& terms) {
  const auto moved = request.contains("moved") ? wire::string_field(request, "moved", 16) : std::string("all");
  if (!moved.ok()) return moved.status();
  if (*moved != "all" && *moved != "some" && *moved != "none")
    return {Code::invalid_argument,
            fmt::format("field 'moved': expected \"all\", \"some\" or \"none\", got \"{}\"", *moved)};
  terms.moved = *moved == "all" ? Moved::all : *moved == "some" ? Moved::some : Moved::none;
  const auto dtype = request.contains("dtype") ? wire::string_field(request, "dtype", 16) : std::string("<f8");
  if (!dtype.ok()) return dtype.status();
  if (*dtype != "<f8" && *dtype != "<f4")
    return {Code::invalid_argument, fmt::format("field 'dtype': expected \"<f8\" or \"<f4\", got \"{}\"", *dtype)};
  terms.single = *dtype == "<f4";
  for (const auto& [name, count] : {std::pair{"inserted", &terms.inserted}, {"removed", &terms.removed}}) {
    const auto value = wire::integer_field_or(request, name, 0, wire::kParticlesMax, 0);
    if (!value.ok()) return value.status();
    *count = static_cast<std::uint64_t>(*value);
  }
  const auto own_ids = wire::bool_field_or(request, "inserted_ids", false);
  if (!own_ids.ok()) return own_ids.status();
  terms.inserted_ids = *own_ids;
  if (terms.moved == Moved::all) terms.moving = terms.n;
  return terms.moved == Moved::some ? read_counts(request, terms) : Status();
}

// The number of slices that follow on the control connection.
Status check_slice_count(const PushTerms& terms) {
  const std::uint64_t edits = terms.edit_slices();
  const std::uint64_t moved = terms.slices - std::min(terms.slices, edits);
  const bool none = terms.direct || terms.moved == Moved::none;
  const bool too_many = moved > (none ? 0U : static_cast<std::uint64_t>(terms.ranks));
  const bool too_few =
      terms.slices < edits || (!terms.direct && terms.moving > 0 && (terms.by_id ? moved != 1 : moved == 0));
  if (!too_many && !too_few) return {};
  return {Code::invalid_argument,
          fmt::format("field 'slices': {} can't carry {} particles in order \"{}\", and {} slices of inserted and "
                      "removed ones",
                      terms.slices, terms.direct ? 0 : terms.moving, terms.by_id ? "id" : "plan", edits)};
}

Status check_base(const wire::Json& request, const api::SceneSummary& scene) {
  const auto base = wire::integer_field_or(request, "base_step", 0, wire::kStepMax, -1);
  if (!base.ok()) return base.status();
  if (*base < 0 || (scene.step && *scene.step == *base)) return {};
  return {Code::base_lost,
          scene.step ? fmt::format("the push builds on step {}, the scene is at step {}", *base, *scene.step)
                     : fmt::format("the push builds on step {}, the scene has no positions yet", *base),
          "push all particles"};
}

// What a member's push must be; one that goes directly rests on the plan and the parts after the last step.
Status check_share(const wire::Json& request, const api::SceneSummary& scene, PushTerms& terms) {
  if (terms.moved != Moved::all && !(terms.moved == Moved::none && terms.direct && !terms.weights))
    return {Code::unsupported, "members push all their particles, or directly none, without weights"};
  if (terms.edit_slices() > 0) return {Code::unsupported, "members neither insert nor remove particles"};
  if (request.contains("step_seconds") && !request["step_seconds"].is_null())
    if (const auto seconds = wire::number_field_or(request, "step_seconds", 0, std::numeric_limits<double>::max(), 0);
        !seconds.ok())
      return seconds.status();
  if (terms.direct ? terms.ids : !terms.by_id || !terms.ids)
    return {Code::unsupported,
            "members push in order \"id\", with \"ids\" true, or by the path \"direct\" without ids"};
  if (!terms.direct) return {};
  if (!scene.step) return {Code::stale_plan, "the scene has no plan yet", "push in order \"id\""};
  const auto epoch = wire::integer_field(request, "epoch", 0, std::numeric_limits<std::int64_t>::max());
  if (!epoch.ok()) return epoch.status();
  if (static_cast<std::uint64_t>(*epoch) != scene.epoch)
    return {Code::stale_plan, fmt::format("the push follows epoch {}, the scene is at {}", *epoch, scene.epoch),
            "push in order \"id\""};
  if (!request.contains("base_step") || request["base_step"].is_null())
    return {Code::invalid_argument, "field 'base_step': a member's direct push names the last step"};
  if (Status counts = read_counts(request, terms); !counts.ok()) return counts;
  if (terms.moving != terms.n)
    return {Code::invalid_argument,
            fmt::format("field 'counts': {} particles together, the push has {}", terms.moving, terms.n)};
  if (terms.moved == Moved::none) terms.moving = 0;
  for (std::size_t rank = 0; rank < terms.counts.size(); ++rank)
    if (terms.counts[rank] > scene.rank_counts[rank])
      return {Code::stale_plan,
              fmt::format("the push has {} particles of rank {}, which holds {}", terms.counts[rank], rank,
                          scene.rank_counts[rank]),
              "push in order \"id\""};
  return {};
}

}  // namespace

Result<PushId> read_push_id(const wire::Json& request, const std::string& session) {
  PushId id;
  auto scene = wire::string_field(request, "scene", 256);
  if (!scene.ok()) return scene.status();
  id.scene = std::move(*scene);
  const Status named = wire::check_scene_name(id.scene);
  if (!named.ok()) return named;
  id.session = session;
  if (request.contains("session")) {
    auto given = wire::string_field(request, "session", 16);
    if (!given.ok()) return given.status();
    const auto number = wire::parse_hex64(*given);
    if (!number.ok()) return Status(number.status().code(), "field 'session': " + number.status().message());
    id.session = wire::hex64(*number);
  }
  const auto step = wire::integer_field(request, "step", 0, wire::kStepMax);
  if (!step.ok()) return step.status();
  const auto attempt = wire::integer_field_or(request, "attempt", 0, std::numeric_limits<std::int64_t>::max(), 0);
  if (!attempt.ok()) return attempt.status();
  id.step = *step;
  id.attempt = *attempt;
  return id;
}

std::uint64_t PushTerms::bytes() const {
  const auto point = static_cast<std::uint64_t>(dims);
  return 8 * (moving * (point + (weights ? 1U : 0U) + (last_array() ? 1U : 0U)) +
              inserted * (point + (scene_weights ? 1U : 0U) + (inserted_ids ? 1U : 0U)) + removed);
}

Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const api::SceneSummary& scene,
                                  int ranks, std::uint64_t bytes_max, Pusher pusher) {
  PushTerms terms{.id = id, .ranks = ranks, .dims = scene.dims};
  const auto n = wire::integer_field(request, "n", 0, wire::kParticlesMax);
  if (!n.ok()) return n.status();
  terms.n = static_cast<std::uint64_t>(*n);
  const auto slices = wire::integer_field(request, "slices", 0, ranks + 2);
  if (!slices.ok()) return slices.status();
  terms.slices = static_cast<std::uint64_t>(*slices);
  const auto order = wire::string_field(request, "order", 16);
  if (!order.ok()) return order.status();
  if (*order != "plan" && *order != "id")
    return Status(Code::invalid_argument,
                  fmt::format("field 'order': expected \"plan\" or \"id\", got \"{}\"", *order));
  terms.by_id = *order == "id";
  const auto weights = wire::bool_field_or(request, "weights", false);
  if (!weights.ok()) return weights.status();
  const auto ids = wire::bool_field_or(request, "ids", false);
  if (!ids.ok()) return ids.status();
  terms.weights = *weights;
  terms.ids = *ids;
  const auto path = request.contains("path") ? wire::string_field(request, "path", 16) : std::string("gateway");
  if (!path.ok()) return path.status();
  terms.direct = *path == "direct";
  if (!terms.direct && *path != "gateway")
    return Status(Code::invalid_argument,
                  fmt::format("field 'path': expected \"direct\" or \"gateway\", got \"{}\"", *path));
  if (terms.direct && terms.by_id)
    return Status(Code::invalid_argument, "slices in order \"id\" can't go to the ranks directly",
                  "push in order \"plan\", or by the path \"gateway\"");
  const bool repeated = scene.step && id.step <= *scene.step;  // only the service knows what it was
  if (!repeated)
    if (Status base = check_base(request, scene); !base.ok()) return base;
  if (Status changes = read_changes(request, terms); !changes.ok()) return changes;
  terms.scene_weights = scene.weights;
  if (terms.direct && terms.moved == Moved::none && pusher == Pusher::client)
    return Status(Code::invalid_argument, "a push without slices for the ranks can't go to them",
                  "push by the path \"gateway\"");
  if (Status counted = check_slice_count(terms); !counted.ok()) return counted;
  if (pusher == Pusher::member)
    if (Status share = check_share(request, scene, terms); !share.ok()) return share;
  if (pusher == Pusher::client && scene.step && !repeated && terms.n != scene.n)
    return Status(Code::invalid_argument,
                  fmt::format("the push has {} particles, scene '{}' has {}", terms.n, id.scene, scene.n),
                  scene.n == 0 ? "insert them, into a push of no particles"
                               : "insert and remove particles, or create the scene anew for another number of them");
  if (terms.direct) {
    const auto plan = read_plan(request);
    if (!plan.ok()) return plan.status();
    terms.plan = *plan;
  }
  if (!terms.by_id && terms.moved != Moved::none && scene.step && !repeated) {
    const Status plan = check_plan(request, scene);
    if (!plan.ok()) return plan;
  }
  if (terms.bytes() > bytes_max)
    return Status(Code::too_large, fmt::format("the push has {} bytes, at most {} are taken", terms.bytes(), bytes_max),
                  "start the service with a larger --bulk-bytes, or on a larger machine");
  return terms;
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
  std::string names;
  for (const auto& [name, dtype] : expected) names += fmt::format("{}{} {}", names.empty() ? "" : ", ", name, dtype);
  return Status(Code::invalid_argument, fmt::format("the slice of {} must have the arrays {}, each of shape [{}]",
                                                    name_of(slice.rank), names, slice.count));
}

void widen(std::span<const std::byte> floats, std::span<std::byte> doubles) {
  constexpr std::size_t kBlock = 1024;
  std::array<float, kBlock> block;
  const std::size_t count = doubles.size() / sizeof(double);
  for (std::size_t i = 0; i < count; i += kBlock) {  // a block is written no further than it was read
    const std::size_t size = std::min(kBlock, count - i);
    std::memcpy(block.data(), floats.data() + i * sizeof(float), size * sizeof(float));
    auto* to = reinterpret_cast<double*>(doubles.data()) + i;
    for (std::size_t k = 0; k < size; ++k) to[k] = static_cast<double>(block[k]);
  }
}

Result<Slice> PushSlices::begin_slice(const wire::Json& request, std::uint64_t bulk_bytes) const {
  if (const auto specs = wire::array_specs(request, bulk_bytes); !specs.ok()) return specs.status();
  const auto holds = request.contains("holds") ? wire::string_field(request, "holds", 16) : std::string("moved");
  if (!holds.ok()) return holds.status();
  const auto count = wire::integer_field(request, "count", 0, wire::kParticlesMax);
  if (!count.ok()) return count.status();
  const auto particles = static_cast<std::uint64_t>(*count);
  if (*holds != "moved") {
    const bool inserted = *holds == "inserted";
    const int which = inserted ? wire::kInsertedSlice : wire::kRemovedSlice;
    const std::uint64_t announced = inserted ? terms_.inserted : terms_.removed;
    if (!inserted && *holds != "removed")
      return Status(Code::invalid_argument, fmt::format("a slice holds moved, inserted or removed, not '{}'", *holds));
    if (particles == 0 || particles != announced || ranks_.contains(which))
      return Status(Code::invalid_argument,
                    fmt::format("a slice of {} {} particles, {} were announced once", particles, *holds, announced));
    return make_slice(request, bulk_bytes, terms_, which, particles);
  }
  const auto rank = wire::integer_field(request, "rank", 0, terms_.ranks - 1);
  if (!rank.ok()) return rank.status();
  if (terms_.direct)
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} belongs to its own listener", *rank));
  if (ranks_.contains(static_cast<int>(*rank)))
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} came twice", *rank));
  if (terms_.by_id && *rank != 0)
    return Status(Code::invalid_argument, fmt::format("order \"id\" has a slice for rank 0 alone, not {}", *rank));
  if (particles > terms_.moving - count_)
    return Status(Code::invalid_argument,
                  fmt::format("the slice of rank {} has {} particles, only {} of {} are still to come", *rank,
                              particles, terms_.moving - count_, terms_.moving));
  if (!terms_.counts.empty() && particles != terms_.counts[static_cast<std::size_t>(*rank)])
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} has {} particles, {} were announced", *rank,
                                                      particles, terms_.counts[static_cast<std::size_t>(*rank)]));
  return make_slice(request, bulk_bytes, terms_, static_cast<int>(*rank), particles);
}

Status PushSlices::add(Slice slice) {
  if (slice.rank >= 0) count_ += slice.count;
  ranks_.insert(slice.rank);
  slices_.push_back(std::move(slice));
  if (whole() && !terms_.direct && count_ != terms_.moving)
    return {Code::invalid_argument,
            fmt::format("the slices have {} particles together, {} were announced", count_, terms_.moving)};
  return {};
}

std::string PushSlices::progress() const { return fmt::format("{} of {} slices", slices_.size(), terms_.slices); }

}  // namespace rcb::net
