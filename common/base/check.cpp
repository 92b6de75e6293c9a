#include "common/base/check.hpp"

#include <cstdio>
#include <cstdlib>
#include <string>

namespace rcb {
namespace {
thread_local std::string check_context;
}

void set_check_context(std::string_view context) { check_context = context; }

void check_failed(const char* file, int line, const char* expression, std::string_view message) {
  std::fprintf(stderr, "rcb: bug: %s%s%s:%d: CHECK(%s) failed: %.*s\n", check_context.c_str(),
               check_context.empty() ? "" : ": ", file, line, expression, static_cast<int>(message.size()),
               message.data());
  std::fflush(stderr);
  std::abort();
}

}  // namespace rcb
