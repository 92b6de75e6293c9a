// Lists and pages of answers. Lists: their length grows with the number of parts. Up to wire::kListedMax entries are in
// the answer's JSON. A longer list is an array of the frame, and its field in the JSON is null. So the JSON of every
// answer is bounded, and a client that doesn't know this rule sees no list instead of a part of it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>

#include "common/wire/limits.hpp"
#include "server/api/answer.hpp"

namespace rcb::api {

// Infinity and NaN as number_json() writes them.
inline wire::Json list_json(std::span<const double> values) {
  wire::Json list = wire::Json::array();
  for (const double value : values) list.push_back(wire::number_json(value));
  return list;
}
template <typename T>
wire::Json list_json(std::span<const T> values) {
  return wire::Json(std::vector<T>(values.begin(), values.end()));
}

// Puts a list into `json`, which is the answer's or an object within it. Long lists of the same name are appended to
// one array.
template <typename T>
void put_list(Answer& answer, wire::Json& json, const char* name, std::span<const T> values) {
  if (values.size() <= wire::kListedMax) {
    json[name] = list_json(values);
    return;
  }
  json[name] = nullptr;
  const auto found = std::find_if(answer.arrays.begin(), answer.arrays.end(),
                                  [name](const wire::Array& array) { return array.name == name; });
  if (found == answer.arrays.end()) {
    answer.arrays.push_back(make_array<T>(name, wire::dtype_of<T>(), values));
    return;
  }
  const std::size_t before = found->bytes.size();
  found->bytes.resize(before + values.size_bytes());
  std::memcpy(found->bytes.data() + before, values.data(), values.size_bytes());
  found->shape[0] += values.size();
}

// The items [from, end) of a list.
struct Page {
  std::uint64_t from = 0;
  std::uint64_t end = 0;

  void tell(wire::Json& json, std::uint64_t total) const {
    json["from"] = from;
    json["next"] = end < total ? wire::Json(end) : wire::Json(nullptr);
  }
};

// The page asked for by the fields "from" (`otherwise` if absent) and "count", within `total` items and of at most
// `most`. Errors: invalid_argument.
Result<Page> read_page(const wire::Json& request, std::uint64_t total, std::uint64_t otherwise, std::uint64_t most);

// Whether the field is there, and not null.
bool given(const wire::Json& request, const char* name);

}  // namespace rcb::api
