// What a rank computes of the layout by itself: row blocks, the edit of its arrays, its term of the checksum.
#include "common/base/check.hpp"
#include "common/base/random.hpp"
#include "common/base/wide.hpp"
#include "common/cuts/halo.hpp"
#include "common/layout/layout.hpp"

namespace rcb::layout {

std::int64_t part_begin(int rank, int parts, int ranks) { return static_cast<std::int64_t>(rank) * parts / ranks; }

PartRange parts_of_rank(int rank, int parts, int ranks) {
  return {static_cast<int>(part_begin(rank, parts, ranks)), static_cast<int>(part_begin(rank + 1, parts, ranks))};
}

int rank_of_part(int part, int parts, int ranks) { return cuts::seat_of_part(part, parts, ranks); }

std::uint64_t row_begin(int rank, std::uint64_t count, int ranks) {
  return static_cast<std::uint64_t>(static_cast<u128>(static_cast<unsigned>(rank)) * count /
                                    static_cast<unsigned>(ranks));
}

std::uint64_t place_mix(Id id, int rank, std::uint64_t slot) {
  const std::uint64_t place = (static_cast<std::uint64_t>(rank) << 40U) + slot;
  return mix64(static_cast<std::uint64_t>(id) + mix64(place));
}

std::uint64_t checksum_of_rank(int rank, std::span<const Id> slot_ids) {
  std::uint64_t sum = 0;
  for (std::size_t slot = 0; slot < slot_ids.size(); ++slot) sum += place_mix(slot_ids[slot], rank, slot);
  return sum;
}

bool is_full_change(std::uint64_t rank_changes, std::uint64_t count) { return rank_changes > count / 16; }

SlotEdit edit_of_rank(std::uint64_t count, std::span<const std::uint64_t> leaving, std::uint64_t arrivals) {
  RCB_CHECK(leaving.empty() || leaving.back() < count, "a leaver's slot lies behind the last");
  for (std::size_t i = 1; i < leaving.size(); ++i) RCB_CHECK(leaving[i - 1] < leaving[i], "exports must be ascending");

  SlotEdit edit;
  edit.new_count = count - leaving.size() + arrivals;
  edit.moves.reserve(std::max<std::size_t>(arrivals, leaving.size()));
  const std::uint64_t into_holes = std::min<std::uint64_t>(arrivals, leaving.size());
  for (std::uint64_t i = 0; i < into_holes; ++i) edit.moves.push_back({leaving[i], i, true});
  for (std::uint64_t i = into_holes; i < arrivals; ++i) {
    edit.moves.push_back({count + i - into_holes, i, true});
  }
  // Fewer arrivals than exports: particles in slots behind the new end move into the holes that are left.
  std::size_t gone =
      static_cast<std::size_t>(std::lower_bound(leaving.begin(), leaving.end(), edit.new_count) - leaving.begin());
  std::size_t hole = into_holes;
  for (std::uint64_t slot = edit.new_count; slot < count; ++slot) {
    if (gone < leaving.size() && leaving[gone] == slot) {
      ++gone;
      continue;
    }
    edit.moves.push_back({leaving[hole++], slot, false});
  }
  return edit;
}

std::uint64_t checksum_change(const SlotEdit& edit, int rank, std::span<const Id> slot_ids,
                              std::span<const std::uint64_t> leaving, std::span<const Id> arrived) {
  std::uint64_t change = 0;
  for (const std::uint64_t slot : leaving) change -= place_mix(slot_ids[slot], rank, slot);
  for (const SlotMove& move : edit.moves) {
    const Id id = move.arrival ? arrived[move.from] : slot_ids[move.from];
    if (!move.arrival) change -= place_mix(id, rank, move.from);
    change += place_mix(id, rank, move.to);
  }
  return change;
}

}  // namespace rcb::layout
