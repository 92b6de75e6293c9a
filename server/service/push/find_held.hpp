// Which rank holds the particles that a push names by id: rank 0 hands the ids round, and every rank looks for them in
// an index of its own.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "common/base/buffer.hpp"
#include "common/base/status.hpp"
#include "common/comm/comm.hpp"
#include "server/service/context/order.hpp"
#include "server/service/scene/scene.hpp"

namespace rcb::service {

// Hands the arrays of rank 0's slice to all ranks, kPiece particles at a time: whatever its size, a rank needs memory
// for one piece and for what of it is its own.
class Pieces {
 public:
  Pieces(comm::Comm& comm, const PushSlice& slice, std::uint64_t count) : comm_(comm), slice_(slice), count_(count) {}

  bool done() const { return first_ >= count_; }
  void next() { first_ += size(); }
  std::uint64_t first() const { return first_; }
  std::size_t size() const { return static_cast<std::size_t>(std::min<std::uint64_t>(kPiece, count_ - first_)); }
  // Collective.
  template <typename T>
  void get(std::size_t array, Buffer<T>& out) {
    out.resize(size());
    if (comm_.rank() == 0)
      std::memcpy(out.data(), slice_.arrays[array].bytes.data() + first_ * sizeof(T), out.span().size_bytes());
    comm_.broadcast(std::as_writable_bytes(out.span()), 0);
  }

 private:
  static constexpr std::uint64_t kPiece = 65536;
  comm::Comm& comm_;
  const PushSlice& slice_;
  std::uint64_t count_;
  std::uint64_t first_ = 0;
};

// Makes the index of each rank's ids, where it isn't there: it is built once, in a scene that needs it, and then
// updated with the particles. Collective. Errors: too_large.
Status make_index(comm::Comm& comm, Scene& scene);

// What to answer where no rank has this id.
Status not_held(particles::Id id, const char* doing);

// Calls found(index in the piece, slot) for each of the distinct ids in this array of the slice that this rank holds,
// after look() has fetched what else it needs of the piece. Errors: not_found, naming the first id that no rank holds;
// those of make_index(). Collective.
template <typename Look, typename Found>
Status find_held(comm::Comm& comm, Scene& scene, const PushSlice& slice, std::size_t array, std::uint64_t count,
                 const char* doing, const Look& look, const Found& found) {
  if (Status made = make_index(comm, scene); !made.ok()) return made;
  const IdIndex& index = scene.index;
  Buffer<particles::Id> ids;
  std::uint64_t held = 0;
  for (Pieces pieces(comm, slice, count); !pieces.done(); pieces.next()) {
    pieces.get(array, ids);
    look(pieces);
    for (std::size_t k = 0; k < ids.size(); ++k)
      if (const auto entry = index.slot.find(ids[k]); entry != index.slot.end()) {
        found(k, ids[k], entry->second);
        ++held;
      }
  }
  comm.all_sum({&held, 1});
  if (held == count) return {};
  std::vector<std::uint64_t> seen;
  for (Pieces pieces(comm, slice, count); !pieces.done(); pieces.next()) {
    pieces.get(array, ids);
    seen.clear();
    for (const particles::Id id : ids) seen.push_back(index.slot.contains(id) ? 1 : 0);
    comm.all_sum(seen);
    const auto missing = std::find(seen.begin(), seen.end(), std::uint64_t{0});
    if (missing != seen.end()) return not_held(ids[static_cast<std::size_t>(missing - seen.begin())], doing);
  }
  return {Code::internal, "an id is held twice"};
}

}  // namespace rcb::service
