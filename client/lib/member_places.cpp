#include "client/lib/member_places.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

namespace rcb::client {
namespace {

constexpr int kDigitBits = 11;
constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;
constexpr int kSlotBits = 40;  // a place as one number: the rank above the slot

}  // namespace

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
  id_.assign(all.id);
  rank_.assign(all.rank);
  slot_.assign(all.slot);
  order_.resize(static_cast<std::size_t>(ranks));
  rows_.resize(order_.size());
  ordered_ = false;
  known_ = true;
}

void MemberPlaces::change(std::span<const std::int64_t> left, const List& placed) {
  if (left.empty() && placed.id.empty()) return;
  Buffer<std::int64_t> id;
  Buffer<std::int32_t> rank;
  Buffer<std::uint64_t> slot;
  id.reserve(id_.size() + placed.id.size());
  rank.reserve(id_.size() + placed.id.size());
  slot.reserve(id_.size() + placed.id.size());
  std::size_t l = 0, p = 0;
  const auto put_placed = [&] {
    id.push_back(placed.id[p]);
    rank.push_back(placed.rank[p]);
    slot.push_back(placed.slot[p++]);
  };
  for (std::size_t k = 0; k < id_.size(); ++k) {
    while (p < placed.id.size() && placed.id[p] < id_[k]) put_placed();
    while (l < left.size() && left[l] < id_[k]) ++l;
    if (p < placed.id.size() && placed.id[p] == id_[k]) {
      put_placed();
    } else if (l == left.size() || left[l] != id_[k]) {
      id.push_back(id_[k]);
      rank.push_back(rank_[k]);
      slot.push_back(slot_[k]);
    }
  }
  while (p < placed.id.size()) put_placed();
  id_.swap(id);
  rank_.swap(rank);
  slot_.swap(slot);
  ordered_ = false;
}

void MemberPlaces::order_places() {
  Buffer<std::int64_t> keys(id_.size());
  for (std::size_t k = 0; k < keys.size(); ++k)
    keys[k] = (std::int64_t{rank_[k]} << kSlotBits) + static_cast<std::int64_t>(slot_[k]);
  for (auto& of_rank : order_) of_rank.clear();
  for (const std::uint32_t k : ascending(keys.span())) order_[static_cast<std::size_t>(rank_[k])].push_back(k);
  ordered_ = true;
}

const std::vector<std::vector<std::uint64_t>>* MemberPlaces::rows(std::span<const std::int64_t> ids) {
  if (!known_ || ids.size() != id_.size()) return nullptr;
  if (ids_.size() != ids.size() || !std::equal(ids.begin(), ids.end(), ids_.begin())) {
    ids_.assign(ids);
    row_by_id_ = ascending(ids);
  }
  for (std::size_t k = 0; k < ids.size(); ++k)
    if (ids[row_by_id_[k]] != id_[k]) return nullptr;
  if (!ordered_) order_places();
  for (std::size_t rank = 0; rank < order_.size(); ++rank) {
    rows_[rank].resize(order_[rank].size());
    for (std::size_t k = 0; k < rows_[rank].size(); ++k) rows_[rank][k] = row_by_id_[order_[rank][k]];
  }
  return &rows_;
}

}  // namespace rcb::client
