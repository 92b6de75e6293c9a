// Ctrl-C in a command that can end in good order: the first one sets a flag, so that the command stops where it can,
// writes what it has, says where it stood, and exits with 130. A second one ends the program at once.
#pragma once

#include <atomic>
#include <string>

#include "common/base/status.hpp"

namespace rcb::cli {

// From here on. Nothing changes where Ctrl-C is ignored, as for what a script runs in the background.
void catch_interrupts();
bool interrupted();
// The flag itself, for readers of files (io::ReadOptions::stop).
const std::atomic<bool>& interrupt_flag();
// The failure of a command that was interrupted. where: what was under way, and what stands of it.
Status interruption(const std::string& where);

// client::ConnectOptions::on_wait of every connection: shows that time passes, and ends the call after Ctrl-C.
bool go_on_waiting();

}  // namespace rcb::cli
