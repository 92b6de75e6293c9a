#include "common/io/files/byte_source.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/clock.hpp"
#include "common/files/descriptor.hpp"
#include "common/io/files/input_file.hpp"

namespace rcb::io {
namespace {

constexpr int kWaitMilliseconds = 100;

Status unreadable(const std::string& name) {
  return {Code::io_error, fmt::format("{}: can't be read: {}", name, std::strerror(errno))};
}

class FileBytes final : public ByteSource {
 public:
  explicit FileBytes(InputFile file) : file_(std::move(file)) {}

  Result<std::size_t> read(char* to, std::size_t bytes) override {
    for (;;) {
      if (Status stop = file_.check_stop(); !stop) return stop;
      const ssize_t got = ::pread(file_.descriptor(), to, bytes, static_cast<off_t>(at_));
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) return unreadable(file_.path());
      at_ += static_cast<std::uint64_t>(got);
      return static_cast<std::size_t>(got);
    }
  }

 private:
  InputFile file_;
  std::uint64_t at_ = 0;
};

// A FIFO, a pipe or a terminal.
class PipeBytes final : public ByteSource {
 public:
  PipeBytes(std::string name, Descriptor pipe, Waiting waiting)
      : name_(std::move(name)), pipe_(std::move(pipe)), waiting_(std::move(waiting)) {}

  Result<std::size_t> read(char* to, std::size_t bytes) override {
    const SteadyClock clock;
    const double begin = clock.seconds();
    for (;;) {
      if (waiting_.stop != nullptr && *waiting_.stop) return Status(Code::aborted, name_ + ": reading was given up");
      // A FIFO that has had no writer yet counts as silent, not as ended.
      pollfd one{pipe_.get(), POLLIN, 0};
      const int ready = ::poll(&one, 1, kWaitMilliseconds);
      if (ready < 0 && errno != EINTR) return unreadable(name_);
      if (ready <= 0) {
        if (waiting_.on_wait) waiting_.on_wait(clock.seconds() - begin);
        continue;
      }
      const ssize_t got = ::read(pipe_.get(), to, bytes);
      if (got >= 0) return static_cast<std::size_t>(got);
      if (errno != EINTR && errno != EAGAIN) return unreadable(name_);
    }
  }

 private:
  std::string name_;
  Descriptor pipe_;
  Waiting waiting_;
};

// Gives what was read to learn the format once more.
class WithHead final : public ByteSource {
 public:
  WithHead(std::string head, std::unique_ptr<ByteSource> rest) : head_(std::move(head)), rest_(std::move(rest)) {}

  Result<std::size_t> read(char* to, std::size_t bytes) override {
    if (head_.empty()) return rest_->read(to, bytes);
    const std::size_t taken = head_.copy(to, bytes);
    head_.erase(0, taken);
    return taken;
  }

 private:
  std::string head_;
  std::unique_ptr<ByteSource> rest_;
};

Result<OpenedBytes> open_plain(const std::string& path, const Waiting& waiting) {
  const bool input = path == kStandardInput;
  OpenedBytes opened{.name = input_name(path), .bytes = nullptr};
  if (input || is_stream(path)) {
    Descriptor pipe(input ? ::fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 0)
                          : ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (!pipe.open()) return unreadable(opened.name);
    struct stat about {};
    opened.is_stream = ::fstat(pipe.get(), &about) != 0 || !S_ISREG(about.st_mode);
    opened.bytes = std::make_unique<PipeBytes>(opened.name, std::move(pipe), waiting);
    return opened;
  }
  auto file = InputFile::open(path);
  if (!file) return file.status();
  file->set_stop(waiting.stop);
  opened.bytes = std::make_unique<FileBytes>(std::move(*file));
  return opened;
}

}  // namespace

bool is_stream(const std::string& path) {
  struct stat about {};
  return path == kStandardInput || (::stat(path.c_str(), &about) == 0 && S_ISFIFO(about.st_mode));
}

Result<OpenedBytes> open_bytes(const std::string& path, const Waiting& waiting) {
  auto opened = open_plain(path, waiting);
  if (!opened) return opened;
  std::string head(kGzipMagic.size(), '\0');
  std::size_t length = 0;
  while (length < head.size()) {
    const auto got = opened->bytes->read(head.data() + length, head.size() - length);
    if (!got) return got.status();
    if (*got == 0) break;
    length += *got;
  }
  head.resize(length);
  opened->packed = head == kGzipMagic;
  opened->bytes = std::make_unique<WithHead>(std::move(head), std::move(opened->bytes));
  if (opened->packed) opened->bytes = unpacked(opened->name, std::move(opened->bytes));
  return opened;
}

}  // namespace rcb::io
