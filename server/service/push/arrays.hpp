// The arrays of a slice: which ones it must have, and their values.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/base/status.hpp"
#include "server/service/context/order.hpp"
#include "server/service/push/request.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

using ArrayTypes = std::vector<std::pair<std::string, std::string>>;  // name and dtype, in the slice's order

ArrayTypes axes_of(const Scene& scene);
// Of a slice with all particles: the axes, and weights and ids where the push brings them.
ArrayTypes arrays_of(const Scene& scene, const PushRequest& push);
// Of a slice with the few particles that moved: the axes and slots.
ArrayTypes arrays_of_few(const Scene& scene);

// what: whose slice it is, for the message. Errors: invalid_argument, unless it has `count` particles with these
// arrays.
Status check_arrays(const PushSlice& slice, const std::string& what, std::uint64_t count, const ArrayTypes& types);

// Removes the slice of that "rank" from `slices` and returns it; an empty slice if there is none.
PushSlice take_slice(std::vector<PushSlice>& slices, int rank);

// The values of an array; none if the slice doesn't have so many arrays.
template <typename T>
std::span<const T> values_of(const PushSlice& slice, std::size_t array) {
  if (array >= slice.arrays.size()) return {};
  const Buffer<std::byte>& bytes = slice.arrays[array].bytes;
  return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
}

}  // namespace rcb::service
