#include "client/lib/session/shared_arrays.hpp"

#include <array>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "common/base/axis_names.hpp"
#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kPage = 4096;

// The values of an axis as they lie in the caller's memory.
struct Axis {
  const std::byte* first;
  std::size_t stride;  // bytes
};

Axis axis_of(const Positions& positions, std::size_t axis) {
  if (positions.single())
    return {reinterpret_cast<const std::byte*>(positions.axis_f4[axis]), positions.stride * sizeof(float)};
  return {reinterpret_cast<const std::byte*>(positions.axis[axis]), positions.stride * sizeof(double)};
}

std::size_t width_of(const Positions& positions) { return positions.single() ? sizeof(float) : sizeof(double); }

// Bytes of an axis in an array of its own, rounded up so that what follows is aligned.
std::size_t axis_bytes(const Positions& positions) { return (positions.count * width_of(positions) + 7) / 8 * 8; }

template <typename T>
void copy_strided(const Axis& from, std::size_t count, std::byte* to) {
  for (std::size_t i = 0; i < count; ++i) std::memcpy(to + i * sizeof(T), from.first + i * from.stride, sizeof(T));
}

// Copies the positions to `to`, and returns where their axes are there: an array [count][dims] stays one.
std::array<Axis, 3> copy_axes(const Positions& positions, std::byte* to) {
  const auto dims = static_cast<std::size_t>(positions.dims);
  const std::size_t width = width_of(positions);
  std::array<Axis, 3> from{}, copies{};
  bool rows = dims > 1 && positions.stride == dims;
  for (std::size_t a = 0; a < dims; ++a) {
    from[a] = axis_of(positions, a);
    rows = rows && from[a].first == from[0].first + a * width;
  }
  if (rows) std::memcpy(to, from[0].first, positions.count * dims * width);
  for (std::size_t a = 0; a < dims; ++a) {
    if (rows) {
      copies[a] = {to + a * width, dims * width};
      continue;
    }
    std::byte* const axis = to + a * axis_bytes(positions);
    copies[a] = {axis, width};
    if (from[a].stride == width)
      std::memcpy(axis, from[a].first, positions.count * width);
    else
      (width == sizeof(float) ? copy_strided<float> : copy_strided<double>)(from[a], positions.count, axis);
  }
  return copies;
}

}  // namespace

bool SharedArrays::Block::covers(const void* from, std::size_t bytes) const {
  const auto* const at = static_cast<const std::byte*>(from);
  const auto held = memory.bytes();
  return !held.empty() && at >= held.data() && bytes <= held.size() &&
         static_cast<std::size_t>(at - held.data()) <= held.size() - bytes;
}

// An eighth more than is asked for, so that a scene that grows slowly isn't shared at every step.
Status SharedArrays::make_room(Block& block, std::size_t bytes) {
  if (bytes <= block.memory.size()) return {};
  block = {.replaces = block.number != 0 ? block.number : block.replaces};
  auto larger = SharedMemory::create(bytes + bytes / 8);
  if (!larger) return larger.status();
  block.memory = std::move(*larger);
  return {};
}

Status SharedArrays::share(Block& block, Session& session, const Deadline& deadline) {
  const bool known = block.shared_on == session.data_generation();
  if (known && !block.anew) return {};
  if (!known) block.number = session.next_memory();  // numbers rise over a connection
  if (Status status = session.share(block.memory, block.number, deadline); !status) return status;
  block.shared_on = session.data_generation();
  block.anew = false;
  if (block.replaces != 0) session.unshare(std::exchange(block.replaces, 0), deadline);
  return {};
}

void SharedArrays::unshare(Session& session, const Deadline& deadline) {
  for (const Block* block : {&given_, &copies_, &lists_}) {
    if (block->shared_on != 0 && block->shared_on == session.data_generation())
      session.unshare(block->number, deadline);
    if (block->replaces != 0) session.unshare(block->replaces, deadline);
  }
}

std::byte* SharedArrays::first_given() {
  return given_.memory.size() > 0 ? given_.memory.writable().data() : plain_.data();
}

Result<SharedArrays::Room> SharedArrays::make_given(std::size_t count, int dims, std::size_t width, Order order) {
  if (count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return Status(Code::too_large, fmt::format("{} positions, at most {} are taken", count, wire::kParticlesMax));
  const auto axes = static_cast<std::size_t>(dims);
  if (order != order_ || width * axes != point_bytes_) {  // what is there means nothing in another order
    given_.memory = {};
    plain_.release();
    capacity_ = 0;
    order_ = order;
    point_bytes_ = width * axes;
  }
  if (count > capacity_ || capacity_ == 0) {
    const std::size_t old = capacity_;
    // Axes begin at whole pages.
    const std::size_t per_page = kPage / width;
    const std::size_t capacity = (count + count / 8 + per_page) / per_page * per_page;
    auto memory = SharedMemory::create(capacity * point_bytes_);
    Buffer<std::byte> plain;
    if (!memory) {
      if (!plain.try_reserve(capacity * point_bytes_))
        return Status(Code::too_large, fmt::format("no memory for {} positions", count));
      plain.resize(capacity * point_bytes_);
    }
    std::byte* const to = memory ? memory->writable().data() : plain.data();
    const std::byte* const from = first_given();
    if (old > 0 && order == Order::rows) std::memcpy(to, from, old * point_bytes_);
    for (std::size_t a = 0; old > 0 && order == Order::axes && a < axes; ++a)
      std::memcpy(to + a * capacity * width, from + a * old * width, old * width);
    given_ = {.memory = memory ? std::move(*memory) : SharedMemory(),
              .replaces = given_.number != 0 ? given_.number : given_.replaces};
    plain_ = std::move(plain);
    capacity_ = capacity;
  }
  return Room{first_given(), order == Order::rows ? point_bytes_ : capacity_ * width};
}

bool SharedArrays::gave(const Positions& positions) const {
  const std::size_t width = width_of(positions);
  if (positions.count == 0 || positions.stride * width > wire::kSharedStrideMax) return false;
  const std::size_t reach = ((positions.count - 1) * positions.stride + 1) * width;  // from an axis's first byte on
  for (std::size_t a = 0; a < static_cast<std::size_t>(positions.dims); ++a)
    if (!given_.covers(axis_of(positions, a).first, reach)) return false;
  return true;
}

Result<std::span<std::uint64_t>> SharedArrays::row_list(std::size_t count) {
  if (Status status = make_room(lists_, 8 * count); !status) return status;
  return std::span(reinterpret_cast<std::uint64_t*>(lists_.memory.writable().data()), count);
}

Result<wire::Json> SharedArrays::describe(Session& session, const Values& values, const Deadline& deadline) {
  const Positions& positions = values.positions;
  const auto dims = static_cast<std::size_t>(positions.dims);
  const bool in_place = gave(positions);
  const std::size_t copied =
      (in_place ? 0 : dims * axis_bytes(positions)) + 8 * (values.weights.size() + values.ids.size());
  if (Status status = make_room(copies_, copied); !status) return status;
  if (values.listed > 0)
    if (Status status = share(lists_, session, deadline); !status) return status;
  if (in_place)
    if (Status status = share(given_, session, deadline); !status) return status;
  if (copied > 0)
    if (Status status = share(copies_, session, deadline); !status) return status;

  wire::Json arrays = wire::Json::array();
  const auto add = [&arrays](const Block& block, const char* name, const Axis& at) {
    arrays.push_back({{"name", name},
                      {"number", block.number},
                      {"offset", static_cast<std::size_t>(at.first - block.memory.bytes().data())},
                      {"stride", at.stride}});
  };
  std::byte* to = copies_.memory.writable().data();
  std::array<Axis, 3> copies{};
  if (!in_place) {
    copies = copy_axes(positions, to);
    to += dims * axis_bytes(positions);
  }
  for (std::size_t a = 0; a < dims; ++a)
    in_place ? add(given_, kAxisNames[a], axis_of(positions, a)) : add(copies_, kAxisNames[a], copies[a]);
  const auto copy = [&to](const auto& list) {
    if (!list.empty()) std::memcpy(to, list.data(), list.size() * 8);
    to += list.size() * 8;
  };
  if (!values.weights.empty()) {
    add(copies_, "w", {to, 8});
    copy(values.weights);
  }
  if (!values.ids.empty()) {
    add(copies_, "id", {to, 8});
    copy(values.ids);
  }
  if (values.listed > 0) add(lists_, "row", {lists_.memory.bytes().data(), 8});
  return arrays;
}

}  // namespace rcb::client
