#include "server/scene/journal_slots.hpp"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "server/scene/journal_record.hpp"

namespace rcb::scene {
namespace {

constexpr std::size_t kSlotBytesMin = 16384;  // most states and cuts never outgrow it

}  // namespace

std::string_view JournalSlots::slot(std::size_t which) const {
  const std::string_view all = file_->bytes();
  return all.substr(which * (all.size() / 2), all.size() / 2);
}

Status JournalSlots::open(std::vector<std::string>& values, std::vector<std::string>& faults) {
  auto file = storage_->open_file(path_, Storage::Access::write);
  if (!file.ok()) {
    if (file.status().code() == Code::io_error) return file.status();
    if (file.status().code() != Code::not_found) faults.push_back(file.status().message());
    return {};
  }
  file_ = std::move(*file);
  const std::array<std::optional<JournalRecord>, 2> in{decode_record(slot(0), seed_), decode_record(slot(1), seed_)};
  for (std::size_t k = 0; k < 2; ++k)
    if (!in[k] && has_record_head(slot(k)))
      faults.push_back(fmt::format("{}: slot {} is damaged, or was being written", path_, k));
  if (!in[0] && !in[1]) {
    faults.push_back(path_ + ": neither slot is valid");
    file_.reset();
    return {};
  }
  current_ = !in[0] || (in[1] && static_cast<std::int64_t>(in[1]->number - in[0]->number) > 0) ? 1 : 0;
  number_ = in[current_]->number;
  for (const std::size_t k : {current_, 1 - current_})
    if (in[k]) values.emplace_back(in[k]->bytes);
  return {};
}

Status JournalSlots::put(std::string_view bytes) {
  if (bytes.size() > kRecordBytesMax)
    return {Code::too_large, fmt::format("{} can't hold {} bytes, only {}", path_, bytes.size(), kRecordBytesMax)};
  if (!file_ || slot(0).size() < kRecordHeadBytes + bytes.size()) return move_to_larger_file(bytes);
  const std::size_t other = 1 - current_;
  file_->store(other * slot(0).size(), encode_record(++number_, bytes, seed_));
  current_ = other;
  return {};
}

Status JournalSlots::move_to_larger_file(std::string_view bytes) {
  const std::string path = path_ + ".new";
  const std::size_t slot_bytes = std::max(kSlotBytesMin, 2 * (kRecordHeadBytes + bytes.size()));
  auto larger = storage_->make_file(path, 2 * slot_bytes);
  if (!larger.ok()) return larger.status();
  const auto current = file_ ? decode_record(slot(current_), seed_) : std::nullopt;
  if (current) (*larger)->store(0, encode_record(number_, current->bytes, seed_));  // the older one of two from now on
  (*larger)->store(slot_bytes, encode_record(number_ + 1, bytes, seed_));
  if (Status renamed = storage_->rename(path, path_); !renamed) {
    static_cast<void>(storage_->remove(path));
    return renamed;
  }
  file_ = std::move(*larger);
  current_ = 1;
  ++number_;
  return {};
}

}  // namespace rcb::scene
