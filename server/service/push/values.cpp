#include "server/service/push/values.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <string>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
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

// Describes what is wrong with particle i; empty if nothing is.
std::string fault_of(const particles::ParticleView& view, std::size_t i) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    if (!std::isfinite(view.position[a][i])) return fmt::format("{} is {}", kAxisNames[a], view.position[a][i]);
  if (view.weight != nullptr && !(view.weight[i] >= 0 && std::isfinite(view.weight[i])))
    return fmt::format("weight is {}", view.weight[i]);
  if (view.id != nullptr && view.id[i] < 0) return fmt::format("id is {}", view.id[i]);
  return {};
}

bool suspicious(const particles::ParticleView& view) {
  for (std::size_t a = 0; a < static_cast<std::size_t>(view.dims); ++a)
    if (any_not_finite(view.position[a], view.count)) return true;
  if (view.weight != nullptr && (any_not_finite(view.weight, view.count) || any_below_zero(view.weight, view.count)))
    return true;
  return view.id != nullptr && std::any_of(view.id, view.id + view.count, [](particles::Id id) { return id < 0; });
}

}  // namespace

Status check_values(comm::Comm& comm, const particles::ParticleView& view, bool first, std::uint64_t first_row) {
  std::uint64_t least = kNone;
  std::size_t least_at = 0;
  if (suspicious(view))
    for (std::size_t i = 0; i < view.count; ++i) {
      if (fault_of(view, i).empty()) continue;
      const std::uint64_t name = first ? first_row + i : static_cast<std::uint64_t>(view.id[i]);
      if (name < least) least = name, least_at = i;
    }
  std::uint64_t global_least = least;
  comm.all_min({&global_least, 1});
  if (global_least == kNone) return {};
  Status mine;
  if (least == global_least) {
    const std::string fault = fault_of(view, least_at);
    const bool finite = fault.find("nan") == std::string::npos && fault.find("inf") == std::string::npos;
    mine = {finite ? Code::invalid_argument : Code::not_finite,
            first ? fmt::format("particle {} (index, from 0): {}", least, fault)
                  : fmt::format("particle {}: {}", least, fault),
            "positions must be finite, weights finite and >= 0, ids >= 0; the previous step stands"};
  }
  return agree_status(comm, mine);
}

}  // namespace rcb::service
