// Rows of numbers of any type as points.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>

#include "common/io/formats/columns.hpp"

namespace rcb::io {
namespace {

static_assert(std::endian::native == std::endian::little, "array files are read and written as little-endian memory");

template <typename Number, bool kSwapped>
Number number_at(const std::byte* from) {
  using Bits =
      std::conditional_t<sizeof(Number) == 8, std::uint64_t,
                         std::conditional_t<sizeof(Number) == 4, std::uint32_t,
                                            std::conditional_t<sizeof(Number) == 2, std::uint16_t, std::uint8_t>>>;
  Bits bits;
  std::memcpy(&bits, from, sizeof bits);
  if constexpr (kSwapped && sizeof bits == 8) bits = __builtin_bswap64(bits);
  if constexpr (kSwapped && sizeof bits == 4) bits = __builtin_bswap32(bits);
  if constexpr (kSwapped && sizeof bits == 2) bits = __builtin_bswap16(bits);
  return std::bit_cast<Number>(bits);
}

// Calls work.operator()<Number, kSwapped>() for the type; not at all for one that isn't read.
template <typename Work>
void with_type(const NumberType& type, const Work& work) {
  const auto in_order = [&]<typename Number>() {
    type.swapped ? work.template operator()<Number, true>() : work.template operator()<Number, false>();
  };
  const auto of_size = [&]<typename One, typename Two, typename Four, typename Eight>() {
    if (type.bytes == 1) in_order.template operator()<One>();
    if (type.bytes == 2) in_order.template operator()<Two>();
    if (type.bytes == 4) in_order.template operator()<Four>();
    if (type.bytes == 8) in_order.template operator()<Eight>();
  };
  switch (type.kind) {
    case NumberType::Kind::real:
      if (type.bytes == 4) in_order.template operator()<float>();
      if (type.bytes == 8) in_order.template operator()<double>();
      break;
    case NumberType::Kind::integer:
      of_size.template operator()<std::int8_t, std::int16_t, std::int32_t, std::int64_t>();
      break;
    case NumberType::Kind::natural:
      of_size.template operator()<std::uint8_t, std::uint16_t, std::uint32_t, std::uint64_t>();
      break;
    case NumberType::Kind::unread:
      break;
  }
}

// A column of a block.
struct Strip {
  const std::byte* first;
  std::size_t stride;
  NumberType type;
};

Strip strip_of(const RowBlock& block, std::size_t column) {
  if (block.fields.empty()) return {block.first + column * block.column_stride, block.row_stride, block.type};
  return {block.first + block.fields[column].offset, block.row_stride, block.fields[column].type};
}

// Whether all are finite.
bool convert(const Strip& strip, std::size_t count, double* to) {
  bool finite = true;
  with_type(strip.type, [&]<typename Number, bool kSwapped>() {
    for (std::size_t i = 0; i < count; ++i) {
      const auto value = static_cast<double>(number_at<Number, kSwapped>(strip.first + i * strip.stride));
      to[i] = value;
      finite &= std::fabs(value) <= std::numeric_limits<double>::max();
    }
  });
  return finite;
}

// Whole numbers that no rounding has made so: a float32 tells apart those below 2^24, a float64 those below 2^53.
template <typename Number>
bool is_id(Number value) {
  if constexpr (std::is_integral_v<Number>)
    return std::in_range<std::int64_t>(value) && std::cmp_greater_equal(value, 0);
  constexpr auto kWholeMax = static_cast<Number>(std::uint64_t{1} << std::numeric_limits<double>::digits);
  constexpr auto kMax = std::is_same_v<Number, float> ? static_cast<Number>(1U << 24U) : kWholeMax;
  return value >= 0 && value < kMax && std::trunc(static_cast<double>(value)) == static_cast<double>(value);
}

// The first that is no id, if any.
std::optional<BadValue> convert_ids(const Strip& strip, std::size_t column, std::size_t count, std::int64_t* to) {
  std::optional<BadValue> bad;
  with_type(strip.type, [&]<typename Number, bool kSwapped>() {
    for (std::size_t i = 0; i < count && !bad; ++i) {
      const Number value = number_at<Number, kSwapped>(strip.first + i * strip.stride);
      if (is_id(value)) {
        to[i] = static_cast<std::int64_t>(value);
      } else {
        bad = BadValue{i, column, static_cast<double>(value), BadValue::Is::no_id};
      }
    }
  });
  return bad;
}

}  // namespace

Status refusal_of(const BadValue& bad, const std::string& file, const std::string& place) {
  switch (bad.is) {
    case BadValue::Is::no_id:
      return {Code::invalid_argument, fmt::format("{}: {} {} is not an id", file, bad.value, place),
              "ids are whole numbers from 0 to 9223372036854775807; as float64 below 2^53, as float32 below 2^24"};
    case BadValue::Is::negative:
      return {Code::invalid_argument, fmt::format("{}: the weight {}, which is negative, {}", file, bad.value, place),
              "weights are 0 or more"};
    case BadValue::Is::not_finite:
      break;
  }
  const char* name = std::isnan(bad.value) ? "NaN" : bad.value > 0 ? "infinity" : "-infinity";
  return {Code::not_finite, fmt::format("{}: {} {}", file, name, place),
          "positions and weights must be finite: correct or drop that row"};
}

std::optional<BadValue> store_rows(const RowBlock& block, std::size_t count, const Columns& columns, std::size_t begin,
                                   Points& points) {
  std::optional<BadValue> bad;
  const auto keep_first = [&bad](const BadValue& found) {
    if (!bad || found.row < bad->row || (found.row == bad->row && found.column < bad->column)) bad = found;
  };
  const auto store = [&](std::size_t column, double* to, double least) {
    const bool finite = convert(strip_of(block, column), count, to);
    if (finite && std::none_of(to, to + count, [least](double value) { return value < least; })) return;
    const double* first =
        std::find_if(to, to + count, [least](double value) { return !std::isfinite(value) || value < least; });
    keep_first({static_cast<std::size_t>(first - to), column, *first,
                std::isfinite(*first) ? BadValue::Is::negative : BadValue::Is::not_finite});
  };
  constexpr double kLeast = std::numeric_limits<double>::lowest();
  for (std::size_t a = 0; a < static_cast<std::size_t>(columns.dims); ++a)
    store(columns.axis[a], points.position[a].data() + begin, kLeast);
  if (columns.weighted()) store(columns.weight, points.weight.data() + begin, 0);
  if (columns.id != kNoColumn) {
    const auto found = convert_ids(strip_of(block, columns.id), columns.id, count, points.id.data() + begin);
    if (found) keep_first(*found);
  }
  return bad;
}

}  // namespace rcb::io
