#include "client/cli/lists.hpp"

#include <cmath>
#include <cstring>
#include <limits>
#include <span>

namespace rcb::cli {
namespace {

using Json = nlohmann::ordered_json;

// Infinity becomes "inf", as in the protocol's JSON, and NaN null; if there is no number at all, the whole list is
// null.
template <typename T>
Json list_of(std::span<const std::byte> bytes) {
  Json list = Json::array();
  bool any = bytes.empty();
  for (std::size_t at = 0; at + sizeof(T) <= bytes.size(); at += sizeof(T)) {
    T value{};
    std::memcpy(&value, bytes.data() + at, sizeof value);
    const bool is_number = !std::isnan(static_cast<double>(value));
    any = any || is_number;
    list.push_back(!is_number ? Json() : std::isinf(static_cast<double>(value)) ? Json("inf") : Json(value));
  }
  return any ? list : Json();
}

Json list_of(const std::string& dtype, std::span<const std::byte> bytes) {
  if (dtype == "<f8") return list_of<double>(bytes);
  if (dtype == "<u8") return list_of<std::uint64_t>(bytes);
  if (dtype == "<i8") return list_of<std::int64_t>(bytes);
  return dtype == "<i4" ? list_of<std::int32_t>(bytes) : Json();
}

bool is_missing(const Json& json, const std::string& name) {
  const auto found = json.find(name);
  return found != json.end() && found->is_null();
}

// Distributes the rows of the array to the objects, one each.
void fill_rows(Json& rows, const client::Array& array) {
  if (array.shape.size() != 2 || array.shape[0] != rows.size() || rows.empty()) return;
  const std::size_t bytes = array.bytes.size() / rows.size();
  for (std::size_t k = 0; k < rows.size(); ++k)
    if (is_missing(rows[k], array.name))
      rows[k][array.name] = list_of(array.dtype, array.bytes.span().subspan(k * bytes, bytes));
}

}  // namespace

std::vector<double> numbers(const Json& list) {
  std::vector<double> values;
  for (const Json& item : list)
    values.push_back(item.is_number() ? item.get<double>()
                     : item == "inf"  ? std::numeric_limits<double>::infinity()
                                      : std::nan(""));
  return values;
}

void fill_lists(Json& json, const client::Reply& reply) {
  for (const client::Array& array : reply.arrays) {
    if (is_missing(json, array.name)) {
      json[array.name] = list_of(array.dtype, array.bytes.span());
    } else if (const auto methods = json.find("methods"); methods != json.end() && methods->is_array()) {
      fill_rows(*methods, array);
    } else if (const auto quality = json.find("quality"); quality != json.end() && quality->is_object()) {
      if (is_missing(*quality, array.name)) (*quality)[array.name] = list_of(array.dtype, array.bytes.span());
    }
  }
}

}  // namespace rcb::cli
