#include "common/cuts/owner_pass.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include <fmt/format.h>

#include "common/base/index.hpp"

namespace rcb::cuts {
namespace {

constexpr std::size_t kWord = 64;                // rows that one word has a bit for
constexpr std::size_t kFew = Batch::kMost / 16;  // so few rows are classified one by one

template <typename T>
void copy_strided(const T* from, std::size_t stride, std::size_t count, double* to) {
  for (std::size_t i = 0; i < count; ++i) to[i] = from[i * stride];
}

}  // namespace

void OwnerPass::load(std::size_t begin, std::size_t count) {
  const std::size_t stride = positions_.stride;
  for (std::size_t a = 0; a < at(positions_.dims); ++a) {
    if (!positions_.single() && stride == 1) {
      x_[a] = positions_.axis[a] + begin;
      continue;
    }
    if (positions_.single())
      copy_strided(positions_.axis_f4[a] + begin * stride, stride, count, batch_.axis(a));
    else if (stride == 3)  // of known length, so that the compiler makes vectors of it
      copy_strided(positions_.axis[a] + begin * 3, 3, count, batch_.axis(a));
    else
      copy_strided(positions_.axis[a] + begin * stride, stride, count, batch_.axis(a));
    x_[a] = batch_.axis(a);
  }
}

// Fills in the parts that are expected. Returns the one expected for all rows, or -1.
std::int32_t OwnerPass::expect(std::size_t begin, std::size_t count, std::int32_t* part) {
  std::int32_t expected = before_;
  if (!last_part_.empty()) {
    const std::int32_t* const last = last_part_.data() + begin;
    std::int32_t other = 0;
    std::uint32_t most = 0;
    for (std::size_t i = 0; i < count; ++i) {
      other |= last[i] ^ last[0];
      most = std::max(most, static_cast<std::uint32_t>(last[i]));
    }
    if (most < static_cast<std::uint32_t>(tables_.tree.parts)) {  // else they are no parts of these cuts
      expected = last[0];
      if (other != 0) {
        std::copy_n(last, count, part);
        return -1;
      }
    }
  }
  std::fill_n(part, count, expected);
  return expected;
}

Status OwnerPass::read(std::size_t begin, std::size_t count, std::int32_t* part) {
  load(begin, count);
  const auto dims = at(positions_.dims);
  uniform_ = expect(begin, count, part);
  std::array<std::uint64_t, Batch::kMost / kWord> outside{};
  std::size_t undecided = 0;
  for (std::size_t w = 0; w * kWord < count; ++w) {
    const std::size_t size = std::min(kWord, count - w * kWord);
    for (std::size_t a = 0; a < dims; ++a) {
      const std::span values(x_[a] + w * kWord, size);
      outside[w] |= uniform_ >= 0
                        ? outside_of(values, tables_.boxes[at(uniform_)].lo[a], tables_.boxes[at(uniform_)].hi[a])
                        : tables_.regions.outside(a, values, part + w * kWord);
    }
    undecided += static_cast<std::size_t>(std::popcount(outside[w]));
  }
  const auto id = [this, begin](std::size_t i) { return ids_.empty() ? static_cast<Id>(begin + i) : ids_[begin + i]; };
  for (std::size_t w = 0; w * kWord < count; ++w)
    for (std::uint64_t bits = outside[w]; bits != 0; bits &= bits - 1) {
      const std::size_t i = w * kWord + at(std::countr_zero(bits));
      if (Status status = check_finite(begin, i); !status) return status;
      if (undecided > kFew) continue;
      Point point{};
      for (std::size_t a = 0; a < dims; ++a) point[a] = x_[a][i];
      part[i] = tables_.tree.part_of(point, id(i));
    }
  if (undecided > kFew) {
    for (std::size_t a = 0; a < dims; ++a)
      if (x_[a] != batch_.axis(a)) std::copy_n(x_[a], count, batch_.axis(a));
    tables_.classifier.classify(batch_, count, part, id);
  }
  if (undecided > 0)
    uniform_ = std::all_of(part, part + count, [part](std::int32_t p) { return p == part[0]; }) ? part[0] : -1;
  if (count > 0) before_ = part[count - 1];
  return {};
}

Status OwnerPass::check_finite(std::size_t begin, std::size_t i) const {
  for (std::size_t a = 0; a < at(positions_.dims); ++a)
    if (!std::isfinite(x_[a][i]))
      return {Code::not_finite, fmt::format("row {}: axis {} is {}: must be finite", begin + i, a, x_[a][i])};
  return {};
}

}  // namespace rcb::cuts
