#include "server/net/files/socket_name.hpp"

#include <array>
#include <atomic>
#include <cstring>
#include <utility>

#include <sys/stat.h>
#include <unistd.h>

#include "common/base/check.hpp"
#include "common/files/paths.hpp"

namespace rcb::net {
namespace {

enum : int { kFree, kTaken, kBound };

struct Slot {
  std::atomic<int> state{kFree};
  std::array<char, kSocketPathMax + 1> path{};
  dev_t device = 0;
  ino_t inode = 0;
};

// A fixed table, since a signal handler can neither lock nor walk a container that is being changed.
std::array<Slot, 256> g_slots;

bool is_in_place(const Slot& slot) noexcept {
  struct stat info {};
  return ::lstat(slot.path.data(), &info) == 0 && info.st_dev == slot.device && info.st_ino == slot.inode;
}

// lstat and unlink are safe in a signal handler.
void remove_slot(Slot& slot) noexcept {
  int bound = kBound;
  if (!slot.state.compare_exchange_strong(bound, kTaken)) return;
  if (is_in_place(slot)) ::unlink(slot.path.data());
  slot.state = kFree;
}

}  // namespace

SocketName::SocketName(const std::string& path) {
  RCB_CHECK(path.size() <= kSocketPathMax, path);
  struct stat info {};
  if (::lstat(path.c_str(), &info) != 0) return;  // somebody has removed it already
  for (std::size_t i = 0; i < g_slots.size(); ++i) {
    Slot& slot = g_slots[i];
    int free = kFree;
    if (!slot.state.compare_exchange_strong(free, kTaken)) continue;
    std::memcpy(slot.path.data(), path.c_str(), path.size() + 1);
    slot.device = info.st_dev;
    slot.inode = info.st_ino;
    slot.state = kBound;
    slot_ = static_cast<int>(i);
    return;
  }
  RCB_CHECK(false, "a process with so many listeners");
}

SocketName::SocketName(SocketName&& other) noexcept : slot_(std::exchange(other.slot_, -1)) {}

SocketName::~SocketName() { remove(); }

void SocketName::remove() {
  if (slot_ >= 0) remove_slot(g_slots[static_cast<std::size_t>(std::exchange(slot_, -1))]);
}

SocketPlace SocketName::place() const {
  if (slot_ < 0) return {};
  const Slot& slot = g_slots[static_cast<std::size_t>(slot_)];
  return {slot.path.data(), slot.device, slot.inode};
}

bool SocketPlace::taken() const {
  struct stat info {};
  return inode != 0 && ::lstat(path.c_str(), &info) == 0 && info.st_dev == device && info.st_ino == inode;
}

void SocketName::remove_all() noexcept {
  for (Slot& slot : g_slots) remove_slot(slot);
}

}  // namespace rcb::net
