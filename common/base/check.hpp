// CHECK: an invariant of ours, on in release too. A broken one prints what it knows and ends the process,
// so that no other rank waits for ever (mpirun takes the job down).
#pragma once

#include <string_view>

namespace rcb {

// Text put before every CHECK failure of this thread, such as "rank 3 of 8".
void set_check_context(std::string_view context);

[[noreturn]] void check_failed(const char* file, int line, const char* expression, std::string_view message);

}  // namespace rcb

#define CHECK(condition, message)                                     \
  do {                                                                \
    if (!(condition)) [[unlikely]]                                    \
      ::rcb::check_failed(__FILE__, __LINE__, #condition, (message)); \
  } while (false)
