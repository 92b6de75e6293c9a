// Tells what is wrong with a command line, in plain words.
#pragma once

#include <CLI/CLI.hpp>

#include "common/base/status.hpp"

namespace rcb::cli {

// Why the parser refused the line, and which --help to read.
Status usage_failure(const CLI::App& app, const CLI::ParseError& error);

}  // namespace rcb::cli
