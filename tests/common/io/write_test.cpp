// What is written is read back bit for bit; a file appears whole or not at all.
#include <array>
#include <csignal>
#include <limits>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/random.hpp"
#include "common/io/files/output_file.hpp"
#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

using namespace testing;
using Column = std::vector<double>;

Status write_csv(const std::string& path, int dims, std::span<const double* const> position, std::size_t count,
                 std::optional<std::span<const std::int64_t>> id, std::optional<std::span<const double>> weight) {
  auto file = OutputFile::create(path);
  if (!file.ok()) return file.status();
  CsvWriter writer(std::move(*file), dims, id.has_value(), weight.has_value());
  if (Status status = writer.append(position, count, id.value_or(std::span<const std::int64_t>()),
                                    weight.value_or(std::span<const double>()));
      !status.ok())
    return status;
  return writer.commit();
}

TEST(Write, CsvComesBackBitForBit) {
  const Directory directory;
  Random random(11);
  Column x, y, z, weight;
  std::vector<std::int64_t> id;
  for (int i = 0; i < 40000; ++i) {
    // Doubles of every exponent.
    double value = 0;
    do {
      const std::uint64_t bits = random.next();
      std::memcpy(&value, &bits, sizeof value);
    } while (!(value - value == 0));
    x.push_back(value);
    y.push_back(random.uniform(-1, 1));
    z.push_back(static_cast<double>(i));
    weight.push_back(random.uniform());
    id.push_back(std::numeric_limits<std::int64_t>::max() - i);
  }
  const std::array<const double*, 3> axes{x.data(), y.data(), z.data()};
  const std::string path = directory / "p.csv";
  ASSERT_TRUE(write_csv(path, 3, axes, x.size(), id, weight).ok());
  EXPECT_EQ(contents(path).substr(0, 16), "x,y,z,id,weight\n");
  const auto points = read_points(path, {0, "weight"});
  ASSERT_TRUE(points.ok()) << refusal(points);
  EXPECT_EQ(points->position, (std::vector<Column>{x, y, z}));
  EXPECT_EQ(points->id, id);
  EXPECT_EQ(points->weight, weight);
  EXPECT_EQ(directory.file_count(), 1U);

  ASSERT_TRUE(write_csv(path, 1, axes, 2, std::nullopt, std::nullopt).ok());
  EXPECT_EQ(contents(path).substr(0, 2), "x\n");
  EXPECT_EQ(read_points(path, {})->count, 2U);
  ASSERT_TRUE(write_csv(path, 2, axes, 0, std::span<const std::int64_t>(), std::nullopt).ok());
  EXPECT_EQ(contents(path), "x,y,id\n");
}

TEST(Write, NpyIsTheBytesNumpyWrites) {
  const Directory directory;
  const std::vector<std::int32_t> part{1, -1};
  ASSERT_TRUE(write_npy(directory / "p.npy", part).ok());
  std::string expected = std::string("\x93NUMPY\x01\x00\x76\x00", 10);
  expected += "{'descr': '<i4', 'fortran_order': False, 'shape': (2,), }";
  expected += std::string(128 - expected.size() - 1, ' ') + "\n" + std::string("\x01\0\0\0\xFF\xFF\xFF\xFF", 8);
  EXPECT_EQ(contents(directory / "p.npy"), expected);
  const std::vector<std::int64_t> id{7};
  ASSERT_TRUE(write_npy(directory / "i.npy", id).ok());
  EXPECT_TRUE(has(contents(directory / "i.npy"), "'<i8'"));
  const std::vector<double> values{1, 2, 3, 4, 5, 6};
  ASSERT_TRUE(write_npy(directory / "d.npy", values, {3, 2}).ok());
  EXPECT_EQ(read_points(directory / "d.npy", {})->position, (std::vector<Column>{{1, 3, 5}, {2, 4, 6}}));
}

TEST(Write, TrajectoryAppearsAtItsEnd) {
  const Directory directory;
  const std::string path = directory / "t.npy";
  auto writer = TrajectoryWriter::create(path, 2, 2);
  ASSERT_TRUE(writer.ok());
  for (int step = 0; step < 3; ++step) {
    const double s = step;
    ASSERT_TRUE(writer.value()->append(std::vector<double>{s, s + 1, s + 2, s + 3}).ok());
  }
  EXPECT_FALSE(std::filesystem::exists(path));
  ASSERT_TRUE(writer.value()->close().ok());
  const auto reader = open_trajectory(path, {});
  ASSERT_TRUE(reader.ok()) << refusal(reader);
  EXPECT_EQ(reader.value()->frames(), 3U);
  for (double s = 0; s < 3; ++s)
    EXPECT_EQ((*reader.value()->next())->position, (std::vector<Column>{{s, s + 2}, {s + 1, s + 3}}));
  EXPECT_EQ(directory.file_count(), 1U);
  { auto given_up = TrajectoryWriter::create(directory / "u.npy", 2, 2); }
  EXPECT_EQ(directory.file_count(), 1U);
}

// Nor does anything stay of what a process that is killed has written.
TEST(Write, UntilItIsWholeAFileHasNoName) {
  const Directory directory;
  if (!Descriptor(::open((directory / "").c_str(), O_TMPFILE | O_WRONLY, 0600)).open())
    GTEST_SKIP() << "this file system has no files without a name";
  const pid_t writer = ::fork();
  if (writer == 0) {
    auto file = OutputFile::create(directory / "killed.csv");
    if (file.ok()) static_cast<void>(file->write("half"));
    ::kill(::getpid(), SIGKILL);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(writer, &status, 0), writer);
  EXPECT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(directory.file_count(), 0U);
  auto file = OutputFile::create(directory / "whole.csv");
  ASSERT_TRUE(file.ok());
  EXPECT_TRUE(file->write("whole").ok());
  EXPECT_EQ(directory.file_count(), 0U);
  EXPECT_TRUE(file->commit().ok());
  EXPECT_EQ(directory.file_count(), 1U);
  EXPECT_EQ(contents(directory / "whole.csv"), "whole");
}

TEST(Write, Refusals) {
  const Directory directory;
  const std::vector<double> values{1};
  EXPECT_TRUE(has(refusal(write_npy(directory / "none/p.npy", values, {1})), "can't be written"));
  EXPECT_TRUE(has(refusal(write_npy(directory / "", values, {1})), "is a directory"));
  EXPECT_TRUE(has(refusal(write_npy("/dev/full", values, {1})), "No space left"));
  EXPECT_FALSE(TrajectoryWriter::create("/dev/full", 1, 1).ok());
  // A name that is a link is written through, and what was no regular file stays what it was.
  std::filesystem::create_symlink(directory.write("real.npy", "old"), directory / "link.npy");
  ASSERT_TRUE(write_npy(directory / "link.npy", values, {1}).ok());
  EXPECT_TRUE(std::filesystem::is_symlink(directory / "link.npy"));
  EXPECT_EQ(read_points(directory / "real.npy", {})->count, 1U);
  ASSERT_TRUE(write_npy("/dev/null", values, {1}).ok());
  EXPECT_FALSE(std::filesystem::is_regular_file("/dev/null"));
}

}  // namespace
}  // namespace rcb::io
