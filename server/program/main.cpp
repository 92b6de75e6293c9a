// rcbd's main program: the options, MPI, and what all ranks agree on before each runs its part. Rank 0 opens the
// sockets and tells the others through MPI where its doorbell listens; then all ranks execute orders until the
// shutdown.
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <memory>

#include <fmt/format.h>
#include <malloc.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include "common/base/child.hpp"
#include "common/files/paths.hpp"
#include "common/openssl/openssl.hpp"
#include "server/net/files/log_sink.hpp"
#include "server/program/client_folders.hpp"
#include "server/program/config.hpp"
#include "server/program/direct_path.hpp"
#include "server/program/hosts.hpp"
#include "server/program/job.hpp"
#include "server/program/rank.hpp"
#include "server/ranks/mpi_session.hpp"
#include "server/ranks/shared_collectives.hpp"

namespace rcb::server {
namespace {

void set_log_pattern(const std::string& who) {
  spdlog::set_pattern(fmt::format("%Y-%m-%dT%H:%M:%S.%e%z {} %l: %v", who));
}

void set_up_log(const Config& config, int rank) {
  auto log = std::make_shared<spdlog::logger>("rcbd", std::make_shared<net::LogSink>(STDERR_FILENO));
  spdlog::set_default_logger(log);
  spdlog::set_level(spdlog::level::from_str(config.log_level));
  set_log_pattern(fmt::format("rank {}", rank));
}

// Signals reach all ranks at once; only rank 0 acts on them, through its I/O thread.
void set_up_signals(int rank) {
  // What whoever started this process ignores or blocks is inherited: ended children and alarms that are missed.
  keep_ended_children();
  std::signal(SIGALRM, SIG_DFL);
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  // A write that fails tells why; it ends no process.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  if (ranks::started_by_mpirun()) end_with_mpirun(rank);
  if (rank == 0) return;
  for (const int number : {SIGTERM, SIGINT, SIGUSR1}) std::signal(number, SIG_IGN);
}

// The memory of one step serves the next one. By default the allocator returns arrays of this size to the kernel at
// once, which must clear new pages for them at each step.
void keep_freed_memory() {
  constexpr int kMappedBytesMin = 32 << 20;
  constexpr int kKeptBytesMax = 64 << 20;
  ::mallopt(M_MMAP_THRESHOLD, kMappedBytesMin);
  ::mallopt(M_TRIM_THRESHOLD, kKeptBytesMax);
}

int run(int argc, char** argv) {
  const ParsedConfig parsed = parse_config(argc, argv);
  if (!parsed.run) {
    // Another machine may refuse what rank 0's takes.
    const char* launcher = std::getenv(kLauncherHostVariable);
    if (ranks::rank_from_environment() != 0 && launcher != nullptr && host_name() != launcher)
      std::fprintf(stderr, "on %s: %s", host_name().c_str(), parsed.error.c_str());
    if (ranks::rank_from_environment() != 0) return parsed.exit_code;
    std::fputs(parsed.out.c_str(), stdout);
    std::fputs(parsed.error.c_str(), stderr);
    return parsed.exit_code;
  }
  keep_freed_memory();
  raise_open_files_limit();
  set_up_signals(ranks::rank_from_environment());
  if (const Status opened = open_openssl(); !opened.ok()) {  // for proofs between ranks, too
    say_failure(opened);
    return 1;
  }
  auto mpi = ranks::MpiSession::start(&argc, &argv);
  if (!mpi.ok()) {
    if (ranks::rank_from_environment() == 0) say_failure(mpi.status());
    return 1;
  }
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // which tell more
  end_at_faults(mpi->rank());
#endif
  if (const Status allocated = mpi->allocate_shared_memory(); !allocated.ok()) {
    if (mpi->rank() == 0) say_failure(allocated);
    return 1;
  }
  set_up_log(parsed.config, mpi->rank());
  set_check_context(fmt::format("rank {} of {}", mpi->rank(), mpi->size()));
  // Rank 0's option applies to all ranks, since their collectives must match.
  const std::string names = mpi->share(parsed.config.no_skip);
  const auto no_skip = service::NoSkip::parse(names);
  RCB_CHECK(no_skip.ok(), no_skip.status().message());
  if (!names.empty() && mpi->rank() == 0) spdlog::warn("for measurement only: '{}' isn't skipped", names);
  if (!mpi->shares_memory() && mpi->rank() == 0)
    spdlog::info("some machine's ranks can't share memory, or are more than {}: sums over ranks take longer, by MPI",
                 ranks::SharedCollectives::kRanksMax);
  const Hosts hosts = find_hosts(*mpi);
  if (hosts.several)
    set_log_pattern(fmt::format("{} rank {}", hosts.ranks[static_cast<std::size_t>(mpi->rank())].host, mpi->rank()));
  const auto folders = open_client_folders(parsed.config, *mpi, hosts);
  if (!folders.ok()) {
    if (mpi->rank() == 0) say_failure(folders.status());
    return 1;
  }
  const RankSetup setup{parsed.config,
                        *mpi,
                        hosts,
                        {.no_skip = *no_skip, .roots = *folders, .bulk_bytes_max = bulk_bytes(parsed.config)}};
  return mpi->rank() == 0 ? run_rank_0(setup) : run_other_rank(setup);
}

}  // namespace
}  // namespace rcb::server

int main(int argc, char** argv) { return rcb::server::run(argc, argv); }
