// .npy: every kind is read alike; hostile headers are refused before anything is allocated for them.
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using namespace testing;
using Column = std::vector<double>;

std::vector<NpyKind> all_kinds() {
  std::vector<NpyKind> kinds;
  for (const int version : {1, 2, 3}) {
    for (const bool fortran : {false, true}) {
      for (const bool big : {false, true}) {
        for (const bool single : {false, true}) kinds.push_back({version, fortran, big, single});
      }
    }
  }
  return kinds;
}

TEST(Npy, EveryKind) {
  const Directory directory;
  for (const NpyKind& kind : all_kinds()) {
    const std::string path = directory.write("a.npy", npy({3, 2}, {1, 2, 3, 4, 5, .5}, kind));
    const auto points = read_points(path, {});
    ASSERT_TRUE(points.ok()) << refusal(points);
    EXPECT_EQ(points->dims, 2);
    EXPECT_EQ(points->position, (std::vector<Column>{{1, 3, 5}, {2, 4, .5}}));
    for (const int of : {2, 3, 5}) expect_same(joined(path, {}, of), *points);
    const auto line = read_points(directory.write("b.npy", npy({3}, {1, 2, 3}, kind)), {});
    ASSERT_TRUE(line.ok()) << refusal(line);
    EXPECT_EQ(line->position, (std::vector<Column>{{1, 2, 3}}));
  }
}

TEST(Npy, ManyRowsInEveryOrder) {
  const Directory directory;
  Random random(3);
  std::vector<double> values(3 * 40001);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = random.uniform(i % 3 == 0 ? 0 : -1, 1);
  for (const bool fortran : {false, true}) {
    for (const bool big : {false, true}) {
      const std::string path = directory.write("a.npy", npy({40001, 3}, values, {1, fortran, big, false}));
      const auto points = read_points(path, {2, "0"});
      ASSERT_TRUE(points.ok()) << refusal(points);
      ASSERT_EQ(points->count, 40001U);
      std::size_t wrong = 0;
      for (std::size_t i = 0; i < 40001; ++i) {
        wrong += points->position[0][i] != values[3 * i + 1] || points->position[1][i] != values[3 * i + 2];
        wrong += points->weight[i] != values[3 * i];
      }
      EXPECT_EQ(wrong, 0U);
      for (const int of : {2, 7}) expect_same(joined(path, {2, "0"}, of), *points);
    }
  }
}

TEST(Npy, ColumnsAndDims) {
  const Directory directory;
  const std::string path = directory.write("a.npy", npy({2, 4}, {1, 2, 3, 4, 5, 6, 7, 8}, {}));
  EXPECT_TRUE(has(refusal(read_points(path, {})), "transpose"));
  const std::string turned = directory.write("w.npy", npy({3, 40}, std::vector<double>(120), {}));
  EXPECT_TRUE(has(refusal(read_points(turned, {3, ""})), "transpose"));
  EXPECT_EQ(read_points(turned, {.columns = {"0", "1"}})->count, 3U);
  const std::string tall = directory.write("t.npy", npy({4, 4}, std::vector<double>(16), {}));
  EXPECT_TRUE(has(refusal(read_points(tall, {})), "--columns 0,1,2"));
  const auto weighted = read_points(path, {0, "1"});
  ASSERT_TRUE(weighted.ok());
  EXPECT_EQ(weighted->position, (std::vector<Column>{{1, 5}, {3, 7}, {4, 8}}));
  EXPECT_EQ(weighted->weight, (Column{2, 6}));
  EXPECT_EQ(read_points(path, {1, ""})->position, (std::vector<Column>{{1, 5}}));
  EXPECT_TRUE(has(refusal(read_points(path, {0, "4"})), "no column '4'"));
  EXPECT_EQ(read_points(directory.write("e.npy", npy({0, 3}, {}, {})), {})->dims, 3);
  EXPECT_EQ(read_points(directory.write("e.npy", npy({0, 3}, {}, {})), {})->count, 0U);
  EXPECT_EQ(read_points(directory.write("e.npy", npy({0}, {}, {})), {})->count, 0U);
}

// {'id': i4 or u8, 'x': f4, 'y': f8, 'q': (2,) f4}, with a gap and text between; of either byte order.
std::string structured(const std::string& shape, int count, bool big, double bad_y = -3) {
  const std::string order = big ? ">" : "<";
  std::string file =
      npy_with_header(1, "{'descr': [('id', '" + order + "i4'), ('', '|V4'), (('Title', 'x'), '" + order +
                             "f4'), ('name', '<U1'), ('y', '" + order + "f8'), ('q', '" + order +
                             "f4', (2,)), ('n', '|u1')], 'fortran_order': False, 'shape': " + shape + ", }");
  for (int i = 0; i < count; ++i) {
    put_number<std::int32_t>(file, 10 * i, big);
    file += "....";
    put_number<float>(file, i + .5, big);
    file += std::string("n\0\0\0", 4);
    put_number<double>(file, i == 3 ? bad_y : -i, big);
    put_number<float>(file, 3, big);
    put_number<float>(file, i, big);
    file += static_cast<char>(200 + i);
  }
  return file;
}

TEST(Npy, StructuredArrays) {
  const Directory directory;
  for (const bool big : {false, true}) {
    const std::string path = directory.write("a.npy", structured("(5,)", 5, big));
    const auto points = read_points(path, {});
    ASSERT_TRUE(points.ok()) << refusal(points);
    EXPECT_EQ(points->position, (std::vector<Column>{{.5, 1.5, 2.5, 3.5, 4.5}, {0, -1, -2, -3, -4}}));
    EXPECT_EQ(points->id, (std::vector<std::int64_t>{0, 10, 20, 30, 40}));
    for (const int of : {2, 3, 7}) expect_same(joined(path, {}, of), *points);
    const auto asked = read_points(path, {.weights = "n", .columns = {"q:1", "id"}, .ids = "q:1"});
    EXPECT_TRUE(has(refusal(asked), "both ids and positions"));
    const auto others = read_points(path, {.weights = "n", .columns = {"Y", "id"}, .ids = "q:1"});
    ASSERT_TRUE(others.ok()) << refusal(others);
    EXPECT_EQ(others->position, (std::vector<Column>{{0, -1, -2, -3, -4}, {0, 10, 20, 30, 40}}));
    EXPECT_EQ(others->id, (std::vector<std::int64_t>{0, 1, 2, 3, 4}));
    EXPECT_EQ(others->weight, (Column{200, 201, 202, 203, 204}));
    EXPECT_TRUE(has(refusal(read_points(path, {.columns = {"name"}})), "its field 'name' holds neither"));
    const auto twice = read_points(path, {.columns = {"x"}, .ids = "q:0"});
    EXPECT_TRUE(has(refusal(twice), "a.npy: row 1 has the id 3 of row 0")) << refusal(twice);
    const auto nan = read_points(directory.write("b.npy", structured("(5,)", 5, big, NAN)), {});
    EXPECT_TRUE(has(refusal(nan), "b.npy: NaN at index (3,) of field 'y'")) << refusal(nan);
    const auto reader = open_trajectory(directory.write("t.npy", structured("(2, 3)", 6, big, 1)), {});
    ASSERT_TRUE(reader.ok()) << refusal(reader);
    EXPECT_EQ(reader.value()->frames(), 2U);
    ASSERT_TRUE(reader.value()->next().ok());
    const auto second = reader.value()->next();
    ASSERT_TRUE(second.ok() && *second);
    EXPECT_EQ((*second)->position, (std::vector<Column>{{3.5, 4.5, 5.5}, {1, -4, -5}}));
    EXPECT_EQ((*second)->id, (std::vector<std::int64_t>{30, 40, 50}));
  }
}

TEST(Npy, ColumnsAndIdsByNumber) {
  const Directory directory;
  const auto options = [](std::vector<std::string> columns, std::string ids) {
    return ReadOptions{.columns = std::move(columns), .ids = std::move(ids)};
  };
  for (const NpyKind& kind : all_kinds()) {
    const std::string path = directory.write("a.npy", npy({2, 4}, {1, 2, 3, 4, 5, 6, 7, 8.5}, kind));
    const auto points = read_points(path, options({"3", "0"}, "1"));
    ASSERT_TRUE(points.ok()) << refusal(points);
    EXPECT_EQ(points->position, (std::vector<Column>{{4, 8.5}, {1, 5}}));
    EXPECT_EQ(points->id, (std::vector<std::int64_t>{2, 6}));
    EXPECT_EQ(read_points(path, options({}, "3")).status().message(), path + ": 8.5 at index (1, 3) is not an id");
    const auto frame = open_trajectory(directory.write("t.npy", npy({1, 2, 2}, {1, 2, 3, 4}, kind)), options({}, "0"));
    ASSERT_TRUE(frame.ok()) << refusal(frame);
    EXPECT_EQ((*frame.value()->next())->id, (std::vector<std::int64_t>{1, 3}));
  }
  for (const double id : {-1.0, 0.5, 9007199254740992.0, 1e300, double(NAN)})
    EXPECT_TRUE(
        has(refusal(read_points(directory.write("b.npy", npy({1, 2}, {id, 2}, {})), options({}, "0"))), "an id"))
        << id;
  EXPECT_TRUE(has(refusal(read_points(directory.write("b.npy", npy({1, 2}, {16777216, 2}, {1, false, false, true})),
                                      options({}, "0"))),
                  "an id"));
}

TEST(Npy, WhatIsNotFiniteIsNamedByItsIndex) {
  const Directory directory;
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  for (const NpyKind& kind : all_kinds()) {
    const std::string path = directory.write("a.npy", npy({4, 2}, {1, 2, 3, 4, 5, inf, nan, 8}, kind));
    const auto points = read_points(path, {});
    EXPECT_TRUE(has(refusal(points), "a.npy: infinity at index (2, 1)")) << refusal(points);
    EXPECT_EQ(points.status().code(), Code::not_finite);
    const auto slice = read_points_slice(path, {}, 3, 4);
    EXPECT_TRUE(has(refusal(slice), "a.npy: NaN at index (3, 0)")) << refusal(slice);
    EXPECT_TRUE(read_points(path, {1, ""}).status().code() == Code::not_finite);
  }
  const std::string path = directory.write("w.npy", npy({2, 2}, {1, 2, 3, -1}, {}));
  EXPECT_TRUE(has(refusal(read_points(path, {0, "1"})), "the weight -1, which is negative, at index (1, 1)"));
}

TEST(Npy, CutFilesSayWhatIsMissing) {
  const Directory directory;
  const std::string good = npy({3, 2}, {1, 2, 3, 4, 5, 6}, {});
  for (std::size_t length = 0; length < good.size(); ++length) {
    const auto points = read_points(directory.write("a.npy", std::string_view(good).substr(0, length)), {});
    ASSERT_FALSE(points.ok()) << length;
    EXPECT_TRUE(has(refusal(points), "a.npy: ")) << refusal(points);
  }
  const auto cut = read_points(directory.write("a.npy", std::string_view(good).substr(0, good.size() - 5)), {});
  EXPECT_TRUE(has(refusal(cut), "needs 48 bytes of data, 43 found")) << refusal(cut);
  const auto longer = read_points(directory.write("a.npy", good + "x"), {});
  EXPECT_TRUE(has(refusal(longer), "needs 48 bytes of data, 49 found")) << refusal(longer);
}

TEST(Npy, HostileHeaders) {
  const Directory directory;
  const auto refuse = [&](const std::string& dictionary, std::string_view words) {
    const auto points = read_points(directory.write("a.npy", npy_with_header(1, dictionary) + "01234567"), {});
    EXPECT_TRUE(has(refusal(points), words)) << dictionary << ": " << refusal(points);
    EXPECT_FALSE(open_trajectory(directory / "a.npy", {}).ok());
  };
  const std::string type = "{'descr': '<f8', 'fortran_order': False, 'shape': ";
  refuse(type + "(9223372036854775807, 3), }", "needs more than any file can have");
  refuse(type + "(4294967296, 4294967296), }", "more than any file");
  refuse(type + "(2305843009213693952, 2), }", "more than any file");                       // 2^64 bytes: wraps to 0
  refuse(type + "(2305843009213693953, 1), }", "more than any file");                       // wraps to 8
  refuse(type + "(4611686018427387904, 9223372036854775808, 1), }", "more than any file");  // 2^128
  refuse(type + "(18446744073709551616,), }", "can't be read");
  refuse(type + "(-1,), }", "can't be read");
  refuse(type + "(), }", "is not (n,)");
  refuse(type + "(1, 1, 1, 1), }", "is not (n,)");
  refuse(type + "(1,, 1), }", "can't be read");
  refuse(type + "(0, 18446744073709551615), }", "needs 0 bytes of data, 8 found");
  refuse("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", "'|O' is not float32 or float64");
  refuse("{'descr': '<i8', 'fortran_order': False, 'shape': (1,), }", "'<i8' is not float32 or float64");
  refuse("{'descr': '<f16', 'fortran_order': False, 'shape': (1,), }", "is not float32 or float64");
  const auto structured = [&](const std::string& fields, std::string_view words) {
    refuse("{'descr': [" + fields + "], 'fortran_order': False, 'shape': (1,), }", words);
  };
  structured("('x', '<f8'), ('y', '<f8')", "needs 16 bytes of data, 8 found");
  structured("('x', '|O')", "field 'x' is of the type '|O', which isn't known");
  structured("('x', '|S8')", "field 'x' holds neither float32, float64 nor integers");
  structured("('x', '<f4', (2,))", "named x:0, x:1, not x");
  structured("('a', '<f8')", "its columns are named a, not x, y and z");
  structured("('x', '<f8', (4611686018427387904, 4))", "isn't known");
  structured("('x', '<f8', (0,))", "no fields");
  structured("('', '|V8')", "no fields");
  structured("", "is not float32");
  for (const char* broken :
       {"('x' '<f8')", "('x',", "'x'", "('x', [('y', '<f8')])", "('x', '<f8', 3)", "(('x', '<f8')"})
    structured(broken, "can't be read");
  refuse("{'descr': '<f8', 'fortran_order': 0, 'shape': (1,), }", "can't be read");
  refuse("{'descr': '<f8', 'fortran_order': False}", "can't be read");
  refuse("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'descr': '<f4'}", "can't be read");
  refuse("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), } + 1", "can't be read");
  refuse("", "can't be read");
  refuse(std::string(3000, '{'), "can't be read");

  const std::string empty = npy_with_header(2, type + "(0, 1000000000000000), }");
  EXPECT_FALSE(read_points(directory.write("a.npy", empty), {}).ok());
  const std::string none = npy_with_header(2, type + "(1000000000000000, 0), }");
  EXPECT_FALSE(read_points(directory.write("a.npy", none), {}).ok());
  const std::string frames = npy_with_header(2, type + "(1000000000000000, 0, 3), }");
  EXPECT_FALSE(open_trajectory(directory.write("a.npy", frames), {}).ok());
  std::string length = "\x93NUMPY";
  length += std::string("\x02\x00\xFF\xFF\xFF\xFF", 6);
  EXPECT_TRUE(has(refusal(read_points(directory.write("a.npy", length), {})), "ends inside its header"));
  EXPECT_TRUE(has(refusal(read_points(directory.write("a.npy", "1,2\n"), {})), "is not an .npy file"));
  EXPECT_TRUE(
      has(refusal(read_points(directory.write("a.npy", npy_with_header(9, "{}")), {})), "unknown .npy version"));
}

TEST(Npy, OlderSpellings) {
  const Directory directory;
  std::string file = npy_with_header(1, "{\"shape\":(2L,), \"fortran_order\":False, \"descr\":\"<f8\"}");
  testing::put_number<double>(file, 7, false);
  testing::put_number<double>(file, 8, false);
  const auto points = read_points(directory.write("a.dat", file), {});
  ASSERT_TRUE(points.ok()) << refusal(points);
  EXPECT_EQ(points->position, (std::vector<Column>{{7, 8}}));
}

TEST(Npy, ATrajectoryOfOneStepIsAPointFile) {
  const Directory directory;
  const std::string path = directory.write("t.npy", npy({1, 2, 3}, {1, 2, 3, 4, 5, 6}, {}));
  const auto points = read_points(path, {});
  ASSERT_TRUE(points.ok()) << refusal(points);
  EXPECT_EQ(points->position, (std::vector<Column>{{1, 4}, {2, 5}, {3, 6}}));
  for (const int of : {2, 3}) expect_same(joined(path, {}, of), *points);
}

TEST(Trajectory, FramesOfEveryKind) {
  const Directory directory;
  std::vector<double> values(5 * 4 * 3);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<double>(i);
  for (const NpyKind& kind : all_kinds()) {
    const auto reader = open_trajectory(directory.write("t.npy", npy({5, 4, 3}, values, kind)), {});
    ASSERT_TRUE(reader.ok()) << refusal(reader);
    EXPECT_EQ(reader.value()->frames(), 5U);
    for (std::uint64_t k = 0; k < 5; ++k) {
      const auto next = reader.value()->next();
      ASSERT_TRUE(next.ok() && *next) << refusal(next);
      const Points& frame = **next;
      ASSERT_EQ(frame.dims, 3);
      ASSERT_EQ(frame.count, 4U);
      for (std::size_t i = 0; i < 4; ++i) {
        for (std::size_t a = 0; a < 3; ++a) EXPECT_EQ(frame.position[a][i], values[(k * 4 + i) * 3 + a]);
      }
    }
    EXPECT_FALSE(reader.value()->next()->has_value());
  }
}

TEST(Trajectory, IsCheckedWholeWhenOpened) {
  const Directory directory;
  std::vector<double> values(3 * 20000 * 2, 1);
  values[(2 * 20000 + 19999) * 2 + 1] = std::numeric_limits<double>::quiet_NaN();
  for (const NpyKind& kind : all_kinds()) {
    const auto reader = open_trajectory(directory.write("t.npy", npy({3, 20000, 2}, values, kind)), {});
    EXPECT_TRUE(has(refusal(reader), "t.npy: frame 2: NaN at index (2, 19999, 1)")) << refusal(reader);
  }
  const std::string cut = npy({3, 2, 2}, std::vector<double>(12, 1), {});
  EXPECT_TRUE(has(refusal(open_trajectory(directory.write("t.npy", cut.substr(0, cut.size() - 1)), {})), "95 found"));
  EXPECT_TRUE(has(refusal(read_points(directory.write("t.npy", cut), {})), "use replay"));
}

TEST(Trajectory, AnyOtherFileIsOneFrame) {
  const Directory directory;
  const auto reader = open_trajectory(directory.write("p.csv", "x,y,id\n1,2,9\n"), {});
  ASSERT_TRUE(reader.ok());
  EXPECT_EQ(reader.value()->frames(), 1U);
  const auto frame = reader.value()->next();
  ASSERT_TRUE(frame.ok() && *frame);
  EXPECT_EQ((*frame)->id, std::vector<std::int64_t>{9});
  EXPECT_FALSE(reader.value()->next()->has_value());
  EXPECT_FALSE(open_trajectory(directory / "none.npy", {}).ok());
  EXPECT_EQ(open_trajectory(directory.write("q.npy", npy({4, 2}, std::vector<double>(8, 1), {})), {}).value()->frames(),
            1U);
}

}  // namespace
}  // namespace rcb::io
