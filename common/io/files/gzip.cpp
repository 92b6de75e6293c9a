// What gzip has compressed, unpacked with zlib as it is read: RFC 1952, one member or several behind one another.
#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <zlib.h>

#include "common/io/files/byte_source.hpp"

namespace rcb::io {
namespace {

constexpr std::size_t kPackedBytes = std::size_t{64} << 10U;
constexpr int kGzipWindowBits = 15 + 16;  // zlib's way to say: the largest window, gzip's header and checksum

class GzipBytes final : public ByteSource {
 public:
  GzipBytes(std::string name, std::unique_ptr<ByteSource> packed)
      : name_(std::move(name)), packed_(std::move(packed)), buffer_(kPackedBytes) {
    ready_ = inflateInit2(&inflater_, kGzipWindowBits) == Z_OK;
  }
  GzipBytes(const GzipBytes&) = delete;
  GzipBytes& operator=(const GzipBytes&) = delete;
  ~GzipBytes() override { inflateEnd(&inflater_); }

  Result<std::size_t> read(char* to, std::size_t bytes) override {
    if (!ready_) return Status(Code::too_large, name_ + ": no memory to unpack it");
    const auto room = static_cast<unsigned>(std::min<std::size_t>(bytes, std::size_t{1} << 30U));
    for (;;) {
      const auto more = fill();
      if (!more) return more.status();
      if (!*more && between_members_) return std::size_t{0};
      if (!*more)
        return Status(Code::invalid_argument, name_ + ": its compressed data end too early",
                      "was it written, or copied, to its end?");
      if (between_members_ && !begin_member()) continue;
      inflater_.next_out = reinterpret_cast<Bytef*>(to);
      inflater_.avail_out = room;
      const int done = inflate(&inflater_, Z_NO_FLUSH);
      between_members_ = done == Z_STREAM_END;
      if (done != Z_OK && done != Z_STREAM_END && done != Z_BUF_ERROR) return damaged();
      if (inflater_.avail_out < room) return std::size_t{room - inflater_.avail_out};
    }
  }

 private:
  // False: there are no more bytes.
  Result<bool> fill() {
    if (inflater_.avail_in > 0) return true;
    const auto got = packed_->read(reinterpret_cast<char*>(buffer_.data()), buffer_.size());
    if (!got) return got.status();
    inflater_.next_in = buffer_.data();
    inflater_.avail_in = static_cast<unsigned>(*got);
    return *got > 0;
  }

  // False: these bytes were zeros, with which the last member may be padded to a whole number of blocks.
  bool begin_member() {
    if (*inflater_.next_in == 0 && !first_) {
      ++inflater_.next_in;
      --inflater_.avail_in;
      return false;
    }
    if (!first_) inflateReset(&inflater_);
    first_ = false;
    return true;
  }

  Status damaged() const {
    return {Code::invalid_argument,
            fmt::format("{}: its compressed data are damaged{}{}", name_, inflater_.msg == nullptr ? "" : ": ",
                        inflater_.msg == nullptr ? "" : inflater_.msg),
            "unpack it with gunzip, which may tell more, or compress it again"};
  }

  std::string name_;
  std::unique_ptr<ByteSource> packed_;
  std::vector<Bytef> buffer_;
  z_stream inflater_{};
  bool ready_ = false;
  bool between_members_ = true;
  bool first_ = true;  // no member has begun
};

}  // namespace

std::unique_ptr<ByteSource> unpacked(const std::string& name, std::unique_ptr<ByteSource> packed) {
  return std::make_unique<GzipBytes>(name, std::move(packed));
}

}  // namespace rcb::io
