// The canonical bytes of a cut tree (docs/hash.md) and their hash.
#include <bit>

#include <xxhash.h>

#include "common/partition/tree/cut_tree.hpp"

namespace rcb::partition {
namespace {

constexpr char kMagic[8] = {'R', 'C', 'B', 'T', 'R', 'E', 'E', '1'};

class Writer {
 public:
  explicit Writer(std::vector<std::byte>& out) : out_(out) {}
  void u8(std::uint64_t value) { unsigned_of(value, 1); }
  void u32(std::uint64_t value) { unsigned_of(value, 4); }
  void u64(std::uint64_t value) { unsigned_of(value, 8); }
  void f64(double value) { u64(std::bit_cast<std::uint64_t>(value + 0.0)); }

 private:
  void unsigned_of(std::uint64_t value, unsigned bytes) {
    for (unsigned i = 0; i < bytes; ++i) out_.push_back(static_cast<std::byte>(value >> (8U * i)));
  }
  std::vector<std::byte>& out_;
};

bool all_equal(std::span<const double> sizes) {
  for (const double size : sizes)
    if (size != sizes[0]) return false;
  return true;
}

}  // namespace

std::uint64_t CutTree::hash() const {
  const std::vector<std::byte> bytes = encode();
  return XXH3_64bits(bytes.data(), bytes.size());
}

std::vector<std::byte> CutTree::encode() const {
  std::vector<std::byte> out;
  const bool sized = !all_equal(part_sizes);
  const auto axes = static_cast<std::size_t>(dims);
  out.reserve(24 + (sized ? part_sizes.size() * 8 : 0) + cuts.size() * (9 + 9 * axes));
  Writer writer(out);
  for (const char c : kMagic) writer.u8(static_cast<unsigned char>(c));
  writer.u32(static_cast<std::uint64_t>(dims));
  writer.u32(static_cast<std::uint64_t>(method));
  writer.u32(static_cast<std::uint64_t>(parts));
  writer.u32(sized ? part_sizes.size() : 0);
  if (sized)
    for (const double size : part_sizes) writer.f64(size);
  for (const Cut& cut : cuts) {
    for (std::size_t i = 0; i < axes; ++i) writer.u8(static_cast<std::uint64_t>(cut.axes[i]));
    writer.u8(cut.right_empty ? 0 : 1);
    if (cut.right_empty) continue;
    for (std::size_t i = 0; i < axes; ++i) writer.f64(cut.key.at[i]);
    writer.u64(static_cast<std::uint64_t>(cut.key.id));
  }
  return out;
}

}  // namespace rcb::partition
