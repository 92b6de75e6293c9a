#include "server/api/cut_arrays.hpp"

#include "common/cuts/cut_arrays.hpp"
#include "server/api/answer.hpp"

namespace rcb::api {

std::vector<wire::Array> cut_arrays(const cuts::CutTree& tree) {
  const cuts::CutArrays arrays = cuts::arrays_of(tree);
  const std::vector<std::uint64_t> by_axis{arrays.id.size(), static_cast<std::uint64_t>(arrays.dims)};
  std::vector<wire::Array> made;
  made.push_back(make_array<std::int32_t>("axes", "<i4", arrays.axes));
  made.back().shape = by_axis;
  made.push_back(make_array<double>("at", "<f8", arrays.at));
  made.back().shape = by_axis;
  made.push_back(make_array<cuts::Id>("id", "<i8", arrays.id));
  if (!arrays.part_sizes.empty()) made.push_back(make_array<double>("part_sizes", "<f8", arrays.part_sizes));
  return made;
}

}  // namespace rcb::api
