#include "server/service/push/values.hpp"

#include <algorithm>
#include <bit>
#include <limits>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "common/base/check.hpp"
#include "common/particles/value_fault.hpp"
#include "server/service/context/collective.hpp"

namespace rcb::service {
namespace {

// True if any value is NaN or infinite; a loop without branches.
bool any_not_finite(const double* values, std::size_t count) {
  constexpr std::uint64_t kExponent = 0x7FF0000000000000U;
  std::uint64_t bad = 0;
  for (std::size_t i = 0; i < count; ++i)
    bad |= static_cast<std::uint64_t>((std::bit_cast<std::uint64_t>(values[i]) & kExponent) == kExponent);
  return bad != 0;
}

}  // namespace

bool bad_weights(const double* weight, std::size_t count) {
  std::uint64_t bad = 0;
  for (std::size_t i = 0; i < count; ++i)
    bad |= static_cast<std::uint64_t>(!((weight[i] >= 0) & (weight[i] <= std::numeric_limits<double>::max())));
  return bad != 0;
}

bool has_fault(const particles::ParticleView& view) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    if (any_not_finite(view.position[a], view.count)) return true;
  if (view.weight != nullptr && bad_weights(view.weight, view.count)) return true;
  return std::any_of(view.id, view.id + view.count, [](particles::Id id) { return id < 0; });
}

Status fault_in(comm::Comm& comm, const particles::ParticleView& view, bool has_ids) {
  std::uint64_t least = kNone;
  std::optional<particles::ValueFault> fault;
  const std::size_t looked_at = has_fault(view) ? view.count : 0;
  for (std::size_t i = 0; i < looked_at; ++i) {
    const particles::Id id = view.id[i];
    const std::uint64_t name = std::min(static_cast<std::uint64_t>(id), kNone - 1);  // below 0: the last
    auto found = particles::fault_of(view.point(i), view.dims, view.weight == nullptr ? 1 : view.weight[i], id);
    if (!found || name >= least) continue;
    least = name;
    fault = std::move(found);
    fault->particle = i;
  }
  std::uint64_t of_all = least;
  comm.all_min({&of_all, 1});
  RCB_CHECK(of_all != kNone, "the pass found a fault that isn't there");
  if (least != of_all) return agree_status(comm, {});
  return agree_status(
      comm, {fault->code,
             fmt::format("particle {}{}: {}", view.id[fault->particle], has_ids ? "" : " (index, from 0)", fault->text),
             fault->rule});
}

}  // namespace rcb::service
