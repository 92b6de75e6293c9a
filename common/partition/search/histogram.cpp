#include <bit>

#include "common/comm/wide_sum.hpp"
#include "common/partition/points/segment.hpp"
#include "common/partition/search/node_state.hpp"

namespace rcb::partition {
namespace {

// Cells side by side: a count of 8, 16, 32 or 64 bits, as many as the largest one needs; with weights a count and three
// limbs of a weight, of 64 bits each.
struct CellMessage {
  bool weighted;
  std::size_t bits;  // of a cell
  Buffer<std::uint64_t> words{};

  void clear(std::size_t cells) {
    words.resize((cells * bits + 63) / 64);
    std::ranges::fill(words, 0U);
  }
  void add(std::size_t cell, std::uint64_t count) { words[cell * bits / 64] += count << cell * bits % 64; }
  // Carries are propagated at once, so that no limb overflows, however many particles are added.
  void add(std::size_t cell, u128 weight) {
    std::uint64_t* const own = &words[cell * (1 + comm::kLimbs)];
    const std::span<std::uint64_t, comm::kLimbs> limbs(own + 1, comm::kLimbs);
    ++own[0];
    std::ranges::copy(comm::limbs_of(comm::value_of_limbs(limbs) + weight), limbs.begin());
  }
  Load load(std::size_t cell) const {
    const std::uint64_t* const own = &words[cell * bits / 64];
    if (weighted) return {own[0], comm::value_of_limbs(std::span<const std::uint64_t, comm::kLimbs>(own + 1, own + 4))};
    return {(own[0] >> cell * bits % 64) & (~std::uint64_t{0} >> (64 - bits)), 0};
  }
};

// Integers are multiples of 2^zeros: narrower bins would stay empty.
unsigned shift_of(const NodeState& node, std::size_t bins) {
  const auto bin_bits = static_cast<unsigned>(std::bit_width(bins) - 1);
  return std::max(shift_to(at(node.bracket.hi - node.bracket.lo), bin_bits), node.zeros());
}

void add_weights(const NodeState& node, unsigned shift, CellMessage& message, std::size_t cell) {
  node.note_pass(sizeof(QuantisedPoint) + sizeof(double));
  for (const Segment& segment : node.segments()) {
    const auto weight = [&](const QuantisedPoint& point) { return node.context.weight(segment.base + point.index); };
    for (const QuantisedPoint& point : segment.undecided())
      message.add(cell + 1 + (at(point.q[node.searched_axis()] - node.bracket.lo) >> shift), weight(point));
    if (!node.counts_outside) continue;
    for (const QuantisedPoint& point : std::span(segment.first, segment.middle)) message.add(cell, weight(point));
  }
}

//   even, odd  [bins], scratch
void add_counts(const NodeState& node, unsigned shift, CellMessage& message, std::size_t cell,
                std::span<std::uint64_t> even, std::span<std::uint64_t> odd) {
  node.note_pass(sizeof(QuantisedPoint));
  std::ranges::fill(even, 0U);
  std::ranges::fill(odd, 0U);
  for (const Segment& segment : node.segments()) {
    if (node.counts_outside) message.add(cell, at(segment.middle - segment.first));
    count_bins(segment.undecided(), node.searched_axis(), node.bracket.lo, shift, even, odd);
  }
  for (std::size_t b = 0; b < even.size(); ++b) message.add(cell + 1 + b, even[b] + odd[b]);
}

Crossing read(const NodeState& node, std::size_t bins, const CellMessage& message, std::size_t cell) {
  Crossing found;
  found.points_below = message.load(cell);
  Load sum = node.below + found.points_below;
  for (std::size_t b = 0; b < bins && (!found.bin || node.counts_outside); ++b) {
    const Load own = message.load(cell + 1 + b);
    if (!found.bin && node.reached(sum + own)) {
      found.bin = b;
      found.below = sum;
      found.inside = own;
    }
    sum += own;
  }
  found.points_within = sum - node.below - found.points_below;
  return found;
}

}  // namespace

// As many bins as fit in one message for all nodes, behind a cell for what lies below the bracket.
std::vector<Crossing> count_round(SearchContext& context, NodeStates nodes) {
  std::vector<Crossing> found;
  if (nodes.empty()) return found;
  ++context.cost.rounds;
  constexpr std::size_t kBits = comm::kMessageBytesMax * 8;
  const std::uint64_t most = std::ranges::max(nodes, {}, &NodeState::inside)->inside;
  CellMessage message{context.weighted(), context.weighted()
                                              ? 64 * (1 + comm::kLimbs)
                                              : std::max<std::size_t>(8, std::bit_ceil(at(std::bit_width(most))))};
  const std::size_t most_bins = context.weighted()
                                    ? std::min<std::size_t>(context.tuning.bins_max, Tuning::kWeightedBinsMax)
                                    : context.tuning.bins_max;
  const std::size_t fit = std::max<std::size_t>(kBits / (message.bits * nodes.size()), 1);
  const std::size_t bins = std::clamp(std::bit_floor(fit), std::min(Tuning::kBinsMin, most_bins), most_bins);
  std::vector<std::uint64_t> even(bins);
  std::vector<std::uint64_t> odd(bins);
  while (found.size() < nodes.size()) {
    const NodeStates rest = nodes.subspan(found.size());
    const NodeStates group = rest.first(std::clamp<std::size_t>(kBits / (bins * message.bits), 1, rest.size()));
    // Bins beyond the widest bracket would stay empty: they aren't sent.
    std::size_t used = 1;
    for (const NodeState* node : group)
      used = std::max(used, (at(node->bracket.hi - node->bracket.lo) >> shift_of(*node, bins)) + 1);
    message.clear(group.size() * (1 + used));
    for (std::size_t n = 0; n < group.size(); ++n) {
      const unsigned shift = shift_of(*group[n], bins);
      if (context.weighted())
        add_weights(*group[n], shift, message, n * (1 + used));
      else
        add_counts(*group[n], shift, message, n * (1 + used), std::span(even).first(used), std::span(odd).first(used));
    }
    context.comm.all_sum(message.words.span());
    ++context.cost.reductions;
    for (std::size_t n = 0; n < group.size(); ++n) {
      found.push_back(read(*group[n], used, message, n * (1 + used)));
      found.back().shift = shift_of(*group[n], bins);
    }
  }
  return found;
}

}  // namespace rcb::partition
