#include "client/launch/job/job_folder.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <new>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/ipc.h>
#include <sys/shm.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "common/files/descriptor.hpp"
#include "common/files/own_files.hpp"
#include "common/files/paths.hpp"
#include "common/files/read_write.hpp"
#include "common/files/socket_file.hpp"

namespace rcb::launch {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSharedMemory = "/dev/shm";
constexpr std::string_view kOwnerFile = "owner";
constexpr int kTriesMax = 20;
constexpr std::uint64_t kSessionBytes = 16 << 20;             // Open MPI's session files, and as much again
constexpr std::uint64_t kRankBytes = (4 << 20) + (64 << 10);  // what Open MPI's vader shares of each, and a little more

std::string prefix() { return fmt::format("{}{}-", kJobFolderPrefix, ::geteuid()); }

// Whether System V's memory can hold what these ranks share: its limits are on a segment, on all, and on their number.
bool system_v_holds(int ranks) {
  std::vector<void*> attached;
  bool held = true;
  for (int rank = 0; rank < ranks && held; ++rank) {
    const int segment = ::shmget(IPC_PRIVATE, kRankBytes, IPC_CREAT | 0600);
    void* const at = segment < 0 ? nullptr : ::shmat(segment, nullptr, 0);
    held = at != nullptr && at != reinterpret_cast<void*>(-1);
    if (held) attached.push_back(at);
    if (segment >= 0) ::shmctl(segment, IPC_RMID, nullptr);  // it goes once nobody has it attached, killed or not
  }
  for (void* const at : attached) ::shmdt(at);
  return held;
}

// Also true where that can't be found out: making a folder there tells why.
bool has_room(const std::string& folder, std::uint64_t bytes) {
  constexpr std::uint64_t kFiles = 64;
  struct statvfs info {};
  if (::statvfs(folder.c_str(), &info) != 0) return true;
  if (info.f_files > 0 && info.f_favail < kFiles) return false;  // some file systems don't count them
  return std::uint64_t{info.f_bavail} * info.f_frsize > bytes;
}

void remove_tree(const std::string& path, std::vector<std::string>& removed) {
  std::error_code error;
  if (is_own_directory(path) && fs::remove_all(path, error) > 0 && !error) removed.push_back(path);
}

// Removes what a job whose owner is dead has left besides its folder: the sockets.
void remove_rest(const std::string& text, std::vector<std::string>& removed) {
  const EndpointNote owner = EndpointNote::parse(text);
  // If another process holds the endpoint's lock by now, it has dealt with these sockets.
  if (owner.endpoint.starts_with("unix:"))
    if (const auto lock = take_endpoint(owner); lock.ok())
      for (const std::string& socket : remove_dead_sockets(owner.endpoint.substr(5))) removed.push_back(socket);
}

std::string note_in(const std::string& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  return file.open() ? read_some(file.get(), LockFile::kNoteBytes) : std::string();
}

}  // namespace

Result<JobFolder> JobFolder::make(const std::string& fallback, int ranks) {
  const bool memory = !system_v_holds(ranks);
  const std::uint64_t bytes = kSessionBytes + (memory ? static_cast<std::uint64_t>(ranks) * kRankBytes : 0);
  if (has_room(kSharedMemory, bytes))
    if (auto folder = make_in(kSharedMemory, memory); folder.ok()) return folder;
  if (!has_room(fallback, bytes))
    return Status(
        Code::io_error,
        fmt::format("neither {} nor {} has room for {} MiB, Open MPI's files", kSharedMemory, fallback, bytes >> 20U),
        memory ? "make room there, or raise kernel.shmmax, shmall and shmmni (ipcs -l)" : "make room there");
  return make_in(fallback, memory);
}

Result<JobFolder> JobFolder::make_in(const std::string& parent, bool holds_memory) {
  Status status;
  for (int i = 0; i < kTriesMax; ++i) {
    std::string path = join_path(parent, prefix() + "XXXXXX");
    if (::mkdtemp(path.data()) == nullptr)
      return Status(Code::io_error, fmt::format("no folder can be made in {}: {}", parent, std::strerror(errno)));
    // Before the note was locked, a sweep may have taken the folder for a left-over one: then try another.
    auto lock = LockFile::take(join_path(path, kOwnerFile), "");
    if (lock.ok()) return JobFolder(std::move(path), holds_memory, std::move(*lock));
    status = lock.status();
    std::error_code ignored;
    fs::remove_all(path, ignored);
    if (status.code() != Code::busy && status.code() != Code::not_found) break;
  }
  return status;
}

JobFolder::JobFolder(JobFolder&& other) noexcept
    : path_(std::exchange(other.path_, "")), holds_memory_(other.holds_memory_), lock_(std::move(other.lock_)) {}

JobFolder::~JobFolder() {
  if (path_.empty()) return;
  try {
    std::error_code error;
    // The note goes last: by it the next sweep finds what can't be removed now, such as without a descriptor left.
    for (const std::string& name : names_in(path_, error))
      if (name != kOwnerFile && !error) fs::remove_all(join_path(path_, name), error);
    if (!error) fs::remove_all(path_, error);
  } catch (const std::bad_alloc&) {  // the next sweep removes it
  }
}

void JobFolder::sign(const EndpointNote& owner) const {
  (void)lock_.write(owner.text());  // if this fails, only the sockets of a killed job stay
}

std::vector<std::string> JobFolder::sweep(const std::string& fallback) {
  std::vector<std::string> removed;
  for (const std::string& parent : {std::string(kSharedMemory), fallback}) {
    std::error_code ignored;
    for (const std::string& name : names_in(parent, ignored)) {
      const std::string path = join_path(parent, name);
      if (!name.starts_with(prefix()) || !is_own_directory(path)) continue;
      // A folder without a note is just being created, or is of another version.
      std::error_code unseen;
      if (!fs::exists(join_path(path, kOwnerFile), unseen)) continue;
      const std::string note = note_in(join_path(path, kOwnerFile));
      const auto lock = LockFile::take(join_path(path, kOwnerFile), note);
      if (!lock.ok()) continue;  // its owner lives
      remove_rest(note, removed);
      remove_tree(path, removed);
    }
  }
  return removed;
}

}  // namespace rcb::launch
