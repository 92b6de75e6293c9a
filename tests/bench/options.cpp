#include "tests/bench/options.hpp"

#include <cstdio>

#include "common/base/cpu.hpp"

namespace rcb::bench {

int run_program(CLI::App& app, int argc, char** argv, const std::function<Status()>& run) {
  Status status;
  try {
    app.parse(argc, argv);
    status = cpu_is_known() ? run() : Status(Code::usage, kUnknownCpu);
  } catch (const CLI::Success& done) {
    return app.exit(done);
  } catch (const CLI::ParseError& error) {
    status = {Code::usage, error.what(), app.get_name() + " --help"};
  }
  if (status.ok()) return 0;
  fmt::print(stderr, "{}: {}\n", app.get_name(), status.message());
  if (!status.hint().empty()) fmt::print(stderr, "  {}\n", status.hint());
  return exit_code(status.code());
}

}  // namespace rcb::bench
