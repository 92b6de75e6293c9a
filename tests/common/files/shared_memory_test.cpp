#include "common/files/shared_memory.hpp"

#include <cstring>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

namespace rcb {
namespace {

constexpr std::size_t kBytes = 10'000;

Descriptor memfd(std::size_t bytes, int seals) {
  Descriptor descriptor(::memfd_create("test", MFD_ALLOW_SEALING));
  EXPECT_EQ(::ftruncate(descriptor.get(), static_cast<off_t>(bytes)), 0);
  EXPECT_EQ(::fcntl(descriptor.get(), F_ADD_SEALS, seals), 0);
  return descriptor;
}

TEST(SharedMemory, WhatOneWritesTheOtherReads) {
  auto made = SharedMemory::create(kBytes);
  ASSERT_TRUE(made.ok()) << made.status().message();
  const auto mapped = SharedMemory::map(Descriptor(::dup(made->descriptor())), kBytes);
  ASSERT_TRUE(mapped.ok()) << mapped.status().message();
  EXPECT_EQ(mapped->descriptor(), -1);
  EXPECT_TRUE(mapped->writable().empty());
  ASSERT_EQ(made->writable().size(), kBytes);
  std::memset(made->writable().data(), 7, kBytes);
  EXPECT_EQ(mapped->bytes()[kBytes - 1], std::byte{7});
  const SharedMemory moved = std::move(*made);
  EXPECT_EQ(moved.bytes()[0], std::byte{7});
  EXPECT_NE(::ftruncate(moved.descriptor(), 0), 0) << "its size is sealed";
}

TEST(SharedMemory, AProcessOfTheJobJoins) {
  auto made = SharedMemory::create(kBytes);
  ASSERT_TRUE(made.ok()) << made.status().message();
  const auto joined = SharedMemory::join(::getpid(), made->descriptor(), kBytes);
  ASSERT_TRUE(joined.ok()) << joined.status().message();
  joined->writable()[kBytes - 1] = std::byte{7};
  EXPECT_EQ(made->bytes()[kBytes - 1], std::byte{7});
  EXPECT_EQ(SharedMemory::join(::getpid(), made->descriptor(), kBytes + 1).status().code(), Code::invalid_argument);
  EXPECT_EQ(SharedMemory::join(::getpid(), 0, kBytes).status().code(), Code::io_error) << "no memory";
  EXPECT_EQ(SharedMemory::join(::getpid(), 9999, kBytes).status().code(), Code::io_error) << "no descriptor";
  EXPECT_EQ(SharedMemory::join(0, 0, kBytes).status().code(), Code::io_error) << "no process";
  EXPECT_EQ(SharedMemory::join(::getpid(), memfd(kBytes, F_SEAL_SHRINK | F_SEAL_GROW).get(), kBytes).status().code(),
            Code::io_error)
      << "not of a service";
}

// Beyond the limit the system would end this program by a signal.
TEST(SharedMemory, MoreThanAFileMayHaveIsRefused) {
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const rlimit little{kBytes, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &little), 0);
  const auto more = SharedMemory::create(kBytes + 1);
  const bool as_much = SharedMemory::create(kBytes).ok();
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  ASSERT_FALSE(more.ok());
  EXPECT_NE(more.status().message().find("ulimit -f"), std::string::npos) << more.status().message();
  EXPECT_TRUE(as_much);
}

TEST(SharedMemory, OnlyWhatCannotShrinkIsMapped) {
  constexpr int kBoth = F_SEAL_SHRINK | F_SEAL_GROW;
  EXPECT_TRUE(SharedMemory::map(memfd(kBytes, kBoth), kBytes).ok());
  EXPECT_TRUE(SharedMemory::map(memfd(kBytes, kBoth), 1).ok());
  for (const int seals : {0, F_SEAL_GROW, F_SEAL_SHRINK})
    EXPECT_EQ(SharedMemory::map(memfd(kBytes, seals), kBytes).status().code(), Code::invalid_argument) << seals;
  EXPECT_EQ(SharedMemory::map(memfd(kBytes, kBoth), kBytes + 1).status().code(), Code::invalid_argument);
  EXPECT_EQ(SharedMemory::map(memfd(kBytes, kBoth), 0).status().code(), Code::invalid_argument);
  EXPECT_EQ(SharedMemory::map(Descriptor(), kBytes).status().code(), Code::invalid_argument);
  EXPECT_EQ(SharedMemory::map(Descriptor(::open("/dev/null", O_RDONLY)), kBytes).status().code(),
            Code::invalid_argument);
}

}  // namespace
}  // namespace rcb
