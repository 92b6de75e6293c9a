#include "common/base/check.hpp"

#include <algorithm>
#include <climits>
#include <cstdio>
#include <cstdlib>
#include <string>

#include <poll.h>
#include <unistd.h>

namespace rcb {
namespace {
thread_local std::string check_context;
}

void set_check_context(std::string_view context) { check_context = context; }

void check_failed(const char* file, int line_number, const char* expression, std::string_view message) {
  char line[PIPE_BUF];
  const int bytes = std::snprintf(line, sizeof line, "rcb: bug: %s%s%s:%d: RCB_CHECK(%s) failed: %.*s\n",
                                  check_context.c_str(), check_context.empty() ? "" : ": ", file, line_number,
                                  expression, static_cast<int>(message.size()), message.data());
  // The reader of stderr may be a stopped process: write only if that can't block, so that this process surely ends.
  pollfd fd{STDERR_FILENO, POLLOUT, 0};
  if (poll(&fd, 1, 0) > 0 && (fd.revents & POLLOUT) != 0)
    (void)!write(STDERR_FILENO, line, std::min(sizeof line - 1, static_cast<std::size_t>(std::max(bytes, 0))));
  std::abort();
}

}  // namespace rcb
