// Damaged files of every format: whatever bytes are cut off or flipped, a reader answers with points or a refusal that
// names the file; it never crashes, hangs, or takes memory that the file's length does not bear out. Slices of a
// file that is taken whole have its rows. RCB_FUZZ_TIMES=n: n times as many rounds, other ones each time.
#include <cmath>

#include <gtest/gtest.h>
#include <hdf5.h>

#include "common/base/random.hpp"
#include "tests/common/io/files.hpp"

#ifdef __SANITIZE_ADDRESS__
// libhdf5 1.10 forgets some of its own memory when a header turns out damaged half-way; ours stays watched.
extern "C" const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions() { return "leak:libhdf5"; }
#endif

namespace rcb::io {
namespace {

using namespace testing;

constexpr std::string_view kMeaningful = "0123456789,; \n\r\t#\"'-+.eEdDnNaAxX(){}:L";  // to some format

std::string damaged(Random& random, std::string bytes) {
  if (random.below(3) == 0) bytes.resize(random.below(bytes.size() + 1));
  const std::uint64_t flips = random.below(6);
  for (std::uint64_t i = 0; i < flips && !bytes.empty(); ++i) {
    char& byte = bytes[random.below(random.below(2) == 0 ? std::min<std::size_t>(bytes.size(), 200) : bytes.size())];
    switch (random.below(4)) {
      case 0:
        byte = static_cast<char>(byte ^ static_cast<char>(1U << random.below(8)));
        break;
      case 1:
        byte = static_cast<char>(random.next());
        break;
      case 2:
        byte = kMeaningful[random.below(kMeaningful.size())];
        break;
      default:
        byte = random.below(2) == 0 ? '\xFF' : '\0';
        break;
    }
  }
  return bytes;
}

void judge(const std::string& path, const ReadOptions& options) {
  const auto points = read_points(path, options);
  if (!points.ok()) {
    EXPECT_TRUE(has(refusal(points), "fuzz")) << refusal(points);
  } else {
    EXPECT_GE(points->dims, 1);
    EXPECT_LE(points->dims, 3);
    EXPECT_EQ(points->position.size(), static_cast<std::size_t>(points->dims));
    for (const auto& axis : points->position) {
      EXPECT_EQ(axis.size(), points->count);
      for (const double value : axis) EXPECT_TRUE(std::isfinite(value));
    }
    for (const std::int64_t id : points->id) EXPECT_GE(id, 0);
    testing::expect_same(joined(path, options, 3), *points);
  }
  const auto reader = open_trajectory(path, options);
  if (!reader.ok()) return;
  constexpr int kFramesMax = 8;
  for (int k = 0; k < kFramesMax; ++k) {
    const auto frame = reader.value()->next();
    if (!frame.ok()) {
      EXPECT_TRUE(has(refusal(frame), "fuzz")) << refusal(frame);
      break;
    }
    if (!*frame) break;
    EXPECT_EQ((*frame)->position.size(), static_cast<std::size_t>((*frame)->dims));
    for (const auto& axis : (*frame)->position) EXPECT_EQ(axis.size(), (*frame)->count);
  }
}

void fuzz(const std::string& good, std::string_view name, std::uint64_t seed, int rounds,
          const std::string& dataset = "") {
  const Directory directory;
  const char* times = std::getenv("RCB_FUZZ_TIMES");
  if (times != nullptr) rounds *= std::max(1, std::atoi(times));
  Random random(seed);
  for (int round = 0; round < rounds; ++round) {
    SCOPED_TRACE(::testing::Message() << "seed " << seed << " round " << round);
    const std::string path = directory.write(name, damaged(random, good));
    ReadOptions options{static_cast<int>(random.below(4)), random.below(3) == 0 ? "1" : ""};
    if (random.below(4) == 0) options.ids = "0";
    if (options.dims == 0 && random.below(2) == 0) options.columns = {"1", "y"};
    judge(path + dataset, options);
    if (::testing::Test::HasFailure()) {
      ADD_FAILURE() << contents(path).substr(0, 400);
      return;
    }
  }
}

TEST(Fuzz, Text) {
  fuzz("x,y,z,id\n1.5,2,-3e1,7\n# note\n\n+4,.5,6,8\r\n7,8,9,90\n", "fuzz.csv", 101, 1500);
  fuzz("1 2\n3 4\n5 6\n7 8\n", "fuzz.txt", 102, 1000);
  fuzz("3\nProperties=species:S:1:pos:R:3\nAr 1 2 3\nAr 4 5 6\nAr 7 8 9\n", "fuzz.xyz", 103, 1000);
}

TEST(Fuzz, Frames) {
  const std::string box = "ITEM: BOX BOUNDS pp pp pp\n0 1\n-1 1\n0 2\n";
  fuzz("ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\n" + box + "ITEM: ATOMS id xs ys z\n2 0 0 0\n1 1 1 1\n" +
           "ITEM: TIMESTEP\n9\nITEM: NUMBER OF ATOMS\n1\n" + box + "ITEM: ATOMS id xs ys z\n3 0.5 0 0\n",
       "fuzz.dump", 151, 1500);
  fuzz("2\nProperties=species:S:1:pos:R:3\nAr 1 2 3\nAr 4 5 6\n1\nc\nH 7 8 9\n", "fuzz.xyz", 152, 1000);
}

TEST(Fuzz, Npy) {
  std::string structured = npy_with_header(1,
                                           "{'descr': [('id', '<i4'), ('x', '<f8'), ('y', '>f4', (2,)), ('n', '|S3')], "
                                           "'fortran_order': False, 'shape': (3,), }");
  for (int row = 0; row < 3; ++row) {
    put_number<std::int32_t>(structured, row, false);
    put_number<double>(structured, 1.5, false);
    structured += std::string(11, '\0');
  }
  fuzz(structured, "fuzz.npy", 203, 1500);
  fuzz(npy({4, 3}, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}, {}), "fuzz.npy", 201, 1500);
  fuzz(npy({2, 3, 2}, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}, {2, true, true, true}), "fuzz.npy", 202, 1500);
}

TEST(Fuzz, Hdf5Data) {
  const Directory directory;
  const std::string path = directory / "good.h5";
  const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const hsize_t shape[2] = {8, 3}, chunk[2] = {4, 3};
  const std::vector<double> values(24, 1.5);
  const hid_t space = H5Screate_simple(2, shape, nullptr), plist = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_chunk(plist, 2, chunk);
  H5Pset_deflate(plist, 6);
  for (const hid_t layout : {static_cast<hid_t>(H5P_DEFAULT), plist}) {
    const hid_t dataset =
        H5Dcreate2(file, layout == plist ? "b" : "a", H5T_IEEE_F64LE, space, H5P_DEFAULT, layout, H5P_DEFAULT);
    H5Dwrite(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
    H5Dclose(dataset);
  }
  H5Pclose(plist);
  H5Sclose(space);
  H5Fclose(file);
  fuzz(contents(path), "fuzz.h5", 301, 150, ":/a");
  fuzz(contents(path), "fuzz.h5", 302, 150, ":/b");
}

}  // namespace
}  // namespace rcb::io
