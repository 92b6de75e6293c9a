// The canonical bytes of a cut tree (docs/hash.md), their hash, and the validation of decoded trees.
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

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

// A read past the end returns zero and makes good() false.
class Reader {
 public:
  explicit Reader(std::span<const std::byte> in) : in_(in) {}
  std::uint64_t u8() { return unsigned_of(1); }
  std::uint64_t u32() { return unsigned_of(4); }
  std::uint64_t u64() { return unsigned_of(8); }
  double f64() { return std::bit_cast<double>(u64()); }
  std::size_t left() const { return in_.size(); }
  bool good() const { return good_; }

 private:
  std::uint64_t unsigned_of(unsigned bytes) {
    if (in_.size() < bytes) {
      good_ = false;
      in_ = {};
      return 0;
    }
    std::uint64_t value = 0;
    for (unsigned i = 0; i < bytes; ++i) value |= std::to_integer<std::uint64_t>(in_[i]) << (8U * i);
    in_ = in_.subspan(bytes);
    return value;
  }
  std::span<const std::byte> in_;
  bool good_ = true;
};

Status bad(std::string message) {
  return {Code::invalid_argument, "cut tree: " + message, "the bytes are damaged or of another version"};
}

bool all_equal(std::span<const double> sizes) {
  for (const double size : sizes)
    if (size != sizes[0]) return false;
  return true;
}

bool is_permutation(const AxisOrder& axes, int dims) {
  unsigned seen = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(dims); ++i) {
    if (axes[i] < 0 || axes[i] >= dims) return false;
    seen |= 1U << static_cast<unsigned>(axes[i]);
  }
  return seen == (1U << static_cast<unsigned>(dims)) - 1U;
}

bool key_is_sound(const Key& key, int dims) {
  for (std::size_t i = 0; i < geometry::kDimsMax; ++i) {
    if (!std::isfinite(key.at[i])) return false;
    if (i >= static_cast<std::size_t>(dims) && key.at[i] != 0) return false;
  }
  return key.id >= 0;
}

// True if the cuts above `node` would lead a particle with its cut's key to it; the cut of a node that no particle can
// reach must have no key. A key between particles (key_between) is nobody's: only its first coordinate is checked.
bool key_lies_in_node(const CutTree& tree, const NodeRange& node) {
  const Cut& own = tree.cuts[static_cast<std::size_t>(node.node)];
  const bool between = !own.right_empty && own.key == key_between(own.key.at[0], tree.dims);
  Point position{};
  for (std::size_t i = 0; i < static_cast<std::size_t>(tree.dims); ++i)
    position[static_cast<std::size_t>(own.axes[i])] = own.key.at[i];
  for (NodeRange range = tree.root(); range.node != node.node;) {
    const Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
    const bool right = node.first >= range.middle();
    if (right && cut.right_empty) return own.right_empty;
    if (between && !cut.right_empty) {
      const double at = cut.key.at[0];
      if (cut.axes[0] == own.axes[0] && (right ? own.key.at[0] < at : own.key.at[0] > at)) return false;
    } else if (!own.right_empty && !cut.right_empty &&
               right == (key_of(position, own.key.id, cut.axes, tree.dims) < cut.key))
      return false;
    range = right ? range.right() : range.left();
  }
  return true;
}

Status validate_node(const CutTree& tree, const NodeRange& range) {
  if (range.leaf()) return {};
  const Cut& cut = tree.cuts[static_cast<std::size_t>(range.node)];
  const std::string where = "node " + std::to_string(range.node) + ": ";
  if (!is_permutation(cut.axes, tree.dims)) return bad(where + "its axis order is no permutation of the axes");
  if (!cut.right_empty && !key_is_sound(cut.key, tree.dims)) return bad(where + "its key is not finite or has id < 0");
  if (!key_lies_in_node(tree, range)) return bad(where + "its key lies outside the node");
  if (Status left = validate_node(tree, range.left()); !left.ok()) return left;
  return validate_node(tree, range.right());
}

}  // namespace

std::uint64_t CutTree::hash() const {
  const std::vector<std::byte> bytes = encode();
  return XXH3_64bits(bytes.data(), bytes.size());
}

Status CutTree::validate() const {
  if (dims < 1 || dims > geometry::kDimsMax) return bad("dims is not 1, 2 or 3");
  if (parts < 1) return bad("parts is less than 1");
  if (!has_cut_tree(method)) return bad("method " + std::string(method_name(method)) + " has no cuts");
  if (cuts.size() != static_cast<std::size_t>(parts) - 1) return bad("the number of cuts is not parts - 1");
  if (!part_sizes.empty() && part_sizes.size() != static_cast<std::size_t>(parts))
    return bad("the number of part sizes is not the number of parts");
  for (const double size : part_sizes)
    if (!std::isfinite(size) || !(size > 0)) return bad("a part size is not finite and > 0");
  return validate_node(*this, root());
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

Result<CutTree> CutTree::decode(std::span<const std::byte> bytes) {
  Reader reader(bytes);
  for (const char c : kMagic)
    if (reader.u8() != static_cast<unsigned char>(c)) return bad("the first 8 bytes are not RCBTREE1");
  const std::uint64_t dims = reader.u32();
  const std::uint64_t method = reader.u32();
  const std::uint64_t parts = reader.u32();
  const std::uint64_t sizes = reader.u32();
  if (!reader.good() || dims < 1 || dims > geometry::kDimsMax) return bad("dims is not 1, 2 or 3");
  if (method >= static_cast<std::uint64_t>(Method::file_order)) return bad("unknown method");
  if (parts < 1 || parts > static_cast<std::uint64_t>(std::numeric_limits<std::int32_t>::max()))
    return bad("bad number of parts");
  if (sizes != 0 && sizes != parts) return bad("the number of part sizes is not the number of parts");
  // Checked before anything is allocated: a message can't claim more parts than it has bytes for.
  if (sizes * 8 + (parts - 1) * (dims + 1) > reader.left()) return bad("it is cut short");
  CutTree tree;
  tree.dims = static_cast<int>(dims);
  tree.method = static_cast<Method>(method);
  tree.parts = static_cast<int>(parts);
  for (std::uint64_t i = 0; i < sizes; ++i) tree.part_sizes.push_back(reader.f64());
  if (sizes != 0 && all_equal(tree.part_sizes)) return bad("equal part sizes are written out");
  tree.cuts.resize(parts - 1);
  for (Cut& cut : tree.cuts) {
    for (std::size_t i = 0; i < dims; ++i) {
      const std::uint64_t axis = reader.u8();
      if (axis >= dims) return bad("there is no such axis");
      cut.axes[i] = static_cast<std::int8_t>(axis);
    }
    const std::uint64_t has_key = reader.u8();
    if (has_key > 1) return bad("a key flag is neither 0 nor 1");
    cut.right_empty = has_key == 0;
    if (cut.right_empty) continue;
    for (std::size_t i = 0; i < dims; ++i) {
      cut.key.at[i] = reader.f64();
      if (cut.key.at[i] == 0 && std::signbit(cut.key.at[i])) return bad("a key holds -0.0");
    }
    cut.key.id = static_cast<Id>(reader.u64());
  }
  if (!reader.good()) return bad("it is cut short");
  if (reader.left() != 0) return bad("bytes follow its end");
  if (Status status = tree.validate(); !status.ok()) return status;
  return tree;
}

}  // namespace rcb::partition
