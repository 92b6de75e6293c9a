#include "client/lib/session/content.hpp"

namespace rcb::client {
namespace {

template <typename T>
void add_strided(wire::BulkChecksum& sum, const T* values, std::size_t stride, std::size_t count) {
  if (stride == 1) return sum.add(std::as_bytes(std::span(values, count)));
  for (std::size_t i = 0; i < count; ++i) sum.add(std::as_bytes(std::span(values + i * stride, 1)));
}

}  // namespace

void Content::add(const Positions& positions) {
  const auto dims = static_cast<std::size_t>(positions.dims);
  add(positions.count);
  add(std::uint64_t{positions.single() ? 1U : 0U});
  for (std::size_t a = 0; positions.count > 0 && a < dims; ++a)
    if (positions.single())
      add_strided(sum_, positions.axis_f4[a], positions.stride, positions.count);
    else
      add_strided(sum_, positions.axis[a], positions.stride, positions.count);
}

}  // namespace rcb::client
