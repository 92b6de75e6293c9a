#include "server/service/push/values.hpp"

#include <algorithm>
#include <bit>
#include <utility>

#include <fmt/format.h>

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

bool any_below_zero(const double* values, std::size_t count) {
  bool bad = false;
  for (std::size_t i = 0; i < count; ++i) bad |= values[i] < 0;
  return bad;
}

std::optional<ValueFault> fault_of(const particles::ParticleView& view, std::size_t i) {
  auto fault = particles::fault_of(view.point(i), view.dims, view.weight == nullptr ? 1 : view.weight[i],
                                   view.id == nullptr ? 0 : view.id[i]);
  if (fault) fault->particle = i;
  return fault;
}

bool suspicious(const particles::ParticleView& view) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    if (any_not_finite(view.position[a], view.count)) return true;
  if (view.weight != nullptr && (any_not_finite(view.weight, view.count) || any_below_zero(view.weight, view.count)))
    return true;
  return view.id != nullptr && std::any_of(view.id, view.id + view.count, [](particles::Id id) { return id < 0; });
}

}  // namespace

std::optional<ValueFault> first_fault(const particles::ParticleView& view) {
  if (!suspicious(view)) return std::nullopt;
  for (std::size_t i = 0; i < view.count; ++i)
    if (auto fault = fault_of(view, i)) return fault;
  return std::nullopt;
}

Status check_values(comm::Comm& comm, const particles::ParticleView& view, bool has_ids) {
  std::uint64_t least = kNone;
  std::optional<ValueFault> fault;
  if (suspicious(view))
    for (std::size_t i = 0; i < view.count; ++i) {
      auto found = fault_of(view, i);
      if (!found) continue;
      const std::uint64_t name = std::min(static_cast<std::uint64_t>(view.id[i]), kNone - 1);  // below 0: the last
      if (name < least) least = name, fault = std::move(found);
    }
  std::uint64_t global_least = least;
  comm.all_min({&global_least, 1});
  if (global_least == kNone) return {};
  Status mine;
  if (least == global_least)
    mine = {fault->code,
            fmt::format("particle {}{}: {}", view.id[fault->particle], has_ids ? "" : " (index, from 0)", fault->text),
            kGoodValues};
  return agree_status(comm, mine);
}

}  // namespace rcb::service
