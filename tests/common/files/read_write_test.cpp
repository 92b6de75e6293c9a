#include "common/files/read_write.hpp"

#include <cerrno>
#include <cstdio>

#include <fcntl.h>
#include <gtest/gtest.h>

#include "common/files/descriptor.hpp"

namespace rcb {
namespace {

TEST(ReadWrite, ReadsBackFromAnyPlace) {
  std::FILE* const made = std::tmpfile();
  ASSERT_NE(made, nullptr);
  const int file = ::fileno(made);
  EXPECT_TRUE(write_all(file, "words"));
  EXPECT_TRUE(write_all(file, ""));
  EXPECT_EQ(read_some(file, 5), "words");
  EXPECT_EQ(read_some(file, 2, 1), "or");
  errno = 0;
  EXPECT_EQ(read_some(file, 100, 3), "ds");
  EXPECT_EQ(errno, EIO);
  std::fclose(made);
}

TEST(ReadWrite, SaysWhyNotAllIsDone) {
  const Descriptor full(::open("/dev/full", O_RDWR | O_CLOEXEC));
  ASSERT_TRUE(full.open());
  EXPECT_FALSE(write_all(full.get(), "words"));
  EXPECT_EQ(errno, ENOSPC);
  const Descriptor none;
  EXPECT_EQ(write_some(none.get(), "words"), 0U);
  EXPECT_EQ(errno, EBADF);
  EXPECT_EQ(read_some(none.get(), 5), "");
  EXPECT_EQ(errno, EBADF);
}

}  // namespace
}  // namespace rcb
