// The canonical bytes of a cut tree (docs/hash.md) and their hash.
#include <algorithm>
#include <bit>

#include <xxhash.h>

#include "common/cuts/cut_tree.hpp"

namespace rcb::cuts {
namespace {

constexpr char kMagic[8] = {'R', 'C', 'B', 'T', 'R', 'E', 'E', '1'};

}  // namespace

std::uint64_t CutTree::hash() const {
  const std::vector<std::byte> bytes = encode();
  return XXH3_64bits(bytes.data(), bytes.size());
}

std::vector<std::byte> CutTree::encode() const {
  std::vector<std::byte> out;
  const bool sized = !std::ranges::all_of(part_sizes, [&](double size) { return size == part_sizes[0]; });
  const auto axes = static_cast<std::size_t>(dims);
  out.reserve(24 + (sized ? part_sizes.size() * 8 : 0) + cuts.size() * (9 + 9 * axes));
  const auto put = [&out](auto value, unsigned bytes) {
    for (unsigned i = 0; i < bytes; ++i)
      out.push_back(static_cast<std::byte>(static_cast<std::uint64_t>(value) >> (8U * i)));
  };
  const auto put_double = [&put](double value) { put(std::bit_cast<std::uint64_t>(value + 0.0), 8); };
  for (const char c : kMagic) put(c, 1);
  put(dims, 4);
  put(method, 4);
  put(parts, 4);
  put(sized ? part_sizes.size() : 0, 4);
  if (sized)
    for (const double size : part_sizes) put_double(size);
  for (const Cut& cut : cuts) {
    for (std::size_t i = 0; i < axes; ++i) put(cut.axes[i], 1);
    put(cut.right_empty ? 0 : 1, 1);
    if (cut.right_empty) continue;
    for (std::size_t i = 0; i < axes; ++i) put_double(cut.key.at[i]);
    put(cut.key.id, 8);
  }
  return out;
}

}  // namespace rcb::cuts
