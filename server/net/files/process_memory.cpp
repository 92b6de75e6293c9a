#include "server/net/files/process_memory.hpp"

#include <fstream>

#include <unistd.h>

namespace rcb::net {

std::uint64_t resident_bytes() {
  std::ifstream in("/proc/self/statm");
  std::uint64_t all_pages = 0, resident_pages = 0;
  if (!(in >> all_pages >> resident_pages)) return 0;
  return resident_pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
}

}  // namespace rcb::net
