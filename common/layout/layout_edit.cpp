// Removals and insertions in the layout of all ranks: rows are reused like slots, and every rank's slots change with
// them.
#include <fmt/format.h>

#include "common/base/check.hpp"
#include "common/layout/layout.hpp"

namespace rcb::layout {

Status Layout::check_edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                          std::span<const std::int32_t> inserted_ranks) const {
  if (inserted_ids.size() != inserted_ranks.size()) return broken("ids and ranks of the inserted differ in number");
  for (std::size_t k = 0; k < removed_rows.size(); ++k)
    if (removed_rows[k] >= count_ || (k > 0 && removed_rows[k] <= removed_rows[k - 1]))
      return broken(fmt::format("row {} of {} can't be removed", removed_rows[k], count_));
  for (const std::int32_t rank : inserted_ranks)
    if (rank < 0 || rank >= ranks()) return broken(fmt::format("rank {} of {} does not exist", rank, ranks()));
  std::vector<Id> ids(inserted_ids.begin(), inserted_ids.end());
  std::sort(ids.begin(), ids.end());
  if (const auto twin = std::adjacent_find(ids.begin(), ids.end()); twin != ids.end())
    return broken(fmt::format("particle {} is inserted twice", *twin));
  for (const Id id : ids)
    if (row_of_id(id)) return broken(fmt::format("particle {} is inserted and was there", id));
  return {};
}

// Updates ids_ and index_ as the rows change.
void Layout::edit_ids(const SlotEdit& rows, std::span<const std::uint64_t> removed_rows,
                      std::span<const Id> inserted_ids) {
  bool still_rows = ids_.empty() && removed_rows.empty();
  for (std::size_t i = 0; i < inserted_ids.size(); ++i)
    still_rows = still_rows && inserted_ids[i] == static_cast<Id>(count_ + i);
  if (still_rows) return;
  if (ids_.empty()) {
    ids_.resize(count_);
    for (std::uint64_t row = 0; row < count_; ++row) ids_[row] = static_cast<Id>(row);
  }
  if (!index_) {
    index_.emplace();
    index_->reserve(rows.new_count);
    for (std::uint64_t row = 0; row < count_; ++row) index_->emplace(ids_[row], row);
  }
  for (const std::uint64_t row : removed_rows) index_->erase(ids_[row]);
  ids_.resize(std::max(count_, rows.new_count));
  for (const SlotMove& move : rows.moves) {
    ids_[move.to] = move.arrival ? inserted_ids[move.from] : ids_[move.from];
    (*index_)[ids_[move.to]] = move.to;
  }
  ids_.resize(rows.new_count);
}

// Applies an edit to one rank's slots. arriving: rows in ascending id.
void Layout::edit_rank(int rank, const SlotEdit& edit, std::span<const std::uint64_t> arriving) {
  auto& rows = rows_[static_cast<std::size_t>(rank)];
  if (rows.size() < edit.new_count) rows.resize(edit.new_count);
  for (const SlotMove& move : edit.moves) {
    const std::uint64_t row = move.arrival ? arriving[move.from] : rows[move.from];
    if (!move.arrival) checksum_ -= place_mix(id_of_row(row), rank, move.from);
    rows[move.to] = row;
    put(row, rank, move.to);
  }
  rows.resize(edit.new_count);
}

Result<SlotEdit> Layout::edit(std::span<const std::uint64_t> removed_rows, std::span<const Id> inserted_ids,
                              std::span<const std::int32_t> inserted_ranks) {
  if (Status status = check_edit(removed_rows, inserted_ids, inserted_ranks); !status.ok()) return status;
  SlotEdit row_edit = edit_of_rank(count_, removed_rows, inserted_ids.size());
  if (removed_rows.empty() && inserted_ids.empty()) return row_edit;
  // By rank: the slots that become free, and the positions in inserted_ids of the arriving particles.
  std::vector<std::vector<std::uint64_t>> leaving(rows_.size());
  std::vector<std::vector<std::uint64_t>> arriving(rows_.size());
  for (const std::uint64_t row : removed_rows) {
    leaving[static_cast<std::size_t>(rank_of_row_[row])].push_back(slot_of_row_[row]);
    checksum_ -= place_mix(id_of_row(row), rank_of_row_[row], slot_of_row_[row]);
  }
  for (std::size_t i = 0; i < inserted_ids.size(); ++i)
    arriving[static_cast<std::size_t>(inserted_ranks[i])].push_back(i);

  edit_ids(row_edit, removed_rows, inserted_ids);
  rank_of_row_.resize(std::max(count_, row_edit.new_count));
  slot_of_row_.resize(rank_of_row_.size());
  std::vector<std::uint64_t> row_of_inserted(inserted_ids.size());
  for (const SlotMove& move : row_edit.moves) {
    if (move.arrival) {
      row_of_inserted[move.from] = move.to;
      continue;
    }
    rank_of_row_[move.to] = rank_of_row_[move.from];
    slot_of_row_[move.to] = slot_of_row_[move.from];
    rows_[static_cast<std::size_t>(rank_of_row_[move.to])][slot_of_row_[move.to]] = move.to;
  }
  rank_of_row_.resize(row_edit.new_count);
  slot_of_row_.resize(row_edit.new_count);
  count_ = row_edit.new_count;
  for (std::size_t rank = 0; rank < rows_.size(); ++rank) {
    auto& in = arriving[rank];
    if (leaving[rank].empty() && in.empty()) continue;
    std::sort(leaving[rank].begin(), leaving[rank].end());
    std::sort(in.begin(), in.end(), [&](auto a, auto b) { return inserted_ids[a] < inserted_ids[b]; });
    for (std::uint64_t& place : in) place = row_of_inserted[place];
    edit_rank(static_cast<int>(rank), edit_of_rank(rows_[rank].size(), leaving[rank], in.size()), in);
  }
  ++version_;
  return row_edit;
}

}  // namespace rcb::layout
