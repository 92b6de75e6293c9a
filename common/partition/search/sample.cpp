#include "common/partition/search/sample.hpp"

#include <algorithm>
#include <cstring>

#include "common/base/cpu.hpp"
#include "common/base/random.hpp"

namespace rcb::partition {

std::vector<std::size_t> pick(std::size_t count, std::uint64_t stride) {
  std::vector<std::size_t> slots;
  for (std::size_t begin = 0; begin < count; begin += stride)
    slots.push_back(begin + mix64(begin) % std::min<std::uint64_t>(stride, count - begin));
  return slots;
}

namespace {

constexpr int kToFirstRanksMax = 1024;

// gather: of bytes, collective.
template <typename Gather>
Sample sample_of(const particles::ParticleView& particles, std::span<const std::size_t> slots, const PartsOfSlots& part,
                 const Gather& gather) {
  const auto axes = static_cast<std::size_t>(particles.dims);
  // The message holds one array after the other.
  const std::size_t bytes_of_one = axes * sizeof(double) + (part ? sizeof(std::int32_t) : 0);
  Buffer<std::byte> mine(slots.size() * bytes_of_one);
  std::byte* to = mine.data();
  const auto send = [&](const auto* from) {
    for (const std::size_t slot : slots) {
      std::memcpy(to, from + slot, sizeof(*from));
      to += sizeof(*from);
    }
  };
  for (std::size_t a = 0; a < axes; ++a) send(particles.position[a]);
  if (part) send(part->data());
  Buffer<std::byte> all;
  std::vector<std::size_t> sizes;
  gather(mine.span(), all, sizes);

  Sample sample{.dims = particles.dims};
  for (std::size_t a = 0; a < axes; ++a) sample.position[a].resize(all.size() / bytes_of_one);
  if (part) sample.part.resize(sample.count());
  const std::byte* next = all.data();
  std::size_t begin = 0;
  for (const std::size_t size : sizes) {
    const std::size_t count = size / bytes_of_one;
    const auto take = [&](auto& values) {
      if (count > 0) std::memcpy(values.data() + begin, next, count * sizeof(values[0]));
      next += count * sizeof(values[0]);
    };
    for (std::size_t a = 0; a < axes; ++a) take(sample.position[a]);
    if (part) take(sample.part);
    begin += count;
  }
  return sample;
}

}  // namespace

Sample share_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                    const PartsOfSlots& part) {
  return sample_of(particles, slots, part,
                   [&](auto mine, auto& all, auto& sizes) { comm.all_gather(mine, all, sizes); });
}

Sample gather_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                     const PartsOfSlots& part) {
  // Taking a message from each of very many ranks, one by one, takes longer than an all-gather.
  if (comm.size() > kToFirstRanksMax) {
    Sample sample = share_sample(comm, particles, slots, part);
    return comm.rank() == 0 ? std::move(sample) : Sample{};
  }
  return sample_of(particles, slots, part,
                   [&](auto mine, auto& all, auto& sizes) { comm.gather(mine, 0, all, sizes); });
}

bool is_large(std::uint64_t count, int ranks, const BucketLimits& limits) {
  return count / static_cast<std::uint64_t>(ranks) >= limits.count_min;
}

// Within a cut tolerance the cuts depend on where a search begins. Buckets need weights on no rank, and on every rank
// the vector instructions that sort particles into them.
std::optional<LargeSetSample> sample_large_set(comm::Comm& comm, const particles::ParticleView& particles,
                                               const PartitionOptions& options, std::uint64_t& reductions) {
  const BucketLimits& limits = options.limits.buckets;
  if (options.parts < limits.parts_min || options.cut_tolerance > 0) return std::nullopt;
  std::vector<std::uint64_t> sums{particles.count, particles.weight != nullptr || !has_avx2() ? 1U : 0U};
  comm.all_sum(sums);
  ++reductions;
  const std::uint64_t count = sums[0];
  const auto pieces = static_cast<std::uint64_t>(comm.size()) * static_cast<std::uint64_t>(options.parts);
  if (sums[1] > 0 || !is_large(count, comm.size(), limits) || count / pieces < limits.per_part_min) return std::nullopt;
  const std::uint64_t wanted = std::clamp(count / limits.stride, limits.sample_min, limits.sample_max);
  LargeSetSample large{.stride = std::max<std::uint64_t>(count / wanted, 1)};
  large.sample = gather_sample(comm, particles, pick(particles.count, large.stride));
  ++reductions;
  return large;
}

}  // namespace rcb::partition
