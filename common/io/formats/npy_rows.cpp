#include <algorithm>

#include <fmt/format.h>

#include "common/io/formats/npy.hpp"

namespace rcb::io {
namespace {

// Bytes read at once: few enough to stay in the caches of a core while rows are turned into columns.
constexpr std::size_t kNpyBlockBytes = std::size_t{256} << 10U;

// The columns that are taken must hold numbers.
Status check_fields(const std::string& file, const NpyHeader& header, const Columns& columns,
                    const ReadOptions& options) {
  std::vector<std::size_t> taken(columns.axis.begin(), columns.axis.begin() + columns.dims);
  taken.insert(taken.end(), {columns.id, columns.weight});
  for (const std::size_t column : taken)
    if (column < header.fields.size() && header.fields[column].type.kind == NumberType::Kind::unread)
      return {Code::invalid_argument,
              fmt::format("{}: its field {} holds neither float32, float64 nor integers", file,
                          quoted(header.names[column], "(of its header)", options)),
              "save it as float64, or choose other columns (--columns, --ids, --weights)"};
  return {};
}

}  // namespace

Result<NpyRows> NpyRows::open(InputFile file, const NpyHeader& header, const ReadOptions& options) {
  NpyRows rows(std::move(file), header);
  const auto& shape = header.shape;
  const std::uint64_t width = shape.size() == 1 ? 1 : shape.back();
  // An array with an axis of length 0 may claim any length for the others.
  if (width > std::max<std::uint64_t>(rows.file_.size(), 64)) {
    return Status(Code::invalid_argument, fmt::format("{}: {} columns in an empty array", rows.file_.path(), width));
  }
  rows.width_ = static_cast<std::size_t>(width);
  rows.rows_ = shape[0];
  if (shape.size() == 3) {
    const bool none = shape[0] == 0 || shape[1] == 0 || shape[2] == 0;
    rows.rows_ = none ? 0 : shape[0] * shape[1];
  }
  const std::uint64_t points = shape.size() == 3 ? shape[1] : shape[0];
  auto columns = choose_columns(rows.file_.path(), options, header.names, rows.width_, points);
  if (!columns.ok()) return columns.status();
  rows.columns_ = *columns;
  rows.names_shown_ = options.below == nullptr;
  if (Status read = check_fields(rows.file_.path(), header, *columns, options); !read.ok()) return read;
  if (header.fortran_order && shape.size() == 3 && rows.rows_ > 0) {
    if (const Status turned = rows.turn_into_c_order(); !turned.ok()) return turned;
  }
  return rows;
}

Status NpyRows::turn_into_c_order() {
  const std::uint64_t steps = header_.shape[0], n = header_.shape[1];
  const std::uint64_t total = rows_ * width_;
  if (!in_c_order_.try_reserve(total)) {
    return Status(Code::too_large, file_.path() + ": no memory to bring its Fortran order into C order",
                  "save it with numpy.ascontiguousarray");
  }
  in_c_order_.resize(total);
  Columns one;
  one.dims = 1;
  one.axis[0] = 0;
  Buffer<std::byte> block(kNpyBlockBytes);
  Points numbers = make_points(one, kNpyBlockBytes / header_.type.bytes);
  for (std::uint64_t begin = 0; begin < total; begin += numbers.count) {
    const auto count = static_cast<std::size_t>(std::min<std::uint64_t>(numbers.count, total - begin));
    const std::size_t bytes = header_.type.bytes;
    if (const Status read = file_.read_at(header_.data_begin + begin * bytes, block.data(), count * bytes);
        !read.ok()) {
      return read;
    }
    // A bad value is found again, and reported, when the rows are read.
    static_cast<void>(store_rows({block.data(), bytes, 0, header_.type}, count, one, 0, numbers));
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint64_t at = begin + i;
      const std::uint64_t step = at % steps, particle = at / steps % n, axis = at / steps / n;
      in_c_order_[(step * n + particle) * width_ + axis] = numbers.position[0][i];
    }
  }
  return {};
}

Status NpyRows::refuse(std::uint64_t row, const BadValue& bad) const {
  const bool several = header_.shape.size() == 3;
  const std::uint64_t n = several ? header_.shape[1] : rows_;
  const std::string file = several ? fmt::format("{}: frame {}", file_.path(), row / n) : file_.path();
  std::string index = several ? fmt::format("{}, {}", row / n, row % n) : fmt::format("{},", row);
  if (header_.fields.empty()) {
    if (several) index += fmt::format(", {}", bad.column);
    if (header_.shape.size() == 2) index += fmt::format(" {}", bad.column);
    return refusal_of(bad, file, fmt::format("at index ({})", index));
  }
  const std::string name = names_shown_ ? "'" + shown(header_.names[bad.column]) + "'" : std::to_string(bad.column);
  return refusal_of(bad, file, fmt::format("at index ({}) of field {}", index, name));
}

Status NpyRows::read_into(std::uint64_t begin, std::size_t count, std::size_t to, Buffer<std::byte>& scratch,
                          Points& points) const {
  const std::size_t bytes = header_.type.bytes;
  RowBlock block{nullptr, row_bytes(), bytes, header_.type, header_.fields};
  if (!in_c_order_.empty()) {
    block = {reinterpret_cast<const std::byte*>(in_c_order_.data() + begin * width_), width_ * 8, 8, NumberType{}};
  } else if (header_.fortran_order && width_ > 1) {
    // Each column is contiguous; only those that are asked for are read.
    scratch.resize(count * bytes * width_);
    for (std::size_t c = 0; c < width_; ++c) {
      const bool axis = std::find(columns_.axis.begin(), columns_.axis.end(), c) != columns_.axis.end();
      if (!axis && c != columns_.id && c != columns_.weight) continue;
      const std::uint64_t at = header_.data_begin + (c * rows_ + begin) * bytes;
      if (const Status read = file_.read_at(at, scratch.data() + c * count * bytes, count * bytes); !read.ok())
        return read;
    }
    block = {scratch.data(), bytes, count * bytes, header_.type};
  } else {
    scratch.resize(count * row_bytes());
    const Status read = file_.read_at(header_.data_begin + begin * row_bytes(), scratch.data(), scratch.size());
    if (!read.ok()) return read;
    block.first = scratch.data();
  }
  const auto bad = store_rows(block, count, columns_, to, points);
  return bad ? refuse(begin + bad->row, *bad) : Status{};
}

Status NpyRows::read(std::uint64_t begin, std::size_t count, Points& points) const {
  points = make_points(columns_, count);
  const std::size_t step = std::max<std::size_t>(1, kNpyBlockBytes / row_bytes());
  Buffer<std::byte> scratch;
  for (std::size_t done = 0; done < count; done += step) {
    const std::size_t rows = std::min(step, count - done);
    if (const Status read = read_into(begin + done, rows, done, scratch, points); !read.ok()) return read;
  }
  return {};
}

Status NpyRows::check() const {
  const std::size_t step = std::max<std::size_t>(1, kNpyBlockBytes / row_bytes());
  Points scrap = make_points(columns_, step);
  Buffer<std::byte> scratch;
  for (std::uint64_t begin = 0; begin < rows_; begin += step) {
    const auto rows = static_cast<std::size_t>(std::min<std::uint64_t>(step, rows_ - begin));
    if (const Status read = read_into(begin, rows, 0, scratch, scrap); !read.ok()) return read;
  }
  return {};
}

}  // namespace rcb::io
