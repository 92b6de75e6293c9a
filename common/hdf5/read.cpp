#include "common/hdf5/read.hpp"

#include <algorithm>
#include <array>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <hdf5.h>

#include "common/base/buffer.hpp"
#include "common/base/wide.hpp"
#include "common/hdf5/chunks.hpp"
#include "common/io/formats/hdf5_answer.hpp"

namespace rcb::hdf5 {
namespace {

using io::Columns;
using io::InputFile;
using io::Points;
using io::ReadOptions;

constexpr std::size_t kBlockBytes = std::size_t{1} << 20U;
class Handle {
 public:
  Handle(hid_t id, herr_t (*close)(hid_t)) : id_(id), close_(close) {}
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  bool ok() const { return id_ >= 0; }
  hid_t id() const { return id_; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

// HDF5 prints every error to stderr unless told not to, in each thread.
void silence() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

struct Contents {
  std::vector<std::string> datasets;
  int links = 0;  // looked at
};

herr_t note_dataset(hid_t file, const char* name, const H5L_info_t* link, void* contents) {
  constexpr std::size_t kNamesMax = 12;
  constexpr int kLinksMax = 1000;
  auto& found = *static_cast<Contents*>(contents);
  if (++found.links > kLinksMax) return 1;
  if (link->type != H5L_TYPE_HARD) return 0;  // others may lead anywhere
  const Handle object(H5Oopen(file, name, H5P_DEFAULT), H5Oclose);
  if (object.ok() && H5Iget_type(object.id()) == H5I_DATASET) found.datasets.push_back("/" + io::shown(name));
  return found.datasets.size() < kNamesMax ? 0 : 1;
}

std::string what_it_has(hid_t file, const ReadOptions& options) {
  if (options.below != nullptr) return "name one that it has";
  Contents found;
  H5Lvisit(file, H5_INDEX_NAME, H5_ITER_INC, note_dataset, &found);
  return found.datasets.empty() ? "it has no datasets" : fmt::format("it has {}", fmt::join(found.datasets, ", "));
}

// Refuses links to other files, which may lie anywhere.
herr_t refuse_link(const char*, const char*, const char*, const char*, unsigned*, hid_t, void*) { return -1; }

// 4 or 8 for the IEEE types of either byte order; 0 for all others, such as the odd floating-point types that a damaged
// header may describe.
std::size_t ieee_bytes(hid_t type) {
  if (H5Tequal(type, H5T_IEEE_F32LE) > 0 || H5Tequal(type, H5T_IEEE_F32BE) > 0) return 4;
  if (H5Tequal(type, H5T_IEEE_F64LE) > 0 || H5Tequal(type, H5T_IEEE_F64BE) > 0) return 8;
  return 0;
}

struct Shape {
  std::uint64_t rows = 0;
  std::uint64_t width = 1;
  int axes = 1;
  std::uint64_t begin = 0, end = 0;  // the rows of the share
};

Status refused(const std::string& where, std::string what, std::string hint) {
  return Status(Code::invalid_argument, where + ": " + std::move(what), std::move(hint));
}

Status broken(const std::string& where) {
  return Status(Code::io_error, where + ": can't be read; the HDF5 file is damaged", "write it again");
}

Result<Shape> shape_of(const std::string& where, hid_t dataset, int k, int of) {
  const Handle space(H5Dget_space(dataset), H5Sclose);
  const int axes = space.ok() ? H5Sget_simple_extent_ndims(space.id()) : -1;
  if (axes < 0) return broken(where);
  if (axes != 1 && axes != 2) {
    return refused(where, fmt::format("has {} axes, not (n, dims) or (n,)", axes), "name a dataset of points");
  }
  std::array<hsize_t, 2> length{0, 1};
  if (H5Sget_simple_extent_dims(space.id(), length.data(), nullptr) != axes) return broken(where);
  return Shape{length[0], axes == 2 ? length[1] : 1, axes, io::share_begin(length[0], k, of),
               io::share_begin(length[0], k + 1, of)};
}

// Checks that the bytes stored are enough for the shape that the header claims.
Status check_storage(const InputFile& file, const std::string& where, hid_t dataset, const Shape& shape,
                     std::size_t type_bytes) {
  const std::uint64_t file_bytes = file.size();
  const Handle plist(H5Dget_create_plist(dataset), H5Pclose);
  if (!plist.ok()) return broken(where);
  const H5D_layout_t layout = H5Pget_layout(plist.id());
  if (layout == H5D_VIRTUAL || H5Pget_external_count(plist.id()) != 0) {
    return refused(where, "its data lie in other files", "copy it into one file with h5repack");
  }
  const u128 claimed = static_cast<u128>(shape.rows) * shape.width;
  const u128 stored = std::min<std::uint64_t>(H5Dget_storage_size(dataset), file_bytes);
  const int filters = H5Pget_nfilters(plist.id());
  if (filters < 0) return broken(where);
  const u128 supported = filters > 0 && layout == H5D_CHUNKED ? stored * io::kHdf5ShrinkMax : stored;
  // Compared by division: the product of a hostile shape and a number's size would overflow.
  if (claimed > supported / type_bytes) {
    return refused(where,
                   fmt::format("its shape ({}, {}) needs more bytes than the {} that are stored", shape.rows,
                               shape.width, static_cast<std::uint64_t>(stored)),
                   "the dataset was never fully written, or the file is damaged");
  }
  if (layout != H5D_CHUNKED || shape.rows == 0) return {};
  ChunkGrid grid{shape.axes, {shape.rows, shape.width}, {1, 1}, type_bytes, file_bytes};
  if (H5Pget_chunk(plist.id(), 2, grid.chunk.data()) != shape.axes) return broken(where);
  const u128 chunk_numbers = static_cast<u128>(grid.chunk[0]) * grid.chunk[1];
  if (chunk_numbers == 0 ||
      chunk_numbers > (static_cast<u128>(file_bytes) * io::kHdf5ShrinkMax + (1U << 20U)) / type_bytes) {
    return refused(where, "its chunks are larger than the file supports", "write it again with smaller chunks");
  }
  return check_chunks(file, where, dataset, plist.id(), grid, shape.begin, shape.end);
}

// Rows of a chunk; 1 if the dataset isn't chunked. A block of rows that ends within a chunk has it unpacked once more.
std::size_t chunk_rows(hid_t dataset) {
  const Handle plist(H5Dget_create_plist(dataset), H5Pclose);
  std::array<hsize_t, 2> chunk{1, 1};
  if (!plist.ok() || H5Pget_layout(plist.id()) != H5D_CHUNKED || H5Pget_chunk(plist.id(), 2, chunk.data()) < 0)
    return 1;
  return std::max<std::size_t>(1, static_cast<std::size_t>(chunk[0]));
}

Status read_rows(const std::string& where, hid_t dataset, const Shape& shape, const Columns& columns,
                 const io::NumberType& type, const Sink& sink) {
  const auto width = static_cast<std::size_t>(shape.width);
  const std::size_t whole = chunk_rows(dataset);
  const std::size_t wanted = std::max<std::size_t>(1, kBlockBytes / (width * sizeof(double)));
  const std::size_t step = std::max<std::size_t>(1, wanted / whole) * whole;
  Buffer<double> block;
  for (std::uint64_t begin = shape.begin, rows = 0; begin < shape.end; begin += rows) {
    // The first block ends where a chunk does.
    rows = std::min<std::uint64_t>(step - begin % whole, shape.end - begin);
    if (!block.try_reserve(rows * width)) return Status(Code::too_large, where + ": no memory for one of its rows");
    block.resize(rows * width);
    const std::array<hsize_t, 2> start{begin, 0}, count{rows, shape.width};
    const Handle from(H5Dget_space(dataset), H5Sclose);
    const Handle to(H5Screate_simple(shape.axes, count.data(), nullptr), H5Sclose);
    if (!from.ok() || !to.ok() ||
        H5Sselect_hyperslab(from.id(), H5S_SELECT_SET, start.data(), nullptr, count.data(), nullptr) < 0 ||
        H5Dread(dataset, type.bytes == 4 ? H5T_NATIVE_FLOAT : H5T_NATIVE_DOUBLE, to.id(), from.id(), H5P_DEFAULT,
                block.data()) < 0) {
      return broken(where);
    }
    Points points = io::make_points(columns, static_cast<std::size_t>(rows));
    const auto* bytes = reinterpret_cast<const std::byte*>(block.data());
    const auto bad = io::store_rows({bytes, width * type.bytes, type.bytes, type}, points.count, columns, 0, points);
    if (!bad) {
      if (const Status taken = sink(points); !taken.ok()) return taken;
      continue;
    }
    const std::uint64_t row = begin + bad->row;
    return io::refusal_of(
        *bad, where,
        shape.axes == 1 ? fmt::format("at index ({},)", row) : fmt::format("at index ({}, {})", row, bad->column));
  }
  return {};
}

}  // namespace

Status read(const InputFile& file, const std::string& dataset, const ReadOptions& options, int k, int of,
            const Sink& sink) {
  silence();
  const Handle handle(H5Fopen(file.name_by_descriptor().c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (!handle.ok()) return broken(file.path());
  if (dataset.empty())
    return Status(Code::invalid_argument, file.path() + ": is an HDF5 file, and no dataset is named",
                  fmt::format("write {}:/PATH; {}", file.path(), what_it_has(handle.id(), options)));
  const std::string where = file.path() + ":" + dataset;
  const Handle links(H5Pcreate(H5P_LINK_ACCESS), H5Pclose);
  if (!links.ok() || (options.below != nullptr && H5Pset_elink_cb(links.id(), refuse_link, nullptr) < 0))
    return broken(file.path());
  const Handle object(H5Oopen(handle.id(), dataset.c_str(), links.id()), H5Oclose);
  if (!object.ok()) {
    return Status(Code::not_found, where + ": no such dataset in the file", what_it_has(handle.id(), options));
  }
  if (H5Iget_type(object.id()) != H5I_DATASET)
    return refused(where, "is not a dataset", what_it_has(handle.id(), options));

  const Handle type(H5Dget_type(object.id()), H5Tclose);
  const std::size_t type_bytes = type.ok() ? ieee_bytes(type.id()) : 0;
  if (type_bytes == 0) return refused(where, "its type is not float32 or float64", "write it as float64");
  const auto shape = shape_of(where, object.id(), k, of);
  if (!shape.ok()) return shape.status();
  if (const Status storage = check_storage(file, where, object.id(), *shape, type_bytes); !storage.ok()) {
    return storage;
  }
  const auto columns = io::choose_columns(where, options, {}, static_cast<std::size_t>(shape->width), shape->rows);
  if (!columns.ok()) return columns.status();
  const u128 all = u128{shape->rows} * io::point_bytes(*columns);
  if (const Status fits = io::check_bytes(where, all, options); !fits.ok()) return fits;
  Points whole;
  whole.dims = columns->dims;
  whole.count = static_cast<std::size_t>(shape->end - shape->begin);
  if (columns->weighted()) whole.weight.resize(1);
  if (columns->id != io::kNoColumn) whole.id.resize(1);
  if (const Status taken = sink(whole); !taken.ok()) return taken;
  return read_rows(where, object.id(), *shape, *columns, io::NumberType{type_bytes}, sink);
}

}  // namespace rcb::hdf5
