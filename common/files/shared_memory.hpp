// SharedMemory: memory that a client fills and the ranks of a service on its host read, without a copy through the
// kernel; or that the ranks share. It is a memfd: it has no name in any file system, and is gone with the last process
// that maps it.
//
// Invariants
// 1. Its size is sealed, so that no reader is ended by a signal because somebody else has shrunk it.
// 2. A client's memory is mapped read-only. What it holds may change at any moment, so a reader takes each value once.
#pragma once

#include <cstddef>
#include <span>
#include <utility>

#include "common/base/status.hpp"
#include "common/files/descriptor.hpp"

namespace rcb {

class SharedMemory {
 public:
  SharedMemory() = default;
  SharedMemory(SharedMemory&& other) noexcept { swap(other); }
  SharedMemory& operator=(SharedMemory&& other) noexcept {
    swap(other);
    return *this;
  }
  ~SharedMemory();

  // Makes memory that this process may write. Errors: io_error (this kernel has no memfd, or there is no memory).
  static Result<SharedMemory> create(std::size_t bytes);
  // Maps memory that another process has made and sent, read-only; the descriptor isn't needed any more then. Errors:
  // invalid_argument (no memfd, not sealed, smaller than `bytes`), not_authorised (of another user), io_error.
  static Result<SharedMemory> map(Descriptor descriptor, std::size_t bytes);

  // Maps memory that another process of the same job on this machine has made and keeps, for reading and writing, by
  // its number and that of its descriptor. Errors: as map(), and io_error where /proc doesn't show it.
  static Result<SharedMemory> join(int process, int descriptor, std::size_t bytes);

  // Only if this process made or joined it.
  std::span<std::byte> writable() const { return writable_ ? std::span(data_, size_) : std::span<std::byte>(); }
  std::span<const std::byte> bytes() const { return {data_, size_}; }
  std::size_t size() const { return size_; }
  // Whether both are the same pages, however they came here.
  bool same_as(const SharedMemory& other) const { return device_ == other.device_ && inode_ == other.inode_; }
  int descriptor() const { return descriptor_.get(); }  // -1 if mapped from another process

  void swap(SharedMemory& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(descriptor_, other.descriptor_);
    std::swap(writable_, other.writable_);
    std::swap(device_, other.device_);
    std::swap(inode_, other.inode_);
  }

 private:
  static Result<SharedMemory> map_foreign(int descriptor, std::size_t bytes, int access);

  std::byte* data_ = nullptr;
  std::size_t size_ = 0;
  Descriptor descriptor_;
  bool writable_ = false;
  std::uint64_t device_ = 0;  // known of memory that another process has made
  std::uint64_t inode_ = 0;
};

}  // namespace rcb
