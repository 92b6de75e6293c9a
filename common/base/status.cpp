#include "common/base/status.hpp"

#include <array>

namespace rcb {
namespace {

struct Entry {
  Code code;
  std::string_view name;
};

constexpr std::array kEntries{
    Entry{Code::ok, "ok"},
    Entry{Code::invalid_argument, "invalid_argument"},
    Entry{Code::not_found, "not_found"},
    Entry{Code::already_exists, "already_exists"},
    Entry{Code::busy, "busy"},
    Entry{Code::stale_step, "stale_step"},
    Entry{Code::not_finite, "not_finite"},
    Entry{Code::protocol_error, "protocol_error"},
    Entry{Code::too_large, "too_large"},
    Entry{Code::not_authorised, "not_authorised"},
    Entry{Code::unavailable, "unavailable"},
    Entry{Code::deadline_exceeded, "deadline_exceeded"},
    Entry{Code::aborted, "aborted"},
    Entry{Code::io_error, "io_error"},
    Entry{Code::unsupported, "unsupported"},
    Entry{Code::internal, "internal"},
    Entry{Code::usage, "usage"},
    Entry{Code::interrupted, "interrupted"},
    Entry{Code::not_conserved, "not_conserved"},
    Entry{Code::duplicate_id, "duplicate_id"},
};

}  // namespace

std::string_view code_name(Code code) {
  for (const Entry& entry : kEntries)
    if (entry.code == code) return entry.name;
  return "internal";
}

Code code_from_name(std::string_view name) {
  for (const Entry& entry : kEntries)
    if (entry.name == name) return entry.code;
  return Code::internal;
}

int exit_code(Code code) {
  switch (code) {
    case Code::ok:
      return 0;
    case Code::usage:
      return 2;
    case Code::unavailable:
      return 3;
    case Code::not_authorised:
      return 4;
    case Code::deadline_exceeded:
      return 5;
    case Code::interrupted:
      return 130;  // as a shell reports what SIGINT ended
    default:
      return 1;
  }
}

}  // namespace rcb
