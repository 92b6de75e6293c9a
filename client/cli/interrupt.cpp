#include "client/cli/interrupt.hpp"

#include <csignal>

#include "client/cli/print/output.hpp"
#include "common/base/signals.hpp"

namespace rcb::cli {
namespace {

std::atomic<bool> g_interrupted{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set in a signal handler");

}  // namespace

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { g_interrupted = true; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  handle_unless_ignored(SIGINT, action);
}

bool interrupted() { return g_interrupted; }
const std::atomic<bool>& interrupt_flag() { return g_interrupted; }

Status interruption(const std::string& where) { return {Code::interrupted, "interrupted " + where}; }

bool go_on_waiting() {
  Progress::tick();
  return !g_interrupted;
}

}  // namespace rcb::cli
