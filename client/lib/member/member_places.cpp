#include "client/lib/member/member_places.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

namespace rcb::client {
namespace {

constexpr int kDigitBits = 11;
constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;
constexpr std::uint32_t kNone = ~std::uint32_t{0};  // no row

}  // namespace

MemberPlaces::Place MemberPlaces::place_of(std::int32_t rank, std::uint64_t slot) {
  return (static_cast<Place>(rank) << kSlotBits) + slot;
}

Buffer<std::uint32_t> ascending(std::span<const std::int64_t> keys) {
  struct Entry {
    std::int64_t key;
    std::uint32_t place;
  };
  Buffer<std::uint32_t> order(keys.size());
  std::iota(order.begin(), order.end(), std::uint32_t{0});
  if (std::is_sorted(keys.begin(), keys.end())) return order;
  Buffer<Entry> from(keys.size()), to(keys.size());
  std::uint64_t differ = 0;
  for (std::size_t k = 0; k < keys.size(); ++k) {
    from[k] = {keys[k], static_cast<std::uint32_t>(k)};
    differ |= static_cast<std::uint64_t>(keys[k] ^ keys[0]);
  }
  for (int shift = 0; shift < 64; shift += kDigitBits) {
    if ((differ >> shift) % kDigits == 0) continue;
    const auto digit = [shift](std::int64_t key) { return (static_cast<std::uint64_t>(key) >> shift) % kDigits; };
    std::array<std::uint32_t, kDigits> next{};
    for (const Entry& entry : from) ++next[digit(entry.key)];
    std::exclusive_scan(next.begin(), next.end(), next.begin(), std::uint32_t{0});
    for (const Entry& entry : from) to[next[digit(entry.key)]++] = entry;
    from.swap(to);
  }
  for (std::size_t k = 0; k < keys.size(); ++k) order[k] = from[k].place;
  return order;
}

void MemberPlaces::take_all(const List& all, int ranks) {
  const std::size_t n = all.id.size();
  ids_.assign(all.id.begin(), all.id.end());
  places_.resize(n);
  for (std::size_t k = 0; k < n; ++k) places_[k] = place_of(all.rank[k], all.slot[k]);
  left_.clear();
  placed_ = {};
  may_have_changed_.assign(kTouched, 0);
  row_at_.resize(static_cast<std::size_t>(ranks));
  rows_.resize(row_at_.size());
  known_ = true;
}

void MemberPlaces::change(std::span<const std::int64_t> left, const List& placed) {
  RCB_CHECK(left_.empty() && placed_.id.empty(), "changes of a step that was not pushed from here");
  const auto touch = [this](std::int64_t id) { may_have_changed_[static_cast<std::size_t>(id) % kTouched] = 1; };
  left_.assign(left.begin(), left.end());
  placed_.id.assign(placed.id.begin(), placed.id.end());
  for (std::size_t k = 0; k < placed.id.size(); ++k) placed_.place.push_back(place_of(placed.rank[k], placed.slot[k]));
  for (const std::int64_t id : left) touch(id);
  for (const std::int64_t id : placed.id) touch(id);
}

std::vector<MemberPlaces::Few> MemberPlaces::select(std::span<const std::uint64_t> rows) const {
  std::vector<std::uint64_t> by_place(rows.begin(), rows.end());
  std::sort(by_place.begin(), by_place.end(), [this](auto a, auto b) { return places_[a] < places_[b]; });
  std::vector<Few> few(rows_.size());
  for (const std::uint64_t row : by_place) {
    Few& of_rank = few[static_cast<std::size_t>(places_[row] >> kSlotBits)];
    of_rank.rows.push_back(row);
    of_rank.slots.push_back(places_[row] % (Place{1} << kSlotBits));
  }
  return few;
}

// Finds the place of every id for next_; false if the ids aren't exactly those held. Rows mostly keep their order from
// step to step, so both lists are walked side by side, and only the rows that don't match are sorted.
bool MemberPlaces::align(std::span<const std::int64_t> ids) {
  std::vector<std::uint32_t> open;  // rows without a place so far
  std::vector<std::uint8_t> used(placed_.id.size(), 0);
  Pool pool;  // particles without a row so far
  next_.resize(ids.size());
  std::size_t old = 0;
  // The place of a particle held before; false if it has left.
  const auto place_now = [&](std::size_t k, Place& place) {
    place = places_[k];
    if (!may_have_changed(ids_[k])) return true;
    if (std::binary_search(left_.begin(), left_.end(), ids_[k])) return false;
    const auto found = std::lower_bound(placed_.id.begin(), placed_.id.end(), ids_[k]);
    if (found == placed_.id.end() || *found != ids_[k]) return true;
    used[static_cast<std::size_t>(found - placed_.id.begin())] = 1;
    place = placed_.place[static_cast<std::size_t>(found - placed_.id.begin())];
    return true;
  };
  Place place = 0;
  for (std::size_t row = 0; row < ids.size(); ++row) {
    while (old < ids_.size() && ids_[old] != ids[row] && !place_now(old, place)) ++old;
    if (old < ids_.size() && ids_[old] == ids[row] && place_now(old, place)) {
      next_[row] = place;
      ++old;
    } else {
      open.push_back(static_cast<std::uint32_t>(row));
    }
  }
  for (; old < ids_.size(); ++old) {
    if (!place_now(old, place)) continue;
    pool.id.push_back(ids_[old]);
    pool.place.push_back(place);
  }
  for (std::size_t k = 0; k < used.size(); ++k) {
    if (used[k] != 0) continue;
    pool.id.push_back(placed_.id[k]);
    pool.place.push_back(placed_.place[k]);
  }
  return match(ids, open, pool);
}

bool MemberPlaces::match(std::span<const std::int64_t> ids, std::span<const std::uint32_t> open, const Pool& pool) {
  if (open.size() != pool.id.size()) return false;
  std::vector<std::int64_t> open_ids;
  for (const std::uint32_t row : open) open_ids.push_back(ids[row]);
  const Buffer<std::uint32_t> order = ascending(open_ids);
  const Buffer<std::uint32_t> order_of_pool = ascending(pool.id);
  for (std::size_t k = 0; k < open.size(); ++k) {
    if (open_ids[order[k]] != pool.id[order_of_pool[k]]) return false;
    next_[open[order[k]]] = pool.place[order_of_pool[k]];
  }
  return true;
}

void MemberPlaces::list_by_rank() {
  for (auto& table : row_at_) std::fill(table.begin(), table.end(), kNone);
  for (std::size_t row = 0; row < places_.size(); ++row) {
    auto& table = row_at_[static_cast<std::size_t>(places_[row] >> kSlotBits)];
    const std::uint64_t slot = places_[row] % (Place{1} << kSlotBits);
    if (slot >= table.size()) table.resize(slot + 1 + slot / 16, kNone);
    table[slot] = static_cast<std::uint32_t>(row);
  }
  for (std::size_t rank = 0; rank < rows_.size(); ++rank) {
    rows_[rank].clear();
    for (const std::uint32_t row : row_at_[rank])
      if (row != kNone) rows_[rank].push_back(row);
  }
}

const std::vector<std::vector<std::uint64_t>>* MemberPlaces::rows(std::span<const std::int64_t> ids) {
  if (!known_ || ids.size() >= kNone || !align(ids)) return nullptr;
  ids_.assign(ids.begin(), ids.end());
  places_.swap(next_);
  for (const std::int64_t id : left_) may_have_changed_[static_cast<std::size_t>(id) % kTouched] = 0;
  for (const std::int64_t id : placed_.id) may_have_changed_[static_cast<std::size_t>(id) % kTouched] = 0;
  left_.clear();
  placed_ = {};
  list_by_rank();
  return &rows_;
}

}  // namespace rcb::client
