// HDF5 datasets, made here with the same library: layouts, types, and what is refused.
#include <atomic>
#include <limits>

#include <gtest/gtest.h>
#include <hdf5.h>

#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using namespace testing;
using Column = std::vector<double>;

struct Kind {
  hid_t type = H5T_IEEE_F64LE;
  bool chunked = false;
  bool deflated = false;
};

// Writes values (C order) as the dataset of that name; unwritten: creates it only.
void add_dataset(hid_t file, const char* name, std::vector<hsize_t> shape, const std::vector<double>& values,
                 const Kind& kind, bool unwritten = false) {
  const hid_t space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr);
  const hid_t plist = H5Pcreate(H5P_DATASET_CREATE);
  const hid_t links = H5Pcreate(H5P_LINK_CREATE);
  H5Pset_create_intermediate_group(links, 1);
  if (kind.chunked) {
    std::vector<hsize_t> chunk = shape;
    chunk[0] = std::clamp<hsize_t>(chunk[0] / 3, 1, 65536);
    H5Pset_chunk(plist, static_cast<int>(chunk.size()), chunk.data());
  }
  if (kind.deflated) H5Pset_deflate(plist, 6);
  const hid_t dataset = H5Dcreate2(file, name, kind.type, space, links, plist, H5P_DEFAULT);
  if (!unwritten) {
    EXPECT_GE(H5Dwrite(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), 0);
  }
  H5Dclose(dataset);
  H5Pclose(links);
  H5Pclose(plist);
  H5Sclose(space);
}

class Hdf5 : public ::testing::Test {
 protected:
  std::string make(std::vector<hsize_t> shape, const std::vector<double>& values, const Kind& kind,
                   bool unwritten = false) {
    const std::string path = directory_ / "a.h5";
    const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    add_dataset(file, "/run/points", std::move(shape), values, kind, unwritten);
    H5Fclose(file);
    return path + ":/run/points";
  }
  Directory directory_;
};

TEST_F(Hdf5, EveryKind) {
  for (const hid_t type : {H5T_IEEE_F64LE, H5T_IEEE_F64BE, H5T_IEEE_F32LE, H5T_IEEE_F32BE}) {
    for (const int layout : {0, 1, 2}) {
      const std::string path = make({4, 2}, {1, 2, 3, 4, 5, 6, 7, .5}, {type, layout > 0, layout > 1});
      const auto points = read_points(path, {});
      ASSERT_TRUE(points.ok()) << refusal(points);
      EXPECT_EQ(points->position, (std::vector<Column>{{1, 3, 5, 7}, {2, 4, 6, .5}}));
      for (const int of : {2, 3, 7}) expect_same(joined(path, {}, of), *points);
      const auto weighted = read_points(path, {0, "0"});
      EXPECT_EQ(weighted->position, (std::vector<Column>{{2, 4, 6, .5}}));
      EXPECT_EQ(weighted->weight, (Column{1, 3, 5, 7}));
      const auto asked = read_points(path, {.weights = "0", .columns = {"1"}, .ids = "0"});
      ASSERT_TRUE(asked.ok()) << refusal(asked);
      EXPECT_EQ(asked->position, (std::vector<Column>{{2, 4, 6, .5}}));
      EXPECT_EQ(asked->id, (std::vector<std::int64_t>{1, 3, 5, 7}));
      EXPECT_EQ(asked->weight, (Column{1, 3, 5, 7}));
    }
  }
  const auto line = read_points(make({3}, {1, 2, 3}, {}), {});
  ASSERT_TRUE(line.ok()) << refusal(line);
  EXPECT_EQ(line->position, (std::vector<Column>{{1, 2, 3}}));
  EXPECT_EQ(read_points(make({0, 3}, {}, {}), {})->count, 0U);
  EXPECT_EQ(open_trajectory(make({3}, {1, 2, 3}, {}), {}).value()->frames(), 1U);
}

TEST_F(Hdf5, ManyRows) {
  std::vector<double> values(3 * 200000);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<double>(i % 1000);
  const std::string path = make({200000, 3}, values, {H5T_IEEE_F64LE, true, true});
  const auto points = read_points(path, {});
  ASSERT_TRUE(points.ok()) << refusal(points);
  for (std::size_t i = 0; i < 200000; ++i) ASSERT_EQ(points->position[2][i], values[3 * i + 2]);
  expect_same(joined(path, {}, 3), *points);
}

TEST_F(Hdf5, Refusals) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  const auto bad = read_points(make({3, 2}, {1, 2, 3, -inf, nan, 6}, {}), {});
  EXPECT_TRUE(has(refusal(bad), "a.h5:/run/points: -infinity at index (1, 1)")) << refusal(bad);
  EXPECT_EQ(bad.status().code(), Code::not_finite);
  EXPECT_TRUE(has(refusal(read_points(make({2, 2}, {1, 2, 3, -4}, {}), {0, "1"})), "weight -4"));
  EXPECT_TRUE(has(refusal(read_points(make({1, 4}, {1, 2, 3, 4}, {}), {})), "transpose"));
  EXPECT_TRUE(has(refusal(read_points(make({4, 4}, std::vector<double>(16), {}), {})), "--columns"));
  EXPECT_TRUE(has(refusal(read_points(make({2, 2}, {1, 2, 1, 4}, {}), {.ids = "0"})), "row 1 has the id 1 of row 0"));
  EXPECT_TRUE(has(refusal(read_points(make({1, 2}, {1.5, 2}, {}), {.ids = "0"})), "1.5 at index (0, 0) is not an id"));
  EXPECT_TRUE(has(refusal(read_points(make({1, 1, 1}, {1}, {}), {})), "has 3 axes"));
  EXPECT_TRUE(has(refusal(read_points(make({2, 2}, {1, 2, 3, 4}, {H5T_STD_I32LE, false, false}), {})), "not float32"));

  const std::string path = make({2, 2}, {1, 2, 3, 4}, {});
  const auto missing = read_points(directory_ / "a.h5:/run/none", {});
  EXPECT_EQ(missing.status().code(), Code::not_found);
  EXPECT_TRUE(has(refusal(missing), "it has /run/points")) << refusal(missing);
  EXPECT_TRUE(has(refusal(read_points(directory_ / "a.h5:/run", {})), "is not a dataset"));
  EXPECT_TRUE(has(refusal(read_points(directory_ / "a.h5", {})), "no dataset is named"));
  EXPECT_EQ(read_points(directory_ / "none.h5:/run", {}).status().code(), Code::not_found);
  directory_.write("text.h5", "1,2\n");
  EXPECT_TRUE(has(refusal(read_points(directory_ / "text.h5:/run", {})), "is not an HDF5 file"));
  EXPECT_TRUE(has(refusal(read_points(directory_ / ":/run", {})), "is a directory"));
}

TEST_F(Hdf5, ClaimsWithoutBytesAreRefused) {
  for (const bool chunked : {false, true}) {
    const std::string path = make({hsize_t{1} << 50U, 3}, {}, {H5T_IEEE_F64LE, chunked, chunked}, true);
    EXPECT_TRUE(has(refusal(read_points(path, {})), "needs more bytes than the 0")) << chunked;
  }
  EXPECT_FALSE(read_points(make({hsize_t{1} << 62U, 4}, {}, {H5T_IEEE_F32LE, false, false}, true), {2, ""}).ok());
}

TEST_F(Hdf5, AFileThatKillsItsReaderIsDamaged) {
  const std::string path = make({4, 2}, {1, 2, 3, 4, 5, 6, 7, 8}, {});
  const std::string good = testing::contents(directory_ / "a.h5");
  const std::size_t heap = good.find("HEAP");
  ASSERT_NE(heap, std::string::npos);
  for (const std::size_t field :
       {std::size_t{8}, std::size_t{24}}) {  // the size of the heap of names, and where it lies
    std::string bad = good;
    bad.replace(heap + field, 8, 8, '\xFF');
    directory_.write("a.h5", bad);
    for (const std::string& name : {path, directory_ / "a.h5"}) {
      const auto points = read_points(name, {});
      EXPECT_FALSE(points.ok());
      EXPECT_NE(points.status().code(), Code::internal) << refusal(points);
    }
  }
}

TEST_F(Hdf5, ReadingEndsAtTheOrderToStop) {
  const std::string path = make({4, 2}, {1, 2, 3, 4, 5, 6, 7, 8}, {});
  const std::atomic<bool> stop = true;
  ReadOptions options;
  options.stop = &stop;
  EXPECT_EQ(read_points(path, options).status().code(), Code::aborted);
}

TEST_F(Hdf5, RowsOfManyColumnsAreRefused) {
  const auto wide = read_points(make({3, 5000}, std::vector<double>(15000), {}), {3, ""});
  EXPECT_EQ(wide.status().code(), Code::too_large);
  EXPECT_TRUE(has(refusal(wide), "has 5000 columns")) << refusal(wide);
}

TEST_F(Hdf5, ChunksThatUnpackToTooLittleAreRefused) {
  // A chunk stored as is, though its shape needs more bytes: as a damaged index makes it.
  const std::string path = directory_ / "a.h5";
  for (const bool good : {true, false}) {
    const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    const hsize_t shape[2] = {4, 2}, offset[2] = {0, 0};
    const hid_t space = H5Screate_simple(2, shape, nullptr), plist = H5Pcreate(H5P_DATASET_CREATE);
    H5Pset_chunk(plist, 2, shape);
    H5Pset_shuffle(plist);
    H5Pset_deflate(plist, 6);
    H5Pset_fletcher32(plist);
    const hid_t dataset = H5Dcreate2(file, "p", H5T_IEEE_F64LE, space, H5P_DEFAULT, plist, H5P_DEFAULT);
    const std::vector<double> values(8, 1.5);
    H5Dwrite(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
    EXPECT_TRUE(good || H5Dwrite_chunk(dataset, H5P_DEFAULT, 7, offset, 24, values.data()) >= 0);
    H5Dclose(dataset);
    H5Pclose(plist);
    H5Sclose(space);
    H5Fclose(file);
    const auto points = read_points(path + ":/p", {});
    EXPECT_EQ(points.ok(), good) << refusal(points);
    EXPECT_EQ(has(refusal(points), "one of its chunks is damaged"), !good) << refusal(points);
  }
}

}  // namespace
}  // namespace rcb::io
