#include "common/files/shared_memory.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/magic.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

namespace rcb {
namespace {

constexpr const char* kName = "rcbd";
constexpr int kSizeSeals = F_SEAL_SHRINK | F_SEAL_GROW;

Status failed(const char* what) { return {Code::io_error, fmt::format("{}: {}", what, std::strerror(errno))}; }

Status check_foreign(int descriptor, std::size_t bytes) {
  const int seals = ::fcntl(descriptor, F_GET_SEALS);
  struct statfs system {};
  // Huge pages could be missing when a reader first touches them, which would end it by a signal.
  if (seals < 0 || ::fstatfs(descriptor, &system) != 0 || system.f_type != TMPFS_MAGIC)
    return {Code::invalid_argument, "what was sent isn't a memfd of ordinary pages"};
  if ((seals & kSizeSeals) != kSizeSeals)
    return {Code::invalid_argument, "the memfd isn't sealed against shrinking and growing",
            "add F_SEAL_SHRINK and F_SEAL_GROW before sending it"};
  struct stat info {};
  if (::fstat(descriptor, &info) != 0) return failed("fstat of a memfd");
  if (info.st_uid != ::geteuid() && info.st_uid != 0)
    return {Code::not_authorised, fmt::format("the memfd belongs to user {}", info.st_uid)};
  if (bytes == 0 || static_cast<std::uint64_t>(info.st_size) < bytes)
    return {Code::invalid_argument, fmt::format("the memfd has {} bytes, {} were announced", info.st_size, bytes)};
  return {};
}

}  // namespace

SharedMemory::~SharedMemory() {
  if (data_ != nullptr) ::munmap(data_, size_);
}

Result<SharedMemory> SharedMemory::create(std::size_t bytes) {
  SharedMemory made;
  made.descriptor_ = Descriptor(::memfd_create(kName, MFD_CLOEXEC | MFD_ALLOW_SEALING));
  const int memfd = made.descriptor();
  if (memfd < 0) return failed("memfd_create");
  // A file that grows beyond the limit of this process ends it by a signal, unless it cares for that one.
  rlimit limit{};
  if (::getrlimit(RLIMIT_FSIZE, &limit) == 0 && bytes > limit.rlim_cur)
    return Status(Code::io_error, fmt::format("memory of {} bytes can't be shared: files may have {} (ulimit -f)",
                                              bytes, limit.rlim_cur));
  if (::ftruncate(memfd, static_cast<off_t>(bytes)) != 0) return failed("the size of a memfd");
  if (::fcntl(memfd, F_ADD_SEALS, kSizeSeals | F_SEAL_SEAL) != 0) return failed("the seals of a memfd");
  void* const at = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, memfd, 0);
  if (at == MAP_FAILED) return failed("mapping a memfd");
  made.data_ = static_cast<std::byte*>(at);
  made.size_ = bytes;
  made.writable_ = true;
  return made;
}

Result<SharedMemory> SharedMemory::map_foreign(int descriptor, std::size_t bytes, int access) {
  if (Status status = check_foreign(descriptor, bytes); !status.ok()) return status;
  void* const at = ::mmap(nullptr, bytes, access, MAP_SHARED, descriptor, 0);
  if (at == MAP_FAILED) return failed("mapping a memfd");
  SharedMemory mapped;
  mapped.data_ = static_cast<std::byte*>(at);
  mapped.size_ = bytes;
  return mapped;
}

Result<SharedMemory> SharedMemory::map(Descriptor descriptor, std::size_t bytes) {
  Result<SharedMemory> mapped = map_foreign(descriptor.get(), bytes, PROT_READ);
  if (!mapped.ok()) return mapped;
  struct stat file {};
  if (::fstat(descriptor.get(), &file) != 0) return failed("looking at a memfd");
  mapped->device_ = file.st_dev;
  mapped->inode_ = file.st_ino;
  return mapped;
}

Result<SharedMemory> SharedMemory::join(int process, int descriptor, std::size_t bytes) {
  const std::string path = fmt::format("/proc/{}/fd/{}", process, descriptor);
  // In another namespace of processes the number may be that of something else, which opening might change.
  std::error_code error;
  if (!std::filesystem::read_symlink(path, error).string().starts_with(fmt::format("/memfd:{}", kName)))
    return Status(Code::io_error, fmt::format("{} is no memory to share", path));
  const Descriptor opened(::open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!opened.open()) return failed("opening a memfd");
  Result<SharedMemory> joined = map_foreign(opened.get(), bytes, PROT_READ | PROT_WRITE);
  if (joined.ok()) joined->writable_ = true;
  return joined;
}

}  // namespace rcb
