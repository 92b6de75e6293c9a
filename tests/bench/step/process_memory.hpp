// What the processes of a service hold, by the kernel's own books.
//
// Invariants
// 1. `pss`, `rss` and `peak` are sums over the processes. A page that several processes share counts in pss once, in
//    the others in each of them: less the same sums of the empty service both tell what the particles take. pss leaves
//    out pages of files, programs and libraries, whose share changes with whatever other processes use them.
// 2. `pss_peak` is the greatest sum that was sampled since the last mark(); `peak` is the sum of each process's own
//    greatest resident memory since then, which no sampling misses but which need not have been at one time.
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include <sys/types.h>

#include "common/base/status.hpp"

namespace rcb::bench {

struct MemoryReading {
  std::uint64_t pss = 0;
  std::uint64_t pss_peak = 0;
  std::uint64_t rss = 0;
  std::uint64_t peak = 0;  // VmHWM
};

// The processes of that name among the descendants of this one.
std::vector<pid_t> descendants(const std::string& name);

class MemoryWatch {
 public:
  // Samples from now on, on a thread of its own, until this object goes.
  explicit MemoryWatch(std::vector<pid_t> pids);
  ~MemoryWatch();
  MemoryWatch(const MemoryWatch&) = delete;
  MemoryWatch& operator=(const MemoryWatch&) = delete;

  // Peaks begin anew. Errors: io_error, where the kernel doesn't let go of the old ones.
  Status mark();
  // Errors: io_error, where a process is gone.
  Result<MemoryReading> read();

 private:
  std::uint64_t sample();  // the sum of pss, 0 if a process is gone

  std::vector<pid_t> pids_;
  std::mutex mutex_;
  std::uint64_t pss_peak_ = 0;
  std::atomic<bool> over_ = false;
  std::thread thread_;
};

}  // namespace rcb::bench
