// Byte-exact .npy files of every kind, and what the tests of readers ask.
#pragma once

#include <algorithm>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include <gtest/gtest.h>

#include "common/io/points.hpp"
#include "tests/support/directory.hpp"

namespace rcb::io::testing {

using rcb::testing::contents;
using rcb::testing::Directory;

struct NpyKind {
  int version = 1;
  bool fortran = false;
  bool big_endian = false;
  bool single = false;
};

inline std::string npy_with_header(int version, const std::string& dictionary) {
  std::string out = "\x93NUMPY";
  out += static_cast<char>(version);
  out += '\0';
  const std::string text = dictionary + "\n";
  for (int byte = 0; byte < (version == 1 ? 2 : 4); ++byte) out += static_cast<char>(text.size() >> (8 * byte) & 0xFFU);
  return out + text;
}

template <typename Number>
void put_number(std::string& out, double value, bool big_endian) {
  const auto number = static_cast<Number>(value);
  char bytes[sizeof(Number)];
  std::memcpy(bytes, &number, sizeof bytes);
  if (big_endian) std::reverse(bytes, bytes + sizeof bytes);
  out.append(bytes, sizeof bytes);
}

// values in C order, whatever the file's order.
inline std::string npy(const std::vector<std::size_t>& shape, const std::vector<double>& values, const NpyKind& kind) {
  std::string axes;
  for (const std::size_t length : shape) axes += std::to_string(length) + ", ";
  std::string out = npy_with_header(
      kind.version, std::string("{'descr': '") + (kind.big_endian ? ">" : "<") + (kind.single ? "f4" : "f8") +
                        "', 'fortran_order': " + (kind.fortran ? "True" : "False") + ", 'shape': (" + axes + "), }");
  std::vector<std::size_t> index(shape.size(), 0);
  for (std::size_t i = 0; i < values.size(); ++i) {
    // The i-th number in the file's order has this index; in Fortran order the first axis runs fastest.
    std::size_t rest = i;
    for (std::size_t a = 0; a < shape.size(); ++a) {
      const std::size_t axis = kind.fortran ? a : shape.size() - 1 - a;
      index[axis] = rest % shape[axis];
      rest /= shape[axis];
    }
    std::size_t at = 0;
    for (std::size_t a = 0; a < shape.size(); ++a) at = at * shape[a] + index[a];
    if (kind.single) {
      put_number<float>(out, values[at], kind.big_endian);
    } else {
      put_number<double>(out, values[at], kind.big_endian);
    }
  }
  return out;
}

// The message and the hint of a refusal, for looking at both; "" where nothing was refused.
template <typename R>
std::string refusal(const R& result) {
  if constexpr (std::is_same_v<R, Status>) {
    return result.ok() ? std::string() : result.message() + " | " + result.hint();
  } else {
    return result.ok() ? std::string() : result.status().message() + " | " + result.status().hint();
  }
}

inline bool has(const std::string& text, std::string_view part) { return text.find(part) != std::string::npos; }

// The whole file.
inline Result<Points> read_points(const std::string& path, const ReadOptions& options) {
  return read_points_slice(path, options, 0, 1);
}

// Slices 0..of-1 one after the other.
inline Points joined(const std::string& path, const ReadOptions& options, int of) {
  Points all;
  for (int k = 0; k < of; ++k) {
    const auto slice = read_points_slice(path, options, k, of);
    EXPECT_TRUE(slice.ok()) << refusal(slice);
    if (!slice.ok()) return all;
    all.dims = slice->dims;
    all.count += slice->count;
    all.position.resize(slice->position.size());
    for (std::size_t a = 0; a < slice->position.size(); ++a) {
      all.position[a].insert(all.position[a].end(), slice->position[a].begin(), slice->position[a].end());
    }
    all.id.insert(all.id.end(), slice->id.begin(), slice->id.end());
    all.weight.insert(all.weight.end(), slice->weight.begin(), slice->weight.end());
  }
  return all;
}

inline void expect_same(const Points& a, const Points& b) {
  EXPECT_EQ(a.dims, b.dims);
  EXPECT_EQ(a.count, b.count);
  EXPECT_EQ(a.position, b.position);
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.weight, b.weight);
}

}  // namespace rcb::io::testing
