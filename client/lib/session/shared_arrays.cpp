#include "client/lib/session/shared_arrays.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "common/wire/limits.hpp"

namespace rcb::client {
namespace {

constexpr std::size_t kPage = 4096;

// Of a column in an array of its own, rounded up so that what follows is aligned.
std::size_t column_bytes(const Column& column, std::size_t count) { return (count * column.bytes + 7) / 8 * 8; }

}  // namespace

bool SharedArrays::Block::covers(const void* from, std::size_t bytes) const {
  const auto* const at = static_cast<const std::byte*>(from);
  const auto held = memory->bytes();
  return !held.empty() && at >= held.data() && bytes <= held.size() &&
         static_cast<std::size_t>(at - held.data()) <= held.size() - bytes;
}

// An eighth more than is asked for, so that a scene that grows slowly isn't shared at every step.
Status SharedArrays::make_room(Block& block, std::size_t bytes) {
  if (bytes <= block.memory->size()) return {};
  block = {.replaces = block.number != 0 ? block.number : block.replaces};
  auto larger = SharedMemory::create(bytes + bytes / 8);
  if (!larger) return larger.status();
  *block.memory = std::move(*larger);
  return {};
}

Status SharedArrays::share(Block& block, Session& session, const Deadline& deadline) {
  const bool known = block.shared_on == session.data_generation();
  if (known && !block.anew) return {};
  if (!known) block.number = session.next_memory();  // numbers rise over a connection
  if (Status status = session.share(*block.memory, block.number, deadline); !status) return status;
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

std::byte* SharedArrays::first_given() { return plain_ ? plain_->data() : given_.memory->writable().data(); }

Result<SharedArrays::Room> SharedArrays::make_given(std::size_t count, int dims, std::size_t width, Order order) {
  if (count > static_cast<std::uint64_t>(wire::kParticlesMax))
    return Status(Code::too_large, fmt::format("{} positions, at most {} are taken", count, wire::kParticlesMax));
  const auto axes = static_cast<std::size_t>(dims);
  if (order != order_ || width * axes != point_bytes_) {  // what is there means nothing in another order
    given_.memory = std::make_shared<SharedMemory>();
    plain_.reset();
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
    std::shared_ptr<Buffer<std::byte>> plain;
    if (!memory) {
      plain = std::make_shared<Buffer<std::byte>>();
      if (!plain->try_reserve(capacity * point_bytes_))
        return Status(Code::too_large, fmt::format("no memory for {} positions", count));
      plain->resize(capacity * point_bytes_);
    }
    std::byte* const to = memory ? memory->writable().data() : plain->data();
    const std::byte* const from = first_given();
    if (old > 0 && order == Order::rows) std::memcpy(to, from, old * point_bytes_);
    for (std::size_t a = 0; old > 0 && order == Order::axes && a < axes; ++a)
      std::memcpy(to + a * capacity * width, from + a * old * width, old * width);
    given_ = {.memory = std::make_shared<SharedMemory>(memory ? std::move(*memory) : SharedMemory()),
              .replaces = given_.number != 0 ? given_.number : given_.replaces};
    plain_ = std::move(plain);
    capacity_ = capacity;
  }
  return Room{first_given(), order == Order::rows ? point_bytes_ : capacity_ * width};
}

bool SharedArrays::gave(std::span<const Column> axes, std::size_t count) const {
  return std::ranges::all_of(axes, [&](const Column& axis) {
    const std::size_t reach = ((count - 1) * axis.stride + 1) * axis.bytes;  // from its first byte on
    return count > 0 && axis.stride * axis.bytes <= wire::kSharedStrideMax && given_.covers(axis.first, reach);
  });
}

Result<std::span<std::uint64_t>> SharedArrays::row_list(std::size_t count) {
  if (Status status = make_room(lists_, 8 * count); !status) return status;
  return std::span(reinterpret_cast<std::uint64_t*>(lists_.memory->writable().data()), count);
}

Result<wire::Json> SharedArrays::describe(Session& session, std::span<const Column> columns, std::size_t count,
                                          std::size_t listed, const Deadline& deadline) {
  const auto axes = columns.first(static_cast<std::size_t>(std::ranges::count_if(columns, &Column::is_axis)));
  const bool in_place = gave(axes, count);
  std::size_t copied = 0;
  for (const Column& column : columns.subspan(in_place ? axes.size() : 0)) copied += column_bytes(column, count);
  if (Status status = make_room(copies_, copied); !status) return status;
  if (listed > 0)
    if (Status status = share(lists_, session, deadline); !status) return status;
  if (in_place)
    if (Status status = share(given_, session, deadline); !status) return status;
  if (copied > 0)
    if (Status status = share(copies_, session, deadline); !status) return status;

  wire::Json arrays = wire::Json::array();
  const auto add = [&arrays](const Block& block, const std::string& name, const void* first, std::size_t stride) {
    const auto offset = static_cast<const std::byte*>(first) - block.memory->bytes().data();
    arrays.push_back({{"name", name}, {"number", block.number}, {"offset", offset}, {"stride", stride}});
  };
  std::byte* to = copies_.memory->writable().data();
  const bool rows = !in_place && interleaved(axes);  // these stay one array, which is copied in one pass
  if (rows) std::memcpy(to, axes[0].first, count * particle_bytes(axes));
  for (const Column& column : columns) {
    if (in_place && column.is_axis()) {
      add(given_, column.name, column.first, column.stride * column.bytes);
    } else if (rows && column.is_axis()) {
      const auto at = static_cast<const std::byte*>(column.first) - static_cast<const std::byte*>(axes[0].first);
      add(copies_, column.name, copies_.memory->bytes().data() + at, particle_bytes(axes));
      to += column_bytes(column, count);
    } else {
      gather(column, {.count = count}, to);
      add(copies_, column.name, to, column.bytes);
      to += column_bytes(column, count);
    }
  }
  if (listed > 0) add(lists_, "row", lists_.memory->bytes().data(), 8);
  return arrays;
}

}  // namespace rcb::client
