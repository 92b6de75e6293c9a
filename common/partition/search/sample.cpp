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
Sample sample_of(const particles::ParticleView& particles, std::span<const std::size_t> slots,
                 const SampleFields& fields, const std::int32_t* part, const Gather& gather) {
  const auto axes = static_cast<std::size_t>(particles.dims);
  // The message holds one array after the other.
  const std::size_t bytes_of_one = axes * sizeof(double) + (fields.weights ? sizeof(double) : 0) +
                                   (fields.ids ? sizeof(particles::Id) : 0) + (fields.parts ? sizeof(std::int32_t) : 0);
  Buffer<std::byte> mine(slots.size() * bytes_of_one);
  std::byte* to = mine.data();
  const auto send = [&](const auto* from, auto otherwise) {
    for (const std::size_t slot : slots) {
      const auto value = from == nullptr ? otherwise : from[slot];
      std::memcpy(to, &value, sizeof(value));
      to += sizeof(value);
    }
  };
  for (std::size_t a = 0; a < axes; ++a) send(particles.position[a], 0.0);
  if (fields.weights) send(particles.weight, 1.0);
  if (fields.ids) send(particles.id, particles::Id{0});
  if (fields.parts) send(part, std::int32_t{0});
  Buffer<std::byte> all;
  std::vector<std::size_t> sizes;
  gather(mine.span(), all, sizes);

  Sample sample;
  sample.particles.dims = particles.dims;
  sample.particles.has_weights = fields.weights;
  sample.particles.resize(all.size() / bytes_of_one);
  if (fields.parts) sample.part.resize(sample.count());
  const std::byte* next = all.data();
  std::size_t begin = 0;
  for (const std::size_t size : sizes) {
    const std::size_t count = size / bytes_of_one;
    const auto take = [&](auto& values) {
      if (count > 0) std::memcpy(values.data() + begin, next, count * sizeof(values[0]));
      next += count * sizeof(values[0]);
    };
    for (std::size_t a = 0; a < axes; ++a) take(sample.particles.position[a]);
    if (fields.weights) take(sample.particles.weight);
    if (fields.ids) take(sample.particles.id);
    if (fields.parts) take(sample.part);
    begin += count;
  }
  return sample;
}

}  // namespace

Sample share_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                    const SampleFields& fields, const std::int32_t* part) {
  return sample_of(particles, slots, fields, part,
                   [&](auto mine, auto& all, auto& sizes) { comm.all_gather(mine, all, sizes); });
}

Sample gather_sample(comm::Comm& comm, const particles::ParticleView& particles, std::span<const std::size_t> slots,
                     const SampleFields& fields, const std::int32_t* part) {
  // Taking a message from each of very many ranks, one by one, takes longer than an all-gather.
  if (comm.size() > kToFirstRanksMax) {
    Sample sample = share_sample(comm, particles, slots, fields, part);
    return comm.rank() == 0 ? std::move(sample) : Sample{};
  }
  return sample_of(particles, slots, fields, part,
                   [&](auto mine, auto& all, auto& sizes) { comm.gather(mine, 0, all, sizes); });
}

bool may_sample(const PartitionOptions& options) {
  return options.parts >= options.limits.guess.parts_min && options.cut_tolerance == 0;
}

bool is_large(std::uint64_t count, int ranks, const GuessLimits& limits) {
  return count / static_cast<std::uint64_t>(ranks) >= limits.count_min;
}

// Buckets need weights on no rank, and on every rank the vector instructions that sort particles into them.
std::optional<LargeSetSample> sample_large_set(comm::Comm& comm, const particles::ParticleView& particles,
                                               const PartitionOptions& options, bool for_guess,
                                               std::uint64_t& reductions) {
  const GuessLimits& limits = options.limits.guess;
  std::vector<std::uint64_t> sums{particles.count, particles.weight != nullptr ? 1U : 0U, has_avx2() ? 0U : 1U};
  comm.all_sum(sums);
  ++reductions;
  LargeSetSample large{.count = sums[0], .has_weights = sums[1] > 0};
  const auto pieces = static_cast<std::uint64_t>(comm.size()) * static_cast<std::uint64_t>(options.parts);
  large.buckets = sums[1] + sums[2] == 0 && large.count / pieces >= limits.bucketed_min;
  if (!is_large(large.count, comm.size(), limits) || (!for_guess && !large.buckets)) return std::nullopt;
  const std::uint64_t wanted = std::clamp(large.count / limits.stride, limits.sample_min, limits.sample_max);
  large.stride = std::max<std::uint64_t>(large.count / wanted, 1);
  large.sample = gather_sample(comm, particles, pick(particles.count, large.stride),
                               {.weights = large.has_weights, .ids = for_guess});
  ++reductions;
  return large;
}

}  // namespace rcb::partition
