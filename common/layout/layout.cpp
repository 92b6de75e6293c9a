// The layout of all ranks, in plain arrays by row, so that the cost of a step is in proportion to what changes.
#include "common/layout/layout.hpp"

#include <atomic>
#include <numeric>

#include <fmt/format.h>

#include "common/base/check.hpp"

namespace rcb::layout {

Status Layout::broken(const std::string& what) {
  return {Code::protocol_error, "the plan: " + what, "fetch the plan again; the service may differ"};
}

Layout::Layout(std::uint64_t count, int ranks, std::span<const Id> ids) : count_(count) {
  static std::atomic<std::uint64_t> made{0};
  number_ = ++made;
  RCB_CHECK(ranks >= 1, "a plan needs a rank");
  RCB_CHECK(ids.empty() || ids.size() == count, "one id a row");
  rows_.resize(static_cast<std::size_t>(ranks));
  rank_of_row_.assign(count, -1);
  slot_of_row_.resize(count);
  bool is_row = true;
  bool ascending = true;
  for (std::size_t row = 0; row < ids.size(); ++row) {
    is_row = is_row && ids[row] == static_cast<Id>(row);
    ascending = ascending && (row == 0 || ids[row - 1] < ids[row]);
  }
  if (is_row) return;
  ids_.assign(ids.begin(), ids.end());
  if (!ascending) sort_rows();
}

void Layout::sort_rows() {
  rows_by_id_.resize(count_);
  std::iota(rows_by_id_.begin(), rows_by_id_.end(), std::uint64_t{0});
  std::sort(rows_by_id_.begin(), rows_by_id_.end(),
            [&](std::uint64_t a, std::uint64_t b) { return ids_[a] != ids_[b] ? ids_[a] < ids_[b] : a < b; });
}

void Layout::put(std::uint64_t row, int rank, std::uint64_t slot) {
  rank_of_row_[row] = rank;
  slot_of_row_[row] = slot;
  checksum_ += place_mix(id_of_row(row), rank, slot);
}

Layout Layout::blocks(std::uint64_t count, int ranks, std::span<const Id> ids) {
  Layout plan(count, ranks, ids);
  for (int rank = 0; rank < ranks; ++rank) {
    const std::uint64_t begin = row_begin(rank, count, ranks);
    auto& rows = plan.rows_[static_cast<std::size_t>(rank)];
    rows.resize(row_begin(rank + 1, count, ranks) - begin);
    std::iota(rows.begin(), rows.end(), begin);
    for (std::uint64_t slot = 0; slot < rows.size(); ++slot) plan.put(rows[slot], rank, slot);
  }
  return plan;
}

Result<Layout> Layout::full(const std::vector<std::uint64_t>& rank_counts, std::span<const Id> slot_ids,
                            std::span<const Id> ids, std::uint64_t version) {
  if (rank_counts.empty()) return broken("it names no rank");
  if (!ids.empty() && ids.size() != slot_ids.size()) {
    return broken(fmt::format("the scene has {} particles, the solver {}", slot_ids.size(), ids.size()));
  }
  std::uint64_t left = slot_ids.size();
  for (const std::uint64_t count : rank_counts) {
    if (count > left) return broken(fmt::format("its counts exceed its {} ids", slot_ids.size()));
    left -= count;
  }
  if (left != 0) return broken(fmt::format("its counts miss {} of its {} ids", left, slot_ids.size()));

  Layout plan(slot_ids.size(), static_cast<int>(rank_counts.size()), ids);
  plan.version_ = version;
  std::size_t next = 0;
  for (std::size_t rank = 0; rank < rank_counts.size(); ++rank) {
    auto& rows = plan.rows_[rank];
    rows.resize(rank_counts[rank]);
    for (std::uint64_t slot = 0; slot < rows.size(); ++slot) {
      const Id id = slot_ids[next++];
      const auto row = plan.row_of_id(id);
      if (!row) return broken(fmt::format("particle {} is not one of the solver's", id));
      if (plan.rank_of_row_[*row] >= 0) return broken(fmt::format("particle {} stands in two places", id));
      rows[slot] = *row;
      plan.put(*row, static_cast<int>(rank), slot);
    }
  }
  return plan;
}

std::optional<std::uint64_t> Layout::row_of_id(Id id) const {
  if (ids_.empty()) {
    if (id < 0 || static_cast<std::uint64_t>(id) >= count_) return std::nullopt;
    return static_cast<std::uint64_t>(id);
  }
  if (index_) {
    const auto found = index_->find(id);
    return found == index_->end() ? std::nullopt : std::optional(found->second);
  }
  std::uint64_t row = count_;
  if (rows_by_id_.empty()) {
    row = static_cast<std::uint64_t>(std::lower_bound(ids_.begin(), ids_.end(), id) - ids_.begin());
  } else {
    const auto place = std::lower_bound(rows_by_id_.begin(), rows_by_id_.end(), id,
                                        [&](std::uint64_t r, Id value) { return ids_[r] < value; });
    if (place != rows_by_id_.end()) row = *place;
  }
  if (row == count_ || ids_[row] != id) return std::nullopt;
  return row;
}

Status Layout::apply(std::span<const std::uint64_t> changed_rows, std::span<const std::int32_t> new_ranks, bool first) {
  if (changed_rows.size() != new_ranks.size()) return broken("rows and ranks of a change differ in number");
  std::vector<Change> changes;
  for (std::size_t i = 0; i < changed_rows.size(); ++i) {
    const std::uint64_t row = changed_rows[i];
    const std::int32_t to = new_ranks[i];
    if (row >= count_) return broken(fmt::format("row {} of {} does not exist", row, count_));
    if (to < 0 || to >= ranks()) return broken(fmt::format("rank {} of {} does not exist", to, ranks()));
    if (rank_of_row_[row] != to) changes.push_back({row, to});
  }
  if (!first && changes.empty()) return {};
  const Status done =
      first || is_full_change(changes.size(), count_) ? apply_full(changes) : apply_partial(std::move(changes));
  if (done.ok()) ++version_;
  return done;
}

Status Layout::apply_full(std::span<const Change> changes) {
  std::vector<bool> seen(count_);
  for (const Change& change : changes) {
    if (seen[change.row]) return broken(fmt::format("row {} is named twice", change.row));
    seen[change.row] = true;
  }
  for (const Change& change : changes) rank_of_row_[change.row] = change.to;
  list_by_id();
  return {};
}

// Puts every rank's particles in ascending id.
void Layout::list_by_id() {
  if (index_) sort_rows();  // rows_by_id_ isn't kept up to date from the first edit() on
  std::vector<std::uint64_t> counts(rows_.size());
  for (const std::int32_t rank : rank_of_row_) ++counts[static_cast<std::size_t>(rank)];
  for (std::size_t rank = 0; rank < rows_.size(); ++rank) {
    rows_[rank].clear();
    rows_[rank].reserve(counts[rank]);
  }
  checksum_ = 0;
  for (std::uint64_t i = 0; i < count_; ++i) {
    const std::uint64_t row = rows_by_id_.empty() ? i : rows_by_id_[i];
    const std::int32_t rank = rank_of_row_[row];
    auto& rows = rows_[static_cast<std::size_t>(rank)];
    put(row, rank, rows.size());
    rows.push_back(row);
  }
}

Status Layout::apply_partial(std::vector<Change> changes) {
  // Arrivals are sorted by destination and id, exports by source and slot, so that no rank's rows need be scanned.
  std::vector<Change> arriving = changes;
  std::sort(changes.begin(), changes.end(), [&](const Change& a, const Change& b) {
    const std::int32_t rank_a = rank_of_row_[a.row], rank_b = rank_of_row_[b.row];
    return rank_a != rank_b ? rank_a < rank_b : slot_of_row_[a.row] < slot_of_row_[b.row];
  });
  for (std::size_t i = 1; i < changes.size(); ++i) {
    if (changes[i - 1].row == changes[i].row) return broken(fmt::format("row {} is named twice", changes[i].row));
  }
  std::sort(arriving.begin(), arriving.end(), [&](const Change& a, const Change& b) {
    return a.to != b.to ? a.to < b.to : id_of_row(a.row) < id_of_row(b.row);
  });
  // All edits are computed before the first is applied, since they read the old ranks and slots of the rows.
  struct Edit {
    int rank;
    std::size_t arrivals_begin;
    SlotEdit edit;
  };
  std::vector<Edit> edits;
  std::vector<std::uint64_t> leaving;
  std::size_t out = 0, in = 0;
  while (out < changes.size() || in < arriving.size()) {
    std::int32_t rank = out < changes.size() ? rank_of_row_[changes[out].row] : ranks();
    if (in < arriving.size()) rank = std::min(rank, arriving[in].to);
    leaving.clear();
    for (; out < changes.size() && rank_of_row_[changes[out].row] == rank; ++out) {
      leaving.push_back(slot_of_row_[changes[out].row]);
    }
    const std::size_t arrivals_begin = in;
    while (in < arriving.size() && arriving[in].to == rank) ++in;
    edits.push_back({rank, arrivals_begin, edit_of_rank(rows(rank).size(), leaving, in - arrivals_begin)});
  }
  for (const Change& change : changes) {
    checksum_ -= place_mix(id_of_row(change.row), rank_of_row_[change.row], slot_of_row_[change.row]);
  }
  std::vector<std::uint64_t> rows;
  for (const Change& change : arriving) rows.push_back(change.row);
  for (const Edit& e : edits) edit_rank(e.rank, e.edit, std::span(rows).subspan(e.arrivals_begin));
  return {};
}

}  // namespace rcb::layout
