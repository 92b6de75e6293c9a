#include "common/io/formats/hdf5_file.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/child.hpp"
#include "common/base/clock.hpp"
#include "common/files/descriptor.hpp"
#include "common/io/formats/hdf5_answer.hpp"

extern char** environ;

namespace rcb::io {
namespace {

constexpr double kSilenceSeconds = 600;  // chunks are all unpacked once before the first point is sent
constexpr int kPollMilliseconds = 50;    // between looks at the order to stop

// rcb_read_hdf5 beside this program, or where it is installed; else its name alone, for PATH.
std::string program() {
  std::error_code error;
  const auto folder = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  for (const char* place : {"", "../lib/rcbd"})
    if (const auto there = folder / place / kHdf5Program; ::access(there.c_str(), X_OK) == 0) return there.string();
  return kHdf5Program;
}

// The reading program at work; killed at the end of this object.
class Reader {
 public:
  explicit Reader(const InputFile& file) : file_(file) {}
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  ~Reader() { end(); }

  Status start(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), program());
    std::array<int, 2> ends{-1, -1};
    if (::pipe2(ends.data(), O_CLOEXEC) != 0)
      return {Code::io_error, fmt::format("{}: no pipe: {}", file_.path(), std::strerror(errno))};
    from_ = Descriptor(ends[0]);
    const Descriptor to(ends[1]);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, file_.descriptor(), STDIN_FILENO);
    posix_spawn_file_actions_adddup2(&actions, to.get(), STDOUT_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    posix_spawn_file_actions_addclosefrom_np(&actions, STDERR_FILENO + 1);
    posix_spawnattr_t how;
    posix_spawnattr_init(&how);
    sigset_t signals;
    sigfillset(&signals);
    posix_spawnattr_setsigdefault(&how, &signals);
    sigemptyset(&signals);
    posix_spawnattr_setsigmask(&how, &signals);
    posix_spawnattr_setflags(&how, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
    std::vector<char*> argv, variables;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    for (char** entry = environ; *entry != nullptr; ++entry)  // no token for a process that a file may take over
      if (!std::string_view(*entry).starts_with("RCBD_")) variables.push_back(*entry);
    variables.push_back(nullptr);
    const int fault = ::posix_spawnp(&process_, argv[0], &actions, &how, argv.data(), variables.data());
    posix_spawnattr_destroy(&how);
    posix_spawn_file_actions_destroy(&actions);
    if (fault == 0) return {};
    process_ = -1;
    if (fault != ENOENT)
      return {Code::io_error,
              fmt::format("{}: {} can't be started: {}", file_.path(), kHdf5Program, std::strerror(fault))};
    return {Code::unsupported,
            fmt::format("{}: {}, which reads HDF5 files, is neither beside this program nor in PATH", file_.path(),
                        kHdf5Program),
            "it is built with rcbd: copy it along"};
  }

  // The next bytes of its answer.
  Status take(void* to, std::size_t bytes) {
    auto* next = static_cast<std::byte*>(to);
    const SteadyClock clock;
    double end = clock.seconds() + kSilenceSeconds;
    while (bytes > 0) {
      if (Status stop = file_.check_stop(); !stop.ok()) return stop;
      pollfd ready{from_.get(), POLLIN, 0};
      if (::poll(&ready, 1, kPollMilliseconds) <= 0) {
        if (clock.seconds() < end) continue;
        return {Code::deadline_exceeded,
                fmt::format("{}: nothing could be read for {} s", file_.path(), kSilenceSeconds),
                "is the HDF5 file damaged, or on a disk that doesn't answer?"};
      }
      const ssize_t got = ::read(from_.get(), next, bytes);
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) return broken();
      next += got;
      bytes -= static_cast<std::size_t>(got);
      end = clock.seconds() + kSilenceSeconds;
    }
    return {};
  }

  // What ends the answer too early or makes no sense.
  Status broken() {
    const int status = end();
    if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL)
      return {Code::io_error, fmt::format("{}: its reader was killed", file_.path()),
              "did the machine run out of memory?"};
    return {Code::io_error, file_.path() + ": can't be read; the HDF5 file is damaged", "write it again"};
  }

 private:
  // How the process ended, 0 if it had to be killed; nothing is left of it.
  int end() {
    if (process_ < 0) return 0;
    from_ = {};                        // so it ends where it still writes
    constexpr double kSeconds = 0.02;  // after the end of its answer it needs a moment to die of whatever ended that
    return wait_or_kill(std::exchange(process_, -1), kSeconds).value_or(0);
  }

  const InputFile& file_;
  Descriptor from_;
  pid_t process_ = -1;
};

// The next head. A failure that the reader tells is returned as such.
Result<Hdf5Head> take_head(Reader& reader) {
  Hdf5Head head;
  if (Status taken = reader.take(&head, sizeof head); !taken.ok()) return taken;
  if (head.code == 0) return head;
  if (head.code > static_cast<std::uint32_t>(Code::usage) || head.message_bytes > kHdf5TextBytesMax ||
      head.hint_bytes > kHdf5TextBytesMax)
    return reader.broken();
  std::string message(head.message_bytes, '\0'), hint(head.hint_bytes, '\0');
  for (std::string* text : {&message, &hint})
    if (Status taken = reader.take(text->data(), text->size()); !taken.ok()) return taken;
  return Status(static_cast<Code>(head.code), std::move(message), std::move(hint));
}

}  // namespace

std::optional<std::pair<std::string, std::string>> split_hdf5_path(const std::string& path) {
  const std::size_t colon = path.find(":/");
  if (colon == std::string::npos) return std::nullopt;
  return std::pair(path.substr(0, colon), path.substr(colon + 1));
}

Result<Points> read_hdf5(const InputFile& file, const std::string& dataset, const ReadOptions& options, int k, int of) {
  if (Status stop = file.check_stop(); !stop.ok()) return stop;
  if (!file.starts_with(kHdf5Magic))
    return Status(Code::invalid_argument, file.path() + ": is not an HDF5 file", "give FILE.h5:/PATH");
  Reader reader(file);
  std::vector<std::string> arguments{file.path(),
                                     dataset,
                                     std::to_string(k),
                                     std::to_string(of),
                                     std::to_string(options.dims),
                                     options.weights,
                                     options.ids,
                                     std::to_string(options.bytes_max),
                                     options.below != nullptr ? "1" : "0"};
  arguments.insert(arguments.end(), options.columns.begin(), options.columns.end());
  if (Status started = reader.start(std::move(arguments)); !started.ok()) return started;
  const auto whole = take_head(reader);
  if (!whole.ok()) return whole.status();
  // It isn't believed: points that a file of this size can't hold are none.
  if (whole->dims < 1 || whole->dims > 3 || whole->count / kHdf5ShrinkMax > file.size()) return reader.broken();
  Columns columns;
  columns.dims = static_cast<int>(whole->dims);
  columns.weight = whole->weighted != 0 ? 0 : kNoColumn;
  columns.id = whole->has_ids != 0 ? 0 : kNoColumn;
  if (Status fits = check_bytes(file.path(), u128{whole->count} * point_bytes(columns), options); !fits.ok())
    return fits;
  Points points = make_points(columns, static_cast<std::size_t>(whole->count));
  for (std::size_t done = 0; done < points.count;) {
    const auto block = take_head(reader);
    if (!block.ok()) return block.status();
    if (block->count == 0 || block->count > points.count - done) return reader.broken();
    const auto bytes = static_cast<std::size_t>(block->count) * sizeof(double);
    for (auto& axis : points.position)
      if (Status taken = reader.take(axis.data() + done, bytes); !taken.ok()) return taken;
    if (columns.weighted())
      if (Status taken = reader.take(points.weight.data() + done, bytes); !taken.ok()) return taken;
    if (!points.id.empty())
      if (Status taken = reader.take(points.id.data() + done, bytes); !taken.ok()) return taken;
    if (std::any_of(points.id.begin(), points.id.end(), [](std::int64_t id) { return id < 0; })) return reader.broken();
    done += static_cast<std::size_t>(block->count);
  }
  return points;
}

}  // namespace rcb::io
