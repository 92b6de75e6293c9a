// The interior particles of all ranks, from those of each: one message.
#include <bit>

#include "common/base/count_groups.hpp"
#include "common/base/index.hpp"
#include "common/comm/gather.hpp"
#include "common/partition/incremental/classify_interior.hpp"

namespace rcb::partition {

std::optional<Interior> sum_interior(comm::Comm& comm, const OwnInterior& own, OwnParts parts, const LoadSummary& loads,
                                     std::uint64_t most, std::uint64_t& boundary) {
  std::vector<std::uint64_t> counts = loads.counts;
  std::vector<u128> weights(counts.size(), 0);
  // The message: whether this rank has too many boundary particles; how many own parts have interior ones; the box of
  // the boundary particles; each such part and its box; then every part with boundary particles, their number and
  // weight.
  const std::size_t own_count = own.too_many ? 0 : own.part.size();
  const std::vector<std::uint64_t> listed =
      count_groups([&](std::size_t k) { return own.part[k]; }, counts.size(), own_count);
  const ExactScale scale(loads.scale_exponent);
  for (std::size_t k = 0; k < own_count && loads.weighted; ++k)
    weights[at(own.part[k])] += scale(own.boundary.weight[k]);
  std::vector<std::uint64_t> mine{own.too_many ? 1U : 0U, 0};
  const auto send = [&mine](const geometry::Box& box) {
    for (const double x : box.lo) mine.push_back(std::bit_cast<std::uint64_t>(x));
    for (const double x : box.hi) mine.push_back(std::bit_cast<std::uint64_t>(x));
  };
  geometry::Box boundary_box;
  for (std::size_t a = 0; a < at(own.boundary.dims); ++a)
    geometry::least_and_most({own.boundary.position[a].data(), own_count}, boundary_box.lo[a], boundary_box.hi[a]);
  send(boundary_box);
  for (std::size_t p = 0; p < own.boxes.size(); ++p) {
    if (own.boxes[p].empty(own.boundary.dims)) continue;
    ++mine[1];
    mine.push_back(at(parts.first) + p);
    send(own.boxes[p]);
  }
  for (std::size_t p = 0; p < listed.size(); ++p)
    if (listed[p] > 0)
      mine.insert(mine.end(), {p, listed[p], static_cast<std::uint64_t>(weights[p]),
                               static_cast<std::uint64_t>(weights[p] >> 64U)});
  const auto all = comm::all_gather_values<std::uint64_t>(comm, mine);

  // All particles but those on the boundary are interior.
  if (loads.weighted) weights = loads.loads;
  Interior interior;
  interior.boxes.assign(counts.size(), geometry::Box{});
  bool too_many = false;
  std::uint64_t total = 0;
  const std::uint64_t* word = all.values.data();
  for (const std::size_t words : all.counts) {
    const std::uint64_t* const end = word + words;
    too_many |= *word++ != 0;
    const auto take_box = [&word] {
      geometry::Box box;
      for (double& x : box.lo) x = std::bit_cast<double>(*word++);
      for (double& x : box.hi) x = std::bit_cast<double>(*word++);
      return box;
    };
    std::uint64_t boxes = *word++;
    interior.boundary.extend(take_box());
    for (; boxes > 0; --boxes) {
      geometry::Box& box = interior.boxes[*word++];
      box.extend(take_box());
    }
    for (; word < end; word += 4) {
      counts[word[0]] -= word[1];
      weights[word[0]] -= word[2] | (u128{word[3]} << 64U);
      total += word[1];
    }
  }
  boundary += total;
  if (too_many || total > most) return std::nullopt;
  interior.count_prefix.assign(1, 0);
  for (const std::uint64_t count : counts) interior.count_prefix.push_back(interior.count_prefix.back() + count);
  if (!loads.weighted) return interior;
  interior.weight_prefix.assign(1, 0);
  for (const u128 load : weights) interior.weight_prefix.push_back(interior.weight_prefix.back() + load);
  return interior;
}

}  // namespace rcb::partition
