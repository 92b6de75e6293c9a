#include "common/cuts/calls.hpp"

#include <algorithm>
#include <exception>
#include <thread>
#include <vector>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/base/exceptions.hpp"
#include "common/base/index.hpp"
#include "common/base/signals.hpp"

namespace rcb::cuts {
namespace {

constexpr std::size_t kRowsEach = 16384;  // fewer rows than this are not worth a thread

}  // namespace

Status bad_call(std::string message) { return {Code::invalid_argument, std::move(message)}; }

Status check_call(const CutTree& tree, const Positions& positions, const OwnerOptions& options) {
  if (positions.dims != tree.dims)
    return bad_call(fmt::format("positions of {} dimensions, the cuts have {}", positions.dims, tree.dims));
  for (std::size_t a = 0; a < at(tree.dims) && positions.count > 0; ++a)
    if ((positions.single() ? static_cast<const void*>(positions.axis_f4[a]) : positions.axis[a]) == nullptr)
      return bad_call(fmt::format("no array for axis {}", kAxisNames[a]));
  if (positions.stride == 0) return bad_call("a stride of 0");
  if (!options.ids.empty() && options.ids.size() != positions.count)
    return bad_call(fmt::format("{} ids for {} positions", options.ids.size(), positions.count));
  if (!options.last_part.empty() && options.last_part.size() != positions.count)
    return bad_call(fmt::format("{} last parts for {} positions", options.last_part.size(), positions.count));
  if (options.threads < 1) return bad_call(fmt::format("{} threads", options.threads));
  return {};
}

Status check_room(const Positions& positions, std::span<std::int32_t> part) {
  return part.size() == positions.count
             ? Status()
             : bad_call(fmt::format("room for {} parts of {} positions", part.size(), positions.count));
}

std::size_t shares_of(std::size_t count, int threads) {
  return std::clamp<std::size_t>(count / kRowsEach, 1, at(threads));
}

Status share_rows(std::size_t count, std::size_t shares,
                  const std::function<Status(std::size_t, std::size_t, std::size_t)>& work) {
  std::vector<Status> status(shares);
  const auto run = [&](std::size_t k) {
    status[k] = without_exceptions([&] { return work(k, count * k / shares, count * (k + 1) / shares); });
  };
  std::vector<std::thread> threads;
  threads.reserve(shares);
  for (std::size_t k = 1; k < shares; ++k) try {
      const SignalsBlocked blocked;
      threads.emplace_back(run, k);
    } catch (const std::exception&) {  // no thread, or no memory for one
      run(k);
    }
  run(0);
  for (std::thread& thread : threads) thread.join();
  const auto bad = std::find_if(status.begin(), status.end(), [](const Status& one) { return !one.ok(); });
  return bad == status.end() ? Status() : *bad;
}

}  // namespace rcb::cuts
