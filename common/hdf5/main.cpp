// rcb_read_hdf5: reads points from the HDF5 file that is its standard input (common/io/formats/hdf5_answer.hpp).
// Started by rcbd, rcbctl and the solvers, not by people.
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <new>
#include <span>
#include <string>

#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "common/files/read_write.hpp"
#include "common/hdf5/read.hpp"
#include "common/io/files/roots.hpp"
#include "common/io/formats/hdf5_answer.hpp"

namespace {

using rcb::Code;
using rcb::Status;
using rcb::io::Hdf5Head;

bool put(const void* from, std::size_t bytes) {
  return rcb::write_all(STDOUT_FILENO, {static_cast<const char*>(from), bytes});
}

bool tell(const Status& failure) {
  const std::string message = failure.message().substr(0, rcb::io::kHdf5TextBytesMax);
  const std::string hint = failure.hint().substr(0, rcb::io::kHdf5TextBytesMax);
  Hdf5Head head;
  head.code = static_cast<std::uint32_t>(failure.code());
  head.message_bytes = static_cast<std::uint32_t>(message.size());
  head.hint_bytes = static_cast<std::uint32_t>(hint.size());
  return put(&head, sizeof head) && put(message.data(), message.size()) && put(hint.data(), hint.size());
}

Status send(const rcb::io::Points& points) {
  Hdf5Head head;
  head.dims = static_cast<std::uint16_t>(points.dims);
  head.weighted = points.weight.empty() ? 0 : 1;
  head.has_ids = points.id.empty() ? 0 : 1;
  head.count = points.count;
  bool sent = put(&head, sizeof head);
  for (const auto& axis : points.position) sent = sent && put(axis.data(), axis.size() * sizeof(double));
  if (!points.position.empty())
    sent = sent && put(points.weight.data(), points.weight.size() * sizeof(double)) &&
           put(points.id.data(), points.id.size() * sizeof(std::int64_t));
  if (!sent) return {Code::io_error, "nobody reads what is read"};
  return {};
}

// What a hostile file can do to this process isn't to cost others anything.
void give_way() {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  const rlimit none{0, 0};
  ::setrlimit(RLIMIT_CORE, &none);
  if (std::FILE* score = std::fopen("/proc/self/oom_score_adj", "w"); score != nullptr) {
    std::fputs("1000", score);  // where memory runs out, this process goes first
    std::fclose(score);
  }
}

Status run(std::span<char*> arguments) {
  auto file = rcb::io::InputFile::take(rcb::Descriptor(STDIN_FILENO), arguments[0]);
  if (!file.ok()) return file.status();
  const rcb::io::Roots none;
  rcb::io::ReadOptions options;
  options.dims = std::atoi(arguments[4]);
  options.weights = arguments[5];
  options.ids = arguments[6];
  options.bytes_max = std::strtoull(arguments[7], nullptr, 10);
  options.below = arguments[8] == std::string("1") ? &none : nullptr;
  for (const char* column : arguments.subspan(rcb::io::kHdf5Arguments)) options.columns.emplace_back(column);
  return rcb::hdf5::read(*file, arguments[1], options, std::atoi(arguments[2]), std::atoi(arguments[3]), send);
}

}  // namespace

int main(int argc, char** argv) {
  const std::span arguments(argv + 1, static_cast<std::size_t>(std::max(0, argc - 1)));
  if (arguments.size() < rcb::io::kHdf5Arguments || ::isatty(STDOUT_FILENO) != 0) {
    std::fputs("rcb_read_hdf5 reads HDF5 files for rcbd and rcbctl, which start it: rcbctl push SCENE FILE.h5:/PATH\n",
               stderr);
    return 2;
  }
  give_way();
  Status done;
  try {
    done = run(arguments);
  } catch (const std::bad_alloc&) {
    done = Status(Code::too_large, arguments[0] + std::string(": no memory for its points"));
  }
  const bool told = done.ok() || tell(done);
  ::_exit(told ? 0 : 1);  // nothing of libhdf5's is cleaned up: it may not stand
}
