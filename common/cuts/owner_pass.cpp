#include "common/cuts/owner_pass.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/base/index.hpp"
#include "common/cuts/kernels.hpp"

namespace rcb::cuts {
namespace {

constexpr std::size_t kWord = OwnerPass::kWord;  // rows that one word has a bit for
constexpr std::size_t kFew = Batch::kMost / 16;  // so few rows are classified one by one

template <typename T>
void copy_strided(const T* from, std::size_t stride, std::size_t count, double* to) {
  for (std::size_t i = 0; i < count; ++i) to[i] = from[i * stride];
}

template <typename T>
void copy_axes(const std::array<const T*, 3>& axis, std::size_t dims, std::size_t stride, std::size_t begin,
               std::size_t count, Batch& to) {
  for (std::size_t a = 0; a < dims; ++a)
    if (stride == 3)  // of known length, which is quicker
      copy_strided(axis[a] + begin * 3, 3, count, to.axis(a));
    else
      copy_strided(axis[a] + begin * stride, stride, count, to.axis(a));
}

template <typename T>
const Kernels::Rows<T>& row_kernels() {
  if constexpr (std::is_same_v<T, float>)
    return kernels().rows_f4;
  else
    return kernels().rows;
}

}  // namespace

void OwnerPass::load(std::size_t begin, std::size_t count) {
  const auto dims = at(positions_.dims);
  const bool in_place = !positions_.single() && positions_.stride == 1;
  if (positions_.single()) copy_axes(positions_.axis_f4, dims, positions_.stride, begin, count, batch_);
  if (!positions_.single() && !in_place) copy_axes(positions_.axis, dims, positions_.stride, begin, count, batch_);
  static constexpr std::array<double, Batch::kMost> kZeros{};
  for (std::size_t a = 0; a < x_.size(); ++a)
    x_[a] = a >= dims ? kZeros.data() : in_place ? positions_.axis[a] + begin : batch_.axis(a);
}

bool OwnerPass::read_rows(std::size_t begin, std::size_t count, std::int32_t* part) {
  const auto in_rows = [this](const auto& axis) { return axis[1] == axis[0] + 1 && axis[2] == axis[0] + 2; };
  if (positions_.dims != 3 || positions_.stride != 3 || !hinted()) return false;
  if (!(positions_.single() ? in_rows(positions_.axis_f4) : in_rows(positions_.axis))) return false;
  return positions_.single() ? read_triples(positions_.axis_f4[0] + 3 * begin, begin, count, part)
                             : read_triples(positions_.axis[0] + 3 * begin, begin, count, part);
}

template <typename T>
bool OwnerPass::read_triples(const T* rows, std::size_t begin, std::size_t count, std::int32_t* part) {
  const std::int32_t expected = expect(begin, count, part);
  if (expected >= 0 && row_kernels<T>().all_inside(rows, count, tables_.boxes[at(expected)])) {
    uniform_ = before_ = expected;
    return true;
  }
  Bits bits{};
  std::size_t undecided = 0;
  for (std::size_t w = 0; w * kWord < count; ++w) {
    bits[w] = row_kernels<T>().outside_own(rows + 3 * w * kWord, std::min(kWord, count - w * kWord),
                                           tables_.boxes.data(), part + w * kWord);
    undecided += static_cast<std::size_t>(std::popcount(bits[w]));
  }
  if (undecided > kFew || !decide(begin, bits, part)) return false;
  settle(count, part);
  return true;
}

// Decides the rows with a bit one by one. False: one of them isn't finite.
bool OwnerPass::decide(std::size_t begin, const Bits& bits, std::int32_t* part) const {
  for (std::size_t w = 0; w < bits.size(); ++w)
    for (std::uint64_t word = bits[w]; word != 0; word &= word - 1) {
      const std::size_t i = w * kWord + at(std::countr_zero(word));
      const Point x = positions_.point(begin + i);
      if (!(std::isfinite(x[0]) && std::isfinite(x[1]) && std::isfinite(x[2]))) return false;
      part[i] = tables_.tree.part_of(x, id(begin + i));
    }
  return true;
}

void OwnerPass::settle(std::size_t count, const std::int32_t* part) {
  uniform_ = all_equal(part, count) ? part[0] : -1;
  before_ = part[count - 1];
}

// Fills in the parts that are expected. Returns the one expected for all rows, or -1.
std::int32_t OwnerPass::expect(std::size_t begin, std::size_t count, std::int32_t* part) {
  std::int32_t expected = before_;
  if (!last_part_.empty()) {
    const std::int32_t* const last = last_part_.data() + begin;
    const bool one = all_equal(last, count);
    std::uint32_t most = 0;
    for (std::size_t i = 0; i < (one ? 1 : count); ++i) most = std::max(most, static_cast<std::uint32_t>(last[i]));
    if (most < static_cast<std::uint32_t>(tables_.tree.parts)) {  // else they are no parts of these cuts
      expected = last[0];
      if (!one && part != last) std::copy_n(last, count, part);
      if (!one) return -1;
      if (part == last) return expected;
    }
  }
  std::fill_n(part, count, expected);
  return expected;
}

// A bit for each row that is not strictly inside the region of part[i].
OwnerPass::Bits OwnerPass::outside(std::size_t count, const std::int32_t* part) const {
  Bits bits{};
  for (std::size_t w = 0; w * kWord < count; ++w) {
    const std::size_t size = std::min(kWord, count - w * kWord);
    const std::int32_t* const own = part + w * kWord;
    const bool one = uniform_ >= 0 || all_equal(own, size);
    if (one) bits[w] = kernels().outside(x(w * kWord), size, tables_.boxes[at(own[0])]);
    for (std::size_t a = 0; !one && a < at(positions_.dims); ++a)
      bits[w] |= tables_.regions.outside(a, {x_[a] + w * kWord, size}, own);
  }
  return bits;
}

Status OwnerPass::check_finite(std::size_t begin, std::size_t count) const {
  for (std::size_t w = 0; w * kWord < count; ++w) {
    const std::uint64_t bad =
        kernels().outside(x(w * kWord), std::min(kWord, count - w * kWord), geometry::Box::unbounded());
    if (bad == 0) continue;
    const std::size_t i = w * kWord + at(std::countr_zero(bad));
    std::size_t a = 0;
    while (std::isfinite(x_[a][i])) ++a;
    return {Code::not_finite, fmt::format("row {}: {} is {}: must be finite", begin + i, kAxisNames[a], x_[a][i])};
  }
  return {};
}

Status OwnerPass::read(std::size_t begin, std::size_t count, std::int32_t* part) {
  load(begin, count);
  Bits bits{};
  std::size_t undecided = count;
  const bool was_hinted = hinted();
  if (was_hinted) {
    uniform_ = expect(begin, count, part);
    bits = outside(count, part);
    undecided = 0;
    for (const std::uint64_t word : bits) undecided += static_cast<std::size_t>(std::popcount(word));
    if (undecided == 0) return {};
  }
  if (Status status = check_finite(begin, count); !status) return status;
  if (!was_hinted)
    unhinted_ = std::max(unhinted_ - 1, 0);
  else if (!last_part_.empty() && undecided > count / 2)
    unhinted_ = kUnhinted;
  if (undecided > kFew || !was_hinted) {
    for (std::size_t a = 0; a < at(positions_.dims); ++a)
      if (x_[a] != batch_.axis(a)) std::copy_n(x_[a], count, batch_.axis(a));
    tables_.classifier.classify(batch_, count, part, [this, begin](std::size_t i) { return id(begin + i); });
  } else {
    decide(begin, bits, part);
  }
  settle(count, part);
  return {};
}

}  // namespace rcb::cuts
