// How the Refiner's brackets are narrowed by counting: one histogram for all nodes of a level, and further ones where
// many keys tie.
#include <algorithm>
#include <bit>
#include <cmath>

#include "common/base/check.hpp"
#include "common/partition/refine.hpp"

namespace rcb::partition {
namespace {

std::size_t at(int index) { return static_cast<std::size_t>(index); }

}  // namespace

// The axis that a key's word is of; kDimsMax: the id.
std::size_t Refiner::axis_of(const SelectNode& ask, std::size_t word) const {
  return word < at(rule_.axes()) ? at(ask.axes[word]) : std::size_t{geometry::kDimsMax};
}

std::size_t Refiner::open_word(const SelectNode& ask) const {
  std::size_t word = 0;
  while (word < at(rule_.axes()) && ask.lo[word] == ask.hi[word]) ++word;
  return word;
}

// How a bracket's open word is divided into bins: by its image, or evenly by its value (which suits the words behind
// the first: their range is the node's, often of many binades that hold nothing).
struct Refiner::Probe {
  std::uint64_t lo = 0;
  std::uint64_t span = 0;
  unsigned shift = 0;
  std::size_t axis = 0;
  std::size_t bins = 0;
  double base = 0;
  double scale = 0;  // > 0: by value

  std::size_t bin(std::uint64_t word) const {
    if (scale > 0) {
      const double steps = (geometry::value_of_image(word) - base) * scale;
      return static_cast<std::size_t>(std::clamp(steps, 0.0, static_cast<double>(bins - 1)));
    }
    return std::min(word - lo, span) >> shift;
  }
  // The least word of a bin at least `wanted`; one past the greatest word if there is none.
  std::uint64_t first_word(std::size_t wanted) const {
    std::uint64_t low = 0;  // bins rise with words: bisection is exact whatever the rounding
    std::uint64_t high = span + 1;
    while (low < high) {
      const std::uint64_t middle = low + (high - low) / 2;
      if (bin(lo + middle) >= wanted)
        high = middle;
      else
        low = middle + 1;
    }
    return lo + low;
  }
};

Refiner::Probe Refiner::probe_of(const SelectNode& ask, std::size_t bins) const {
  const std::size_t word = open_word(ask);
  Probe probe;
  probe.lo = ask.lo[word];
  probe.span = ask.hi[word] - ask.lo[word];
  probe.axis = axis_of(ask, word);
  probe.bins = bins;
  const auto width = static_cast<unsigned>(std::bit_width(probe.span));
  const auto bin_bits = static_cast<unsigned>(std::bit_width(bins) - 1);
  probe.shift = width > bin_bits ? width - bin_bits : 0;
  if (word > 0 && probe.axis < geometry::kDimsMax) {
    probe.base = geometry::value_of_image(ask.lo[word]);
    const double scale = static_cast<double>(bins) / (geometry::value_of_image(ask.hi[word]) - probe.base);
    if (std::isnormal(scale)) probe.scale = scale;
  }
  return probe;
}

// The bin of the histogram that holds the cut becomes the bracket.
void Refiner::take_bin(SelectNode& ask, const Probe& probe, std::size_t word,
                       std::span<const std::uint64_t> histogram) {
  std::size_t bin = 0;
  while (ask.rank >= histogram[bin]) {
    ask.rank -= histogram[bin];
    ++bin;
    CHECK(bin < probe.bins, "the bracket holds the cut");
  }
  ask.count = histogram[bin];
  ask.hi[word] = bin + 1 < probe.bins ? probe.first_word(bin + 1) - 1 : ask.hi[word];
  ask.lo[word] = bin > 0 ? probe.first_word(bin) : ask.lo[word];
}

void Refiner::sum_histogram() {
  for (std::size_t first = 0; first < histogram_.size(); first += kMessageWordsMax) {
    comm_.all_sum(histogram_.span().subspan(first, std::min(kMessageWordsMax, histogram_.size() - first)));
    ++rounds_;
    ++reductions_;
  }
}

// One reduction for all nodes of a level: the particles before each bracket, in it, and a histogram of the word that it
// leaves open. A bracket that holds the cut becomes the bin that does; where it misses asked[n] becomes -1.
void Refiner::count_and_narrow(std::span<SelectNode> questions, std::span<int> asked,
                               std::span<const Descent::Mover> movers) {
  const std::span<const GuessNode> nodes = guess_.nodes();
  // As many bins as one message holds; with many nodes about as many as balance the histogram and what is gathered.
  double inside_most = 0;
  for (const int g : asked) inside_most = std::max(inside_most, nodes[at(g)].expected);
  const auto balanced = static_cast<std::size_t>(std::min(std::sqrt(5 * inside_most), 256.0));
  const std::size_t bins = std::max(std::bit_ceil(std::max<std::size_t>(balanced, 16)),
                                    std::bit_floor(kMessageWordsMax / std::min(asked.size(), kMessageWordsMax)) / 2);
  const std::size_t cells = bins + 2;
  words_.clear();
  std::vector<Probe> probes;
  histogram_.resize(asked.size() * cells);
  std::fill(histogram_.begin(), histogram_.end(), 0);
  for (std::size_t n = 0; n < asked.size(); ++n) {
    probes.push_back(probe_of(questions[n], bins));
    words_.push_back(open_word(questions[n]));
    const GuessNode& node = nodes[at(asked[n])];
    for (std::size_t place = at(node.left); place < at(node.right); ++place)
      histogram_[n * cells] += descent_.tally(place).count + descent_.tally(place + at(descent_.nodes())).count;
    histogram_[n * cells + 1] = descent_.tally(at(asked[n] + descent_.nodes())).count;
  }
  for (const Descent::Mover& mover : movers) {
    const Probe& probe = probes[at(mover.place)];
    ++histogram_[at(mover.place) * cells + 2 + probe.bin(word_of(mover, probe.axis))];
  }
  sum_histogram();
  for (std::size_t n = 0; n < asked.size(); ++n) {
    const std::uint64_t below = histogram_[n * cells];
    const std::uint64_t inside = histogram_[n * cells + 1];
    counts_.stashed += inside;
    if (!bracket_holds(asked[n], below, inside)) {
      asked[n] = -1;
      continue;
    }
    const NodeRange& range = nodes[at(asked[n])].range;
    settled_[at(asked[n])] = 1;
    questions[n].rank = rule_.quota(range.first, range.middle()) - below;
    take_bin(questions[n], probes[n], words_[n], histogram_.span().subspan(n * cells + 2, bins));
  }
}

// The brackets of these become the exact bounds of their candidates, word by word: a word that all share is decided.
void Refiner::shrink(std::span<SelectNode> questions, std::span<const std::size_t> many,
                     std::span<const std::int32_t> slot, std::span<const Descent::Mover> movers) {
  const std::size_t words = at(rule_.axes()) + 1;
  std::vector<std::uint64_t> least(many.size() * words * 2, kNoImage);
  for (const std::uint32_t k : candidates_) {
    const std::size_t n = at(movers[k].place);
    if (slot[n] < 0) continue;
    std::uint64_t* own = &least[at(slot[n]) * words * 2];
    for (std::size_t w = 0; w < words; ++w) {
      const std::uint64_t word = word_of(movers[k], axis_of(questions[n], w));
      own[2 * w] = std::min(own[2 * w], word);
      own[2 * w + 1] = std::min(own[2 * w + 1], ~word);
    }
  }
  comm_.all_min(least);
  reductions_ += (least.size() + kMessageWordsMax - 1) / kMessageWordsMax;
  for (std::size_t m = 0; m < many.size(); ++m)
    for (std::size_t w = 0; w < words; ++w) {
      questions[many[m]].lo[w] = least[(m * words + w) * 2];
      questions[many[m]].hi[w] = ~least[(m * words + w) * 2 + 1];
    }
}

// Once more among the candidates, where they are too many to be gathered: ties, mostly. False if there was no need.
bool Refiner::narrow_again(std::span<SelectNode> questions, std::span<const Descent::Mover> movers) {
  if (questions.empty()) return false;
  // As the Selector: so few are gathered without a histogram.
  const std::size_t gathered_at_once =
      std::max<std::size_t>(256, std::bit_floor(kMessageWordsMax / std::min(questions.size(), kMessageWordsMax))) / 5;
  std::vector<std::int32_t> slot(questions.size(), -1);
  std::vector<std::size_t> many;
  for (std::size_t n = 0; n < questions.size(); ++n) {
    words_[n] = open_word(questions[n]);
    if (questions[n].count <= gathered_at_once) continue;
    slot[n] = static_cast<std::int32_t>(many.size());
    many.push_back(n);
  }
  if (many.empty()) return false;
  shrink(questions, many, slot, movers);
  for (const std::size_t n : many) words_[n] = open_word(questions[n]);
  const std::size_t bins =
      std::max<std::size_t>(64, std::bit_floor(kMessageWordsMax / std::min(many.size(), kMessageWordsMax)));
  std::vector<Probe> probes;
  for (const std::size_t n : many) probes.push_back(probe_of(questions[n], bins));
  histogram_.resize(many.size() * bins);
  std::fill(histogram_.begin(), histogram_.end(), 0);
  for (const std::uint32_t k : candidates_) {
    const std::int32_t own = slot[at(movers[k].place)];
    if (own < 0) continue;
    const Probe& probe = probes[at(own)];
    ++histogram_[at(own) * bins + probe.bin(word_of(movers[k], probe.axis))];
  }
  sum_histogram();
  for (std::size_t m = 0; m < many.size(); ++m)
    take_bin(questions[many[m]], probes[m], words_[many[m]], histogram_.span().subspan(m * bins, bins));
  return true;
}

}  // namespace rcb::partition
