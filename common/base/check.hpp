// RCB_CHECK: an invariant of our own code, checked in release builds too. If it is broken, the process prints the place
// and aborts, so that no other rank waits for it for ever (mpirun then ends the job).
#pragma once

#include <string_view>

namespace rcb {

// A text printed before every RCB_CHECK failure of this thread, such as "rank 3 of 8".
void set_check_context(std::string_view context);

[[noreturn]] void check_failed(const char* file, int line, const char* expression, std::string_view message);

}  // namespace rcb

#define RCB_CHECK(condition, message)                                 \
  do {                                                                \
    if (!(condition)) [[unlikely]]                                    \
      ::rcb::check_failed(__FILE__, __LINE__, #condition, (message)); \
  } while (false)
