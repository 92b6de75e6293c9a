// Files on somebody else's word: only below the roots, whatever links and swaps lead out, and without a word of them.
#include "common/io/files/roots.hpp"

#include <atomic>
#include <cstdio>
#include <thread>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <hdf5.h>

#include "common/io/files/output_file.hpp"
#include "common/io/points.hpp"
#include "tests/common/io/files.hpp"

namespace rcb::io {
namespace {

namespace fs = std::filesystem;
using namespace testing;

// outside/secret, and root/{points.csv, sub/deep.csv} with links of all kinds.
class RootsTest : public ::testing::Test {
 protected:
  RootsTest() {
    fs::create_directories(directory_ / "root/sub");
    fs::create_directories(directory_ / "outside");
    fs::create_directories(directory_ / "rooted");  // begins with the root's name
    secret_ = directory_.write("outside/secret", "1,2,3\n");
    directory_.write("rooted/points.csv", "1,2,3\n");
    directory_.write("root/points.csv", "1,2,3\n");
    directory_.write("root/sub/deep.csv", "4,5,6\n");
    fs::create_symlink(secret_, directory_ / "root/out.csv");
    fs::create_symlink("../outside", directory_ / "root/out");
    fs::create_symlink("sub", directory_ / "root/in");
    fs::create_symlink(directory_ / "root", directory_ / "way-in");
    EXPECT_TRUE(roots_.add(directory_ / "root").ok());
  }
  Code code(const std::string& path) { return roots_.open_file(path).status().code(); }

  Directory directory_;
  std::string secret_;
  Roots roots_;
};

TEST_F(RootsTest, WhereAPathLeadsDecides) {
  for (const char* good : {"root/points.csv", "root/sub/deep.csv", "root/sub/../points.csv", "root//sub/./deep.csv",
                           "root/in/deep.csv", "way-in/points.csv", "outside/../root/points.csv"})
    EXPECT_EQ(code(directory_ / good), Code::ok) << good;
  for (const char* bad : {"outside/secret", "root/out.csv", "root/out/secret", "root/../outside/secret",
                          "root/sub/../../outside/secret", "rooted/points.csv", "root/out/missing", "missing"})
    EXPECT_EQ(code(directory_ / bad), Code::not_authorised) << bad;
  EXPECT_EQ(code("/etc/passwd"), Code::not_authorised);
  EXPECT_EQ(code("/proc/self/root/etc/passwd"), Code::not_authorised);
  EXPECT_EQ(code("points.csv"), Code::not_authorised) << "from whatever directory this runs in";
  EXPECT_EQ(code(directory_ / "root/missing"), Code::not_found);
  EXPECT_EQ(code(directory_ / "root/missing/points.csv"), Code::not_found);
  EXPECT_EQ(code(directory_ / "root"), Code::io_error);
  EXPECT_EQ(code(directory_ / "root/sub"), Code::io_error);
  EXPECT_EQ(code((directory_ / "root/points.csv") + std::string(1, '\0') + "x"), Code::invalid_argument);
  EXPECT_EQ(Roots().open_file(directory_ / "root/points.csv").status().code(), Code::not_authorised);
  // What is there and what isn't look alike from outside.
  const auto told = [this](const char* name) {
    std::string text = roots_.open_file(directory_ / name).status().message();
    return text.substr(text.find(" doesn't"));
  };
  EXPECT_EQ(told("outside/secret"), told("outside/missing"));
}

TEST_F(RootsTest, TheWholeTreeMayBeARoot) {
  Roots all;
  ASSERT_TRUE(all.add("/").ok());
  EXPECT_TRUE(all.open_file(secret_).ok());
  EXPECT_TRUE(all.open_file(directory_ / "root/out.csv").ok());
  EXPECT_EQ(roots_.add(directory_ / "missing").code(), Code::io_error);
  EXPECT_EQ(roots_.add(secret_).code(), Code::io_error);
}

// Between look and use a folder becomes a link out of the root, or one out of it a folder, many times.
TEST_F(RootsTest, ASwapLeadsNowhere) {
  fs::create_directories(directory_ / "root/swapped");
  directory_.write("root/swapped/secret", "7,8,9\n");
  fs::create_symlink("../outside", directory_ / "root/link");
  const std::string here = directory_ / "root/swapped", link = directory_ / "root/link";
  std::atomic<bool> over = false;
  std::thread swapper([&] {
    while (!over) ASSERT_EQ(::renameat2(AT_FDCWD, here.c_str(), AT_FDCWD, link.c_str(), RENAME_EXCHANGE), 0);
  });
  int read = 0;
  for (int round = 0; round < 20000; ++round) {
    const auto file = roots_.open_file(here + "/secret");
    if (!file.ok()) continue;
    char first = 0;
    ASSERT_TRUE(file->read_at(0, &first, 1).ok());
    EXPECT_EQ(first, '7') << "a file outside was opened in round " << round;
    ++read;
    const auto folder = roots_.make_folder(here);
    if (!folder.ok()) continue;
    auto written = OutputFile::create_in(*folder, "new");
    if (written.ok() && written->write("x").ok()) static_cast<void>(written->commit());
  }
  over = true;
  swapper.join();
  EXPECT_GT(read, 0);
  EXPECT_FALSE(fs::exists(directory_ / "outside/new")) << "a file was written outside";
}

TEST_F(RootsTest, FoldersAreMadeBelowAndNotElsewhere) {
  const auto folder = roots_.make_folder(directory_ / "root/a/b");
  ASSERT_TRUE(folder.ok()) << folder.status().message();
  EXPECT_TRUE(fs::is_directory(directory_ / "root/a/b"));
  EXPECT_TRUE(roots_.make_folder(directory_ / "root").ok());
  for (const char* bad : {"outside/new", "root/out/new", "root/../new", "rooted/new"})
    EXPECT_EQ(roots_.make_folder(directory_ / bad).status().code(), Code::not_authorised) << bad;
  EXPECT_FALSE(fs::exists(directory_ / "outside/new"));
  EXPECT_EQ(roots_.make_folder(directory_ / "root/points.csv/x").status().code(), Code::io_error);
  // A link that waits under the file's name is replaced, and what it leads to is left alone.
  fs::create_symlink(secret_, directory_ / "root/a/b/part-0.csv");
  auto file = OutputFile::create_in(*folder, "part-0.csv");
  ASSERT_TRUE(file.ok());
  EXPECT_TRUE(file->write("new").ok());
  EXPECT_TRUE(file->commit().ok());
  EXPECT_EQ(contents(secret_), "1,2,3\n");
  EXPECT_EQ(contents(directory_ / "root/a/b/part-0.csv"), "new");
  {
    auto dropped = OutputFile::create_in(*folder, "dropped");
    ASSERT_TRUE(dropped.ok());
  }
  EXPECT_EQ(std::distance(fs::directory_iterator(directory_ / "root/a/b"), fs::directory_iterator()), 1);
}

// Of a file that isn't the asker's a message says where and why, and nothing of what it holds.
TEST_F(RootsTest, MessagesDoNotQuote) {
  const std::vector<std::pair<const char*, std::string>> files{
      {"shadow", "root:$6$hunter2:19000:0:99999:7:::\ndaemon:*:19000:0:99999:7:::\n"},
      {"header.csv", "hunter2,b\n1,2,3\n"},
      {"word.csv", "x,y\n1,2\n3,hunter2\n"},
      {"named.csv", "hunter2,x,y,id\nq,1,hunter2,hunter2\n"},
      {"id.csv", "x,y,id\n1,2,hunter2\n"},
      {"ragged.csv", "x,y\nhunter2\n"},
      {"a.xyz", "7331\nhunter2\nAr 1 2 3\n"},
      {"more.xyz", "0\nhunter2\nhunter2 1 2 7331\n"},
      {"bad.xyz", "1\nhunter2\nAr 1 hunter2 3\n"},
      {"a.npy", testing::npy_with_header(1, "{'descr': 'hunter2', 'fortran_order': False, 'shape': (1, 3), }")},
      {"b.npy", "hunter2"}};
  for (const auto& [name, bytes] : files) {
    directory_.write(std::string("root/") + name, bytes);
    for (const char* weights : {"", "mass"}) {
      ReadOptions options;
      options.weights = weights;
      options.below = &roots_;
      const Status status = read_points(directory_ / (std::string("root/") + name), options).status();
      EXPECT_FALSE(status.ok()) << name;
      const std::string said = status.message() + status.hint();
      EXPECT_NE(said.find(name), std::string::npos) << said;
      EXPECT_EQ(said.find("hunter2"), std::string::npos) << name << ": " << said;
      EXPECT_EQ(said.find("7331"), std::string::npos) << name << ": " << said;
    }
  }
  ReadOptions options;
  options.below = &roots_;
  EXPECT_EQ(
      read_points(directory_ / "root/word.csv", options).status().message().substr(directory_.operator/("").size()),
      "root/word.csv:3: column 2: its text is not a number");
}

TEST_F(RootsTest, Hdf5FilesLeadToNoOther) {
  const auto make = [](const std::string& path, bool dataset, const std::string& target) {
    const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    if (dataset) {
      const hsize_t shape[2] = {1, 3};
      const double values[3] = {1, 2, 3};
      const hid_t space = H5Screate_simple(2, shape, nullptr);
      const hid_t made = H5Dcreate2(file, "hunter2", H5T_IEEE_F64LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
      EXPECT_GE(H5Dwrite(made, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values), 0);
      H5Dclose(made);
      H5Sclose(space);
    } else {
      EXPECT_GE(H5Lcreate_external(target.c_str(), "/hunter2", file, "link", H5P_DEFAULT, H5P_DEFAULT), 0);
    }
    H5Fclose(file);
  };
  make(directory_ / "outside/secret.h5", true, "");
  make(directory_ / "root/own.h5", true, "");
  make(directory_ / "root/links.h5", false, directory_ / "outside/secret.h5");
  fs::create_symlink(directory_ / "outside/secret.h5", directory_ / "root/linked.h5");
  ReadOptions options;
  EXPECT_TRUE(read_points(directory_ / "root/links.h5:/link", options).ok()) << "else this test proves nothing";
  options.below = &roots_;
  EXPECT_TRUE(read_points(directory_ / "root/own.h5:/hunter2", options).ok());
  EXPECT_EQ(read_points(directory_ / "root/links.h5:/link", options).status().code(), Code::not_found);
  EXPECT_EQ(read_points(directory_ / "root/linked.h5:/hunter2", options).status().code(), Code::not_authorised);
  EXPECT_EQ(read_points(directory_ / "outside/secret.h5:/hunter2", options).status().code(), Code::not_authorised);
  for (const char* name : {"root/own.h5", "root/own.h5:/other"}) {
    const Status status = read_points(directory_ / name, options).status();
    EXPECT_EQ((status.message() + status.hint()).find("hunter2"), std::string::npos) << status.hint();
  }
}

}  // namespace
}  // namespace rcb::io
