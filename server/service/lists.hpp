// Lists in answers that grow with the parts. Up to wire::kListedMax entries stand in the answer's JSON; a longer list
// is an array of the frame, and its field in the JSON is null. So the JSON of every answer is bounded, and a client
// that doesn't know of this sees that the list is missing, never a part of it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <type_traits>

#include "common/wire/limits.hpp"
#include "server/service/context.hpp"

namespace rcb::service {

template <typename T>
constexpr const char* dtype_of() {
  if constexpr (std::is_same_v<T, double>) return "<f8";
  if constexpr (std::is_same_v<T, std::uint64_t>) return "<u8";
  static_assert(sizeof(T) == 4 || sizeof(T) == 8);
  return sizeof(T) == 8 ? "<i8" : "<i4";
}

// Infinity and not-a-number as JSON has them.
inline wire::Json list_json(std::span<const double> values) {
  wire::Json list = wire::Json::array();
  for (const double value : values) list.push_back(wire::number_json(value));
  return list;
}
template <typename T>
wire::Json list_json(std::span<const T> values) {
  return wire::Json(std::vector<T>(values.begin(), values.end()));
}

// `json`: the answer's, or an object in it. Several long lists of one name follow one another in one array.
template <typename T>
void put_list(Response& response, wire::Json& json, const char* name, std::span<const T> values) {
  if (values.size() <= wire::kListedMax) {
    json[name] = list_json(values);
    return;
  }
  json[name] = nullptr;
  const auto found = std::find_if(response.arrays.begin(), response.arrays.end(),
                                  [name](const wire::Array& array) { return array.name == name; });
  if (found == response.arrays.end()) {
    response.arrays.push_back(make_array<T>(name, dtype_of<T>(), values));
    return;
  }
  const std::size_t before = found->bytes.size();
  found->bytes.resize(before + values.size_bytes());
  std::memcpy(found->bytes.data() + before, values.data(), values.size_bytes());
  found->shape[0] += values.size();
}

// The scene's "counts", "targets" and, with weights, "loads".
inline void put_loads(Response& response, const Scene& scene) {
  put_list<std::uint64_t>(response, response.json, "counts", scene.loads.counts);
  put_list<double>(response, response.json, "targets", scene.loads.targets);
  if (scene.particles.has_weights) put_list<double>(response, response.json, "loads", scene.loads.load_values);
}

}  // namespace rcb::service
