// Writers: CSV, .npy, and trajectories.
#include <charconv>
#include <memory>
#include <string>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/check.hpp"
#include "common/io/files/output_file.hpp"
#include "common/io/points.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kWriteBytes = std::size_t{1} << 20U;
constexpr std::size_t kNumberChars = 32;  // more than any shortest double or integer needs

template <typename Number>
void append_number(std::string& text, Number value) {
  char digits[kNumberChars];
  text.append(digits, std::to_chars(digits, digits + kNumberChars, value).ptr);
}

// Version 1.0, as numpy.lib.format states it; `bytes` long, a multiple of 64.
std::string npy_head(std::string_view descr, const std::vector<std::uint64_t>& shape, std::size_t bytes = 0) {
  std::string dictionary = fmt::format("{{'descr': '{}', 'fortran_order': False, 'shape': ({}{}), }}", descr,
                                       fmt::join(shape, ", "), shape.size() == 1 ? "," : "");
  constexpr std::size_t kPreamble = 10;
  if (bytes == 0) bytes = (kPreamble + dictionary.size() + 1 + 63) / 64 * 64;
  RCB_CHECK(bytes % 64 == 0 && bytes > kPreamble + dictionary.size() && bytes < 65536, "room for the .npy header");
  dictionary.resize(bytes - kPreamble - 1, ' ');
  const auto length = static_cast<unsigned>(dictionary.size() + 1);
  std::string head("\x93NUMPY\x01\x00", 8);
  head += static_cast<char>(length & 0xFFU);
  head += static_cast<char>(length >> 8U);
  return head + dictionary + "\n";
}

template <typename Number>
std::string_view bytes_of(std::span<const Number> values) {
  return {reinterpret_cast<const char*>(values.data()), values.size_bytes()};
}

Status write_array(const std::string& path, std::string_view descr, const std::vector<std::uint64_t>& shape,
                   std::string_view bytes) {
  std::uint64_t count = 1;
  for (const std::uint64_t length : shape) count *= length;
  RCB_CHECK(count * (descr == "<i4" ? 4 : 8) == bytes.size(), "the shape of the values");
  auto file = OutputFile::create(path);
  if (!file.ok()) return file.status();
  if (Status head = file->write(npy_head(descr, shape)); !head.ok()) return head;
  if (Status body = file->write(bytes); !body.ok()) return body;
  return file->commit();
}

class NpyTrajectoryWriter final : public TrajectoryWriter {
 public:
  static constexpr std::size_t kHeadBytes = 128;

  NpyTrajectoryWriter(OutputFile file, std::uint64_t count, int dims)
      : file_(std::move(file)), count_(count), dims_(static_cast<std::uint64_t>(dims)) {}

  std::string head() const { return npy_head("<f8", {steps_, count_, dims_}, kHeadBytes); }
  Status reserve_head() { return file_.write(head()); }

  Status append(std::span<const double> positions) override {
    RCB_CHECK(!closed_ && positions.size() == count_ * dims_, "a frame has count * dims numbers");
    Status written = file_.write(bytes_of(positions));
    // A frame written in part would shift all later ones: close() then refuses the file.
    if (written.ok()) ++steps_;
    failed_ = failed_ || !written.ok();
    return written;
  }
  Status close() override {
    RCB_CHECK(!closed_, "a trajectory is closed once");
    closed_ = true;
    if (failed_) return Status(Code::io_error, "the trajectory is not kept, since one of its frames was not written");
    if (Status done = file_.write_at_begin(head()); !done.ok()) return done;
    return file_.commit();
  }

 private:
  OutputFile file_;
  std::uint64_t count_;
  std::uint64_t dims_;
  std::uint64_t steps_ = 0;
  bool closed_ = false;
  bool failed_ = false;
};

}  // namespace

CsvWriter::CsvWriter(OutputFile file, int dims, bool ids, bool weights, const std::string& further)
    : file_(std::move(file)), dims_(dims), ids_(ids), weights_(weights) {
  RCB_CHECK(dims >= 1 && dims <= 3, "dimensions");
  text_ = std::string("x,y,z").substr(0, static_cast<std::size_t>(dims) * 2 - 1);
  if (ids) text_ += ",id";
  if (weights) text_ += ",weight";
  text_ += further;
  text_ += '\n';
}

Status CsvWriter::append(std::span<const double* const> position, std::size_t count, std::span<const std::int64_t> id,
                         std::span<const double> weight, std::span<const std::string_view> further) {
  RCB_CHECK(position.size() >= static_cast<std::size_t>(dims_), "an array for each axis");
  RCB_CHECK((!ids_ || id.size() == count) && (!weights_ || weight.size() == count) &&
                (further.empty() || further.size() == count),
            "a value for each point");
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t a = 0; a < static_cast<std::size_t>(dims_); ++a) {
      if (a > 0) text_ += ',';
      append_number(text_, position[a][i]);
    }
    if (ids_) append_number(text_ += ',', id[i]);
    if (weights_) append_number(text_ += ',', weight[i]);
    if (!further.empty()) text_ += further[i];
    text_ += '\n';
    if (text_.size() < kWriteBytes) continue;
    if (Status written = flush(); !written.ok()) return written;
  }
  return {};
}

Status CsvWriter::flush() {
  Status written = file_.write(text_);
  text_.clear();
  return written;
}

Status CsvWriter::commit() {
  if (Status written = flush(); !written.ok()) return written;
  return file_.commit();
}

Status write_npy(const std::string& path, std::span<const std::int32_t> values) {
  return write_array(path, "<i4", {values.size()}, bytes_of(values));
}

Status write_npy(const std::string& path, std::span<const std::int64_t> values) {
  return write_array(path, "<i8", {values.size()}, bytes_of(values));
}

Status write_npy(const std::string& path, std::span<const double> values, std::vector<std::uint64_t> shape) {
  return write_array(path, "<f8", shape, bytes_of(values));
}

Result<std::unique_ptr<TrajectoryWriter>> TrajectoryWriter::create(const std::string& path, std::uint64_t count,
                                                                   int dims) {
  auto file = OutputFile::create(path);
  if (!file.ok()) return file.status();
  if (!file->regular()) {
    return Status(Code::io_error, path + ": is no regular file, and a trajectory's header is completed at its end",
                  "name a file");
  }
  auto writer = std::make_unique<NpyTrajectoryWriter>(std::move(*file), count, dims);
  if (Status head = writer->reserve_head(); !head.ok()) return head;
  return std::unique_ptr<TrajectoryWriter>(std::move(writer));
}

}  // namespace rcb::io
