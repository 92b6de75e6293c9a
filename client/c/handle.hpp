// Room `c`: librcbd.so, the client library behind the C interface (client/include/rcbd/rcbd.h). Nothing is decided
// here: arguments are checked and turned into those of C++, exceptions end here, and handles count their holders.
//
// Handle: what an opaque pointer of the interface leads to. Each struct of that name is derived from it.
//
// Invariants
// 1. A function first asks check() of each handle that it is given, which finds null pointers, handles of another kind
//    or already freed, and those of a process that was forked from the one that made them.
// 2. In a forked child nothing is freed or ended: the threads that would have to help are not there, and the
//    connections are the parent's.
#pragma once

#include <atomic>
#include <cstdint>
#include <utility>

#include <unistd.h>

#include "common/base/status.hpp"

namespace rcb::c {

enum class Kind : std::uint8_t { client, scene, arrays, op, result, cuts, lists };

class Handle {
 public:
  explicit Handle(Kind kind) : kind_(kind), process_(::getpid()) {}
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  virtual ~Handle() { mark_ = 0; }  // volatile: else the compiler leaves out what nobody reads

  // Ends it now, whoever still holds it. Only clients and scenes can.
  virtual Status close() { return {Code::invalid_argument, "only a client and a scene can be closed"}; }
  void retain() { ++holders_; }
  void release() {
    if (--holders_ == 0) delete this;
  }
  bool alive() const { return mark_ == kMark; }
  bool in_its_process() const { return process_ == ::getpid(); }
  Kind kind() const { return kind_; }

 private:
  static constexpr std::uint64_t kMark = 0x3168644264626372;

  volatile std::uint64_t mark_ = kMark;
  Kind kind_;
  pid_t process_;
  std::atomic<std::int64_t> holders_{1};
};

// Whether this is a handle that can be used here. `pointer` is what the caller gave.
Status check(const void* pointer);

// The same of a handle of this kind.
Status check_kind(const void* pointer, Kind kind);
template <typename T>
Status check(const T* handle) {
  return check_kind(static_cast<const Handle*>(handle), T::kKind);
}

// The same in a signal handler: without a reason.
template <typename T>
bool usable(const T* handle) {
  return handle != nullptr && handle->alive() && handle->kind() == T::kKind && handle->in_its_process();
}

// One holder of a handle. It ends with this.
template <typename T>
class Held {
 public:
  Held() = default;
  explicit Held(T& handle) : handle_(&handle) { handle.retain(); }
  Held(const Held&) = delete;
  Held& operator=(const Held&) = delete;
  ~Held() {
    if (handle_ != nullptr) handle_->release();
  }
  T* operator->() const { return handle_; }
  T& operator*() const { return *handle_; }

 private:
  T* handle_ = nullptr;
};

}  // namespace rcb::c
