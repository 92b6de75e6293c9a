// SharedArrays: positions of a scene in memory that the ranks on this host read (common/files/shared_memory.hpp). The
// solver computes in arrays that it got from here, or its own are copied here before a push.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "client/lib/session/push_source.hpp"
#include "client/lib/session/session.hpp"
#include "common/base/buffer.hpp"
#include "common/files/shared_memory.hpp"

namespace rcb::client {

class SharedArrays {
 public:
  // Arrays for a solver that computes in them: [count][dims], or one [count] for each axis, with what they held before
  // as far as it fits. Where memory can't be shared they are in ordinary memory. Errors: too_large.
  template <typename T>
  Result<std::span<T>> rows(std::size_t count, int dims) {
    const auto room = make_given(count, dims, sizeof(T), Order::rows);
    if (!room) return room.status();
    return std::span(reinterpret_cast<T*>(room->first), count * static_cast<std::size_t>(dims));
  }
  template <typename T>
  Result<std::vector<std::span<T>>> axes(std::size_t count, int dims) {
    const auto room = make_given(count, dims, sizeof(T), Order::axes);
    if (!room) return room.status();
    std::vector<std::span<T>> axes;
    for (int a = 0; a < dims; ++a)
      axes.emplace_back(reinterpret_cast<T*>(room->first + static_cast<std::size_t>(a) * room->stride), count);
    return axes;
  }

  // Memory for the list that says, rank after rank, which rows each is to take. Errors: too_large, io_error.
  Result<std::span<std::uint64_t>> row_list(std::size_t count);
  // The field "memory" of a push of these columns, of `count` rows each, and of as many rows of row_list() as are
  // listed. Copies what isn't in the arrays given out, and shares memory with the ranks where that wasn't done on these
  // connections. Errors: of Session::share, io_error.
  Result<wire::Json> describe(Session& session, std::span<const Column> columns, std::size_t count, std::size_t listed,
                              const Deadline& deadline);
  // What keeps the arrays given last where they are, for as long as it is held.
  std::shared_ptr<const void> given() const {
    return plain_ ? std::shared_ptr<const void>(plain_) : std::shared_ptr<const void>(given_.memory);
  }
  // Whether these axes, of `count` positions, are in the arrays given out.
  bool gave(std::span<const Column> axes, std::size_t count) const;
  // The next push shares its memory anew.
  void share_again() { given_.anew = copies_.anew = lists_.anew = true; }
  // The ranks are to forget the memory.
  void unshare(Session& session, const Deadline& deadline);

 private:
  enum class Order { rows, axes };
  struct Room {
    std::byte* first = nullptr;
    std::size_t stride = 0;  // bytes from one axis to the next
  };
  Result<Room> make_given(std::size_t count, int dims, std::size_t width, Order order);
  std::byte* first_given();

  // Memory and where it is known.
  struct Block {
    std::shared_ptr<SharedMemory> memory = std::make_shared<SharedMemory>();
    std::int64_t number = 0;      // by which the ranks know it; 0: not named yet
    std::int64_t replaces = 0;    // the number of the memory before it, which the ranks may still hold; 0: none
    std::uint64_t shared_on = 0;  // Session::data_generation() at which it was shared
    bool anew = false;            // a rank may have lost it: share it once more
    bool covers(const void* from, std::size_t bytes) const;
  };
  // What the block held is lost if it has to grow.
  static Status make_room(Block& block, std::size_t bytes);
  static Status share(Block& block, Session& session, const Deadline& deadline);
  Block given_;              // to the solver
  std::shared_ptr<Buffer<std::byte>> plain_;  // instead, where memory can't be shared
  Order order_ = Order::rows;
  std::size_t capacity_ = 0;  // positions in given_
  std::size_t point_bytes_ = 0;
  Block copies_;
  Block lists_;  // of rows
};

}  // namespace rcb::client
