#include "common/hdf5/chunks.hpp"

#include <algorithm>
#include <optional>
#include <vector>

#include <zlib.h>

#include "common/base/buffer.hpp"

namespace rcb::hdf5 {
namespace {

Status damaged(const std::string& where) {
  return Status(Code::io_error, where + ": one of its chunks is damaged", "write the HDF5 file again");
}

// The filters in the order of packing; nullopt if one is unknown.
std::optional<std::vector<H5Z_filter_t>> known_filters(hid_t plist) {
  std::vector<H5Z_filter_t> filters;
  const int count = H5Pget_nfilters(plist);
  for (int i = 0; i < count; ++i) {
    unsigned flags = 0, config = 0;
    std::size_t values = 0;
    const H5Z_filter_t filter =
        H5Pget_filter2(plist, static_cast<unsigned>(i), &flags, &values, nullptr, 0, nullptr, &config);
    const bool known = filter == H5Z_FILTER_DEFLATE || filter == H5Z_FILTER_SHUFFLE || filter == H5Z_FILTER_FLETCHER32;
    if (!known || std::count(filters.begin(), filters.end(), filter) != 0) return std::nullopt;
    filters.push_back(filter);
  }
  return filters;
}

// The unpacked size of a deflate stream; nullopt if it is damaged, cut short or larger than `most`.
std::optional<std::uint64_t> inflated_size(Buffer<unsigned char>& packed, std::size_t size, std::uint64_t most) {
  z_stream stream{};
  if (inflateInit(&stream) != Z_OK) return std::nullopt;
  Buffer<unsigned char> out(std::size_t{64} << 10U);
  stream.next_in = packed.data();
  std::uint64_t total = 0;
  std::size_t given = 0;
  int state = Z_OK;
  while (state == Z_OK && total <= most) {
    if (stream.avail_in == 0) {
      stream.avail_in = static_cast<uInt>(std::min<std::size_t>(size - given, 1U << 30U));
      given += stream.avail_in;
    }
    stream.next_out = out.data();
    stream.avail_out = static_cast<uInt>(out.size());
    state = inflate(&stream, Z_NO_FLUSH);
    total += out.size() - stream.avail_out;
  }
  inflateEnd(&stream);
  return state == Z_STREAM_END && total <= most ? std::optional(total) : std::nullopt;
}

class ChunkCheck {
 public:
  ChunkCheck(hid_t dataset, const std::vector<H5Z_filter_t>& filters, std::uint64_t chunk_bytes,
             std::uint64_t file_bytes)
      : dataset_(dataset), filters_(filters), chunk_bytes_(chunk_bytes), file_bytes_(file_bytes) {}

  // Checks the chunk at `offset`. Returns 0: missing; 1: good; -1: damaged.
  int check(const std::array<hsize_t, 2>& offset) {
    hsize_t stored = 0;
    if (H5Dget_chunk_storage_size(dataset_, offset.data(), &stored) < 0) return -1;
    if (stored == 0) return 0;
    if (stored > file_bytes_) return -1;
    if (filters_.empty()) return stored == chunk_bytes_ ? 1 : -1;
    packed_.resize(static_cast<std::size_t>(stored));
    std::uint32_t skipped = 0;
    if (H5Dread_chunk(dataset_, H5P_DEFAULT, offset.data(), &skipped, packed_.data()) < 0) return -1;
    std::uint64_t size = stored;
    for (std::size_t i = filters_.size(); i-- > 0;) {
      if ((skipped >> i & 1U) != 0) continue;
      if (filters_[i] == H5Z_FILTER_FLETCHER32) {
        if (size < kFletcherBytes) return -1;
        size -= kFletcherBytes;
      } else if (filters_[i] == H5Z_FILTER_DEFLATE) {
        const auto inflated = inflated_size(packed_, static_cast<std::size_t>(size), chunk_bytes_ + kFletcherBytes);
        if (!inflated) return -1;
        size = *inflated;
      }
    }
    return size == chunk_bytes_ ? 1 : -1;
  }

 private:
  static constexpr std::uint64_t kFletcherBytes = 4;

  hid_t dataset_;
  const std::vector<H5Z_filter_t>& filters_;
  std::uint64_t chunk_bytes_;
  std::uint64_t file_bytes_;
  Buffer<unsigned char> packed_;
};

}  // namespace

Status check_chunks(const io::InputFile& file, const std::string& where, hid_t dataset, hid_t create_plist,
                    const ChunkGrid& grid, std::uint64_t begin, std::uint64_t end) {
  const auto filters = known_filters(create_plist);
  if (!filters) {
    return Status(Code::invalid_argument, where + ": is packed by a filter that isn't known here",
                  "write it again with gzip, or unpacked (h5repack -f NONE)");
  }
  const std::uint64_t chunk_bytes = grid.chunk[0] * grid.chunk[1] * grid.type_bytes;
  ChunkCheck chunks(dataset, *filters, chunk_bytes, grid.file_bytes);
  for (std::uint64_t row = begin - begin % grid.chunk[0]; row < end; row += grid.chunk[0]) {
    if (Status stop = file.check_stop(); !stop.ok()) return stop;
    for (std::uint64_t column = 0; column < grid.shape[1]; column += grid.chunk[1]) {
      const int state = chunks.check({row, column});
      if (state < 0) return damaged(where);
      if (state > 0) continue;
      return Status(Code::invalid_argument, where + ": some of its rows were never written",
                    "wait until the file is complete, or write it again");
    }
  }
  return {};
}

}  // namespace rcb::hdf5
