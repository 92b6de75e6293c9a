#include "server/scene/storage.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <system_error>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"

namespace rcb::scene {
namespace {

constexpr const char* kMakeRoom = "make room in the service's data directory";

Status storage_fault(const char* what, const std::string& path, int fault) {
  return {Code::io_error, fmt::format("can't {} {}: {}", what, path, std::strerror(fault)),
          fault == ENOSPC || fault == EDQUOT || fault == EFBIG ? kMakeRoom : ""};
}

class DiskFile final : public MappedFile {
 public:
  DiskFile(char* data, std::size_t size) : data_(data), size_(size) {}
  DiskFile(const DiskFile&) = delete;
  DiskFile& operator=(const DiskFile&) = delete;
  ~DiskFile() override {
    if (size_ > 0) ::munmap(data_, size_);
  }
  std::string_view bytes() const override { return {data_, size_}; }
  void store(std::size_t at, std::string_view bytes) override {
    RCB_CHECK(at <= size_ && bytes.size() <= size_ - at, "what is stored fits the file");
    std::memcpy(data_ + at, bytes.data(), bytes.size());
  }

 private:
  char* data_;
  std::size_t size_;
};

// Gives each byte a place on the disk. What is there stays.
int allocate(int file, std::size_t bytes) {
  int fault = bytes == 0 ? 0 : EINTR;
  while (fault == EINTR) fault = ::posix_fallocate(file, 0, static_cast<off_t>(bytes));
  return fault;
}

Result<std::unique_ptr<MappedFile>> map_file(const std::string& path, int file, std::size_t bytes,
                                             Storage::Access access) {
  const int protection = access == Storage::Access::write ? PROT_READ | PROT_WRITE : PROT_READ;
  void* const at = bytes == 0 ? nullptr : ::mmap(nullptr, bytes, protection, MAP_SHARED, file, 0);  // 0 can't be mapped
  if (at == MAP_FAILED) return storage_fault("map", path, errno);
  return std::unique_ptr<MappedFile>(std::make_unique<DiskFile>(static_cast<char*>(at), bytes));
}

class DiskStorage final : public Storage {
 public:
  Status make_folder(const std::string& path) override { return make_own_directory(path); }
  Result<std::vector<std::string>> names_in(const std::string& folder) const override;
  Result<std::unique_ptr<MappedFile>> make_file(const std::string& path, std::size_t bytes) override;
  Result<std::unique_ptr<MappedFile>> open_file(const std::string& path, Access access) const override;
  Status rename(const std::string& from, const std::string& to) override {
    return ::rename(from.c_str(), to.c_str()) == 0 ? Status() : storage_fault("rename", from, errno);
  }
  Status remove(const std::string& path) override {
    return std::remove(path.c_str()) == 0 || errno == ENOENT ? Status() : storage_fault("remove", path, errno);
  }
};

Result<std::vector<std::string>> DiskStorage::names_in(const std::string& folder) const {
  std::error_code fault;
  auto names = rcb::names_in(folder, fault);
  if (fault && fault != std::errc::no_such_file_or_directory) return storage_fault("look into", folder, fault.value());
  return names;
}

Result<std::unique_ptr<MappedFile>> DiskStorage::make_file(const std::string& path, std::size_t bytes) {
  if (Status removed = remove(path); !removed) return removed;
  const auto file = open_own_file(path, O_RDWR | O_CREAT | O_EXCL);
  if (!file.ok()) return file.status();
  auto mapped = [&]() -> Result<std::unique_ptr<MappedFile>> {
    if (const int fault = allocate(file->get(), bytes); fault != 0) return storage_fault("make", path, fault);
    return map_file(path, file->get(), bytes, Access::write);
  }();
  if (!mapped.ok()) ::unlink(path.c_str());
  return mapped;
}

Result<std::unique_ptr<MappedFile>> DiskStorage::open_file(const std::string& path, Access access) const {
  const auto file = open_own_file(path, access == Access::write ? O_RDWR : O_RDONLY);
  if (!file.ok()) return file.status();
  struct stat info {};
  if (::fstat(file->get(), &info) != 0) return storage_fault("look at", path, errno);
  const auto bytes = static_cast<std::size_t>(info.st_size);
  if (bytes > kFileBytesMax)
    return Status(Code::too_large, fmt::format("{} has {} bytes, more than {}", path, bytes, kFileBytesMax));
  if (access == Access::write)
    if (const int fault = allocate(file->get(), bytes); fault != 0) return storage_fault("write", path, fault);
  return map_file(path, file->get(), bytes, access);
}

}  // namespace

std::unique_ptr<Storage> disk_storage() { return std::make_unique<DiskStorage>(); }

}  // namespace rcb::scene
