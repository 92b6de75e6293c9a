#include "common/partition/sample/sample.hpp"

#include <algorithm>

#include "common/base/index.hpp"
#include "common/base/random.hpp"
#include "common/comm/gather.hpp"

namespace rcb::partition {
namespace {

// Taking a message from each of more ranks, one by one, takes longer than an all-gather.
constexpr int kOneByOneMax = 1024;

}  // namespace

std::vector<std::size_t> sampled_slots(std::size_t count, std::uint64_t stride) {
  std::vector<std::size_t> slots;
  for (std::size_t begin = 0; begin < count; begin += stride)
    slots.push_back(begin + mix64(begin) % std::min<std::uint64_t>(stride, count - begin));
  return slots;
}

Sample gather_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                     std::optional<std::span<const std::int32_t>> part) {
  // A particle is a row: its coordinates and its part, which a double holds as well.
  const std::size_t dims = at(particles.dims);
  const std::size_t width = dims + (part ? 1 : 0);
  Buffer<double> mine(slots.size() * width);
  double* next = mine.data();
  for (const std::size_t slot : slots) {
    for (std::size_t a = 0; a < dims; ++a) *next++ = particles.position[a][slot];
    if (part) *next++ = (*part)[slot];
  }
  const std::span<const double> rows = mine.span();
  Buffer<double> all =
      comm.size() > kOneByOneMax ? comm::all_gather_values(comm, rows).values : comm::gather_values(comm, rows);
  if (comm.rank() != 0) all.resize(0);
  Sample sample;
  sample.dims = particles.dims;
  const std::size_t count = all.size() / width;
  for (std::size_t a = 0; a < dims; ++a) sample.position[a].resize(count);
  if (part) sample.part.resize(count);
  for (std::size_t k = 0; k < count; ++k) {
    for (std::size_t a = 0; a < dims; ++a) sample.position[a][k] = all[k * width + a];
    if (part) sample.part[k] = static_cast<std::int32_t>(all[k * width + dims]);
  }
  return sample;
}

}  // namespace rcb::partition
