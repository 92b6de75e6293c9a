#include "client/lib/session/content.hpp"

#include <atomic>

namespace rcb::client {
namespace {

template <typename T>
void add_strided(wire::BulkChecksum& sum, const T* values, std::size_t stride, std::size_t count) {
  if (stride == 1) return sum.add(std::as_bytes(std::span(values, count)));
  for (std::size_t i = 0; i < count; ++i) sum.add(std::as_bytes(std::span(values + i * stride, 1)));
}

template <typename T>
void add_by_rank(wire::BulkChecksum& sum, const layout::Layout& plan, std::span<const std::array<const T*, 3>> ranks,
                 std::size_t dims) {
  for (std::size_t rank = 0; rank < ranks.size() && rank < static_cast<std::size_t>(plan.ranks()); ++rank)
    for (std::size_t a = 0; a < dims; ++a)
      if (const std::size_t count = plan.rows(static_cast<int>(rank)).size(); ranks[rank][a] != nullptr)
        sum.add(std::as_bytes(std::span(ranks[rank][a], count)));
}

}  // namespace

void Content::add(const Positions& positions, const layout::Layout* plan) {
  const auto dims = static_cast<std::size_t>(positions.dims);
  add(positions.count);
  add(std::uint64_t{positions.single() ? 1U : 0U});
  if (positions.in_plan_order()) {
    add(positions.plan_version);
    if (plan == nullptr) {
      static std::atomic<std::uint64_t> unlike{0};
      return add(++unlike);
    }
    add_by_rank(sum_, *plan, std::span<const std::array<const double*, 3>>(positions.by_rank), dims);
    return add_by_rank(sum_, *plan, std::span<const std::array<const float*, 3>>(positions.by_rank_f4), dims);
  }
  for (std::size_t a = 0; positions.count > 0 && a < dims; ++a)
    if (positions.single())
      add_strided(sum_, positions.axis_f4[a], positions.stride, positions.count);
    else
      add_strided(sum_, positions.axis[a], positions.stride, positions.count);
}

void Content::add(const Insertion* inserted) {
  add(std::uint64_t{inserted == nullptr ? 0U : 1U});
  if (inserted == nullptr) return;
  add(inserted->positions, nullptr);
  add(inserted->ids);
  add(inserted->weights);
}

}  // namespace rcb::client
