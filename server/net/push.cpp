#include "server/net/push.hpp"

#include <array>
#include <limits>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::net {
namespace {}  // namespace

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

Status check_plan(const wire::Json& request, const SceneInfo& scene) {
  const Result<PlanId> plan = read_plan(request);
  if (!plan.ok()) return plan.status();
  if (plan->version == scene.plan_version && plan->checksum == scene.plan_checksum) return {};
  return {Code::stale_plan,
          fmt::format("the push follows plan {} ({}), the scene is at plan {} ({})", plan->version,
                      wire::hex64(plan->checksum), scene.plan_version, wire::hex64(scene.plan_checksum)),
          "fetch the plan and push again"};
}

// Names and types of the arrays that every slice of the push has, in this order.
std::vector<std::pair<std::string, std::string>> expected_arrays(const PushTerms& terms) {
  constexpr std::array kAxes{"x", "y", "z"};
  std::vector<std::pair<std::string, std::string>> arrays;
  for (int axis = 0; axis < terms.dims; ++axis) arrays.emplace_back(kAxes[static_cast<std::size_t>(axis)], "<f8");
  if (terms.weights) arrays.emplace_back("w", "<f8");
  if (terms.ids) arrays.emplace_back("id", "<i8");
  return arrays;
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
    if (!number.ok()) return number.status();
    id.session = wire::hex64(*number);
  }
  constexpr std::int64_t kMax = std::numeric_limits<std::int64_t>::max();
  const auto step = wire::integer_field(request, "step", 0, kMax);
  if (!step.ok()) return step.status();
  const auto attempt = wire::integer_field_or(request, "attempt", 0, kMax, 0);
  if (!attempt.ok()) return attempt.status();
  id.step = *step;
  id.attempt = *attempt;
  return id;
}

std::uint64_t PushTerms::bytes() const {
  return n * 8 * (static_cast<std::uint64_t>(dims) + (weights ? 1U : 0U) + (ids ? 1U : 0U));
}

Result<PushTerms> read_push_terms(const wire::Json& request, const PushId& id, const SceneInfo& scene, int ranks,
                                  std::uint64_t bytes_max) {
  PushTerms terms{.id = id, .ranks = ranks, .dims = scene.dims};
  const auto n = wire::integer_field(request, "n", 0, wire::kParticlesMax);
  if (!n.ok()) return n.status();
  terms.n = static_cast<std::uint64_t>(*n);
  const auto slices = wire::integer_field(request, "slices", 0, ranks);
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
  if (!terms.direct && terms.n > 0 && (terms.slices == 0 || (terms.by_id && terms.slices != 1)))
    return Status(Code::invalid_argument, fmt::format("field 'slices': {} can't carry {} particles in order \"{}\"",
                                                      terms.slices, terms.n, *order));
  if (scene.step && terms.n != scene.n)
    return Status(Code::invalid_argument,
                  fmt::format("the push has {} particles, scene '{}' has {}", terms.n, id.scene, scene.n),
                  "create the scene anew for another number of particles");
  if (terms.direct) {
    const auto plan = read_plan(request);
    if (!plan.ok()) return plan.status();
    terms.plan = *plan;
  }
  if (!terms.by_id && scene.step && id.step > *scene.step) {
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
  const auto expected = expected_arrays(terms);
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
  return Status(Code::invalid_argument, fmt::format("the slice of rank {} must have the arrays {}, each of shape [{}]",
                                                    slice.rank, names, slice.count));
}

Result<Slice> PushSlices::begin_slice(const wire::Json& request, std::uint64_t bulk_bytes) const {
  if (const auto specs = wire::array_specs(request, bulk_bytes); !specs.ok()) return specs.status();
  const auto rank = wire::integer_field(request, "rank", 0, terms_.ranks - 1);
  if (!rank.ok()) return rank.status();
  if (ranks_.contains(static_cast<int>(*rank)))
    return Status(Code::invalid_argument, fmt::format("the slice of rank {} came twice", *rank));
  if (terms_.by_id && *rank != 0)
    return Status(Code::invalid_argument, fmt::format("order \"id\" has a slice for rank 0 alone, not {}", *rank));
  const auto count = wire::integer_field(request, "count", 0, wire::kParticlesMax);
  if (!count.ok()) return count.status();
  const auto particles = static_cast<std::uint64_t>(*count);
  if (particles > terms_.n - count_)
    return Status(Code::invalid_argument,
                  fmt::format("the slice of rank {} has {} particles, only {} of {} are still to come", *rank,
                              particles, terms_.n - count_, terms_.n));
  return make_slice(request, bulk_bytes, terms_, static_cast<int>(*rank), particles);
}

Status PushSlices::add(Slice slice) {
  count_ += slice.count;
  ranks_.insert(slice.rank);
  slices_.push_back(std::move(slice));
  if (whole() && count_ != terms_.n)
    return {Code::invalid_argument,
            fmt::format("the slices have {} particles together, {} were announced", count_, terms_.n)};
  return {};
}

std::string PushSlices::progress() const { return fmt::format("{} of {} slices", slices_.size(), terms_.slices); }

}  // namespace rcb::net
