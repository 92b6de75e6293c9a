// ByteSource: the bytes of a text from its beginning to its end, of a file, a FIFO or standard input, unpacked where
// gzip has compressed them.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::io {

class ByteSource {
 public:
  virtual ~ByteSource() = default;
  // Reads at least one byte and at most `bytes` (> 0); 0: the end. Waits for a writer as long as there is one. Errors:
  // io_error; invalid_argument for compressed data that are damaged or cut short; aborted, once the wait was given up.
  virtual Result<std::size_t> read(char* to, std::size_t bytes) = 0;
};

// How to wait for a FIFO or standard input.
struct Waiting {
  const std::atomic<bool>* stop = nullptr;           // once it is set, nothing more is read; may be null
  std::function<void(double seconds)> on_wait = {};  // called a few times a second while nothing comes; may be empty
};

struct OpenedBytes {
  std::string name;        // for messages
  bool is_stream = false;  // comes from a FIFO or through a pipe: its end is that of its writers
  bool packed = false;     // by gzip
  std::unique_ptr<ByteSource> bytes;
};

inline constexpr const char* kStandardInput = "-";
inline constexpr std::string_view kGzipMagic = "\x1F\x8B";

// For messages.
inline std::string input_name(const std::string& path) { return path == kStandardInput ? "standard input" : path; }
// Whether that path is read once, from beginning to end: kStandardInput or a FIFO. A FIFO must not be opened before it
// is read: when it is closed again, its writer ends.
bool is_stream(const std::string& path);
// Errors: those of InputFile::open.
Result<OpenedBytes> open_bytes(const std::string& path, const Waiting& waiting);
// name: for messages.
std::unique_ptr<ByteSource> unpacked(const std::string& name, std::unique_ptr<ByteSource> packed);

}  // namespace rcb::io
