// Failures, handles of any kind, the version.
#include "client/c/call.hpp"

#include <limits>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "client/c/handle.hpp"
#include "client/include/rcbd/rcbd.h"

namespace rcb::c {
namespace {

thread_local Status last_failure;

constexpr bool is(rcbd_code mine, Code code) { return static_cast<int>(mine) == static_cast<int>(code); }
static_assert(is(RCBD_OK, Code::ok) && is(RCBD_INVALID_ARGUMENT, Code::invalid_argument) &&
              is(RCBD_NOT_FOUND, Code::not_found) && is(RCBD_ALREADY_EXISTS, Code::already_exists) &&
              is(RCBD_BUSY, Code::busy) && is(RCBD_STALE_STEP, Code::stale_step) &&
              is(RCBD_NOT_FINITE, Code::not_finite) && is(RCBD_PROTOCOL_ERROR, Code::protocol_error) &&
              is(RCBD_TOO_LARGE, Code::too_large) && is(RCBD_NOT_AUTHORISED, Code::not_authorised) &&
              is(RCBD_UNAVAILABLE, Code::unavailable) && is(RCBD_DEADLINE_EXCEEDED, Code::deadline_exceeded) &&
              is(RCBD_ABORTED, Code::aborted) && is(RCBD_IO_ERROR, Code::io_error) &&
              is(RCBD_UNSUPPORTED, Code::unsupported) && is(RCBD_INTERNAL, Code::internal) &&
              is(RCBD_INTERRUPTED, Code::interrupted) && is(RCBD_NOT_CONSERVED, Code::not_conserved) &&
              is(RCBD_DUPLICATE_ID, Code::duplicate_id));
static_assert(RCBD_VERSION == RCB_VERSION_NUMBER, "rcbd.h and the project's version");

constexpr const char* kKindNames[] = {"client", "scene", "arrays", "op", "result", "cuts", "lists"};
const char* name_of(Kind kind) { return kKindNames[static_cast<std::size_t>(kind)]; }

const Handle* handle_of(const void* pointer) { return static_cast<const Handle*>(pointer); }

}  // namespace

int told(Status status) noexcept {
  const int code = static_cast<int>(status.code());
  if (!status) last_failure = std::move(status);
  return code;
}

Status check(const void* pointer) {
  if (pointer == nullptr) return {Code::invalid_argument, "a handle that is NULL"};
  if (reinterpret_cast<std::uintptr_t>(pointer) % alignof(Handle) != 0 || !handle_of(pointer)->alive())
    return {Code::invalid_argument, "a pointer that is no handle of rcbd", "was it released too often?"};
  if (!handle_of(pointer)->in_its_process())
    return {Code::unsupported,
            fmt::format("this process was forked, and the handle ({}) is its parent's",
                        name_of(handle_of(pointer)->kind())),
            "connect anew in the child"};
  return {};
}

Status check_kind(const void* pointer, Kind kind) {
  if (Status usable = check(pointer); !usable)
    return pointer != nullptr ? usable : Status(usable.code(), fmt::format("the handle ({}) is NULL", name_of(kind)));
  const Kind found = handle_of(pointer)->kind();
  if (found == kind) return {};
  return {Code::invalid_argument, fmt::format("a handle of another kind: {}, not {}", name_of(found), name_of(kind))};
}

}  // namespace rcb::c

using rcb::c::Handle;

int rcbd_version() { return RCB_VERSION_NUMBER; }

const char* rcbd_code_name(int code) {
  // The names are literals, so they end with a null character.
  if (code == RCBD_PENDING) return "pending";
  const bool known = code >= 0 && code <= std::numeric_limits<std::uint16_t>::max();
  return rcb::code_name(known ? static_cast<rcb::Code>(code) : rcb::Code::internal).data();
}

const char* rcbd_message() { return rcb::c::last_failure.message().c_str(); }
const char* rcbd_hint() { return rcb::c::last_failure.hint().c_str(); }

void* rcbd_retain(void* handle) {
  const int code = rcb::c::call([&] {
    rcb::Status usable = rcb::c::check(handle);
    if (usable) static_cast<Handle*>(handle)->retain();
    return usable;
  });
  return code == RCBD_OK ? handle : nullptr;
}

void rcbd_release(void* handle) {
  if (handle == nullptr) return;
  rcb::c::call([&] {
    rcb::Status usable = rcb::c::check(handle);
    if (usable) static_cast<Handle*>(handle)->release();
    return usable;
  });
}

int rcbd_close(void* handle) {
  return rcb::c::call([&] {
    rcb::Status usable = rcb::c::check(handle);
    return usable ? static_cast<Handle*>(handle)->close() : usable;
  });
}
