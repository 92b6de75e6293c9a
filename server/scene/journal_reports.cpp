#include "server/scene/journal_reports.hpp"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include "common/files/paths.hpp"

namespace rcb::scene {
namespace {

constexpr std::size_t kSegmentBytes = std::size_t{1} << 20U;
constexpr std::size_t kMarkRecords = 256;  // as many are read at most before one that is asked for
constexpr std::uint64_t kNumberMax = std::uint64_t{1} << 62U;

std::string_view bytes_from(const MappedFile* file, std::size_t offset) {
  return file == nullptr ? "" : file->bytes().substr(std::min(offset, file->bytes().size()));
}

}  // namespace

std::string JournalReports::path(std::size_t segment) const {
  return join_path(folder_, fmt::format("steps.{}", segment));
}

Result<std::unique_ptr<MappedFile>> JournalReports::open_segment(std::size_t segment, Storage::Access access) const {
  auto file = storage_->open_file(path(segment), access);
  if (file.ok() || file.status().code() == Code::io_error) return file;
  return std::unique_ptr<MappedFile>();
}

// One that is there was prepared, or left behind the end.
Result<std::unique_ptr<MappedFile>> JournalReports::empty_segment(std::size_t segment, std::size_t bytes_min) {
  auto file = open_segment(segment, Storage::Access::write);
  if (!file.ok() || (*file && (*file)->bytes().size() >= bytes_min)) return file;
  return storage_->make_file(path(segment), std::max(kSegmentBytes, bytes_min));
}

Result<std::optional<JournalRecord>> JournalReports::read_next(Reader& reader) const {
  if (!reader.file) {
    auto file = open_segment(reader.at.segment, Storage::Access::read);
    if (!file.ok()) return file.status();
    reader.file = std::move(*file);
  }
  Place at = reader.at;
  auto record = decode_record(bytes_from(reader.file.get(), at.offset), at.chain);
  if (!record) {
    auto file = open_segment(++at.segment, Storage::Access::read);
    if (!file.ok()) return file.status();
    at.offset = 0;
    record = decode_record(bytes_from(file->get(), 0), at.chain);
    if (record) reader.file = std::move(*file);
  }
  if (!record || record->number < at.number || record->number > kNumberMax) return std::optional<JournalRecord>();
  reader.at = {record->number + 1, at.segment, at.offset + record->size(), record->checksum};
  return record;
}

// The record between end_ and `behind` is the journal's last one.
void JournalReports::pass(const Place& behind) {
  if (count_++ % kMarkRecords == 0) marks_.push_back(end_);
  end_ = behind;
}

Status JournalReports::open(std::vector<std::string>& faults) {
  Reader reader{end_, nullptr};
  for (auto record = read_next(reader);; record = read_next(reader)) {
    if (!record.ok()) return record.status();
    if (!*record) break;
    pass(reader.at);
  }
  if (has_record_head(bytes_from(reader.file.get(), end_.offset)))
    faults.push_back(
        fmt::format("{}: the record at byte {} is damaged, or was being written", path(end_.segment), end_.offset));
  return {};
}

std::size_t JournalReports::mark_before(std::uint64_t number) const {
  const auto above = std::upper_bound(marks_.begin(), marks_.end(), number,
                                      [](std::uint64_t value, const Place& mark) { return value < mark.number; });
  return static_cast<std::size_t>(std::max<std::ptrdiff_t>(above - marks_.begin() - 1, 0));
}

Status JournalReports::read(std::uint64_t first, std::uint64_t last, const Visit& visit) const {
  last = std::min(last, end_.number);
  if (first >= last) return {};
  Reader reader{marks_[mark_before(first)], nullptr};
  while (reader.at.number < last) {
    const auto record = read_next(reader);
    if (!record.ok()) return record.status();
    if (!*record)
      return {Code::io_error, fmt::format("{}: the report after number {} can't be read any more",
                                          path(reader.at.segment), reader.at.number)};
    if ((*record)->number >= first && (*record)->number < last) visit((*record)->number, (*record)->bytes);
  }
  return {};
}

JournalReports JournalReports::reader() const {
  JournalReports copy(*storage_, folder_, 0);
  copy.end_ = end_;
  copy.marks_ = marks_;
  return copy;
}

Status JournalReports::keep_below(std::uint64_t number) {
  if (number >= end_.number) return {};
  const std::size_t mark = mark_before(number);
  Reader reader{marks_[mark], nullptr};
  Place kept = reader.at;
  std::uint64_t count = mark * kMarkRecords;
  for (;; ++count, kept = reader.at) {
    const auto record = read_next(reader);
    if (!record.ok()) return record.status();
    if (!*record || (*record)->number >= number) break;
  }
  end_ = kept;
  count_ = count;
  marks_.resize((count + kMarkRecords - 1) / kMarkRecords);
  file_.reset();
  ahead_.reset();
  return {};
}

Status JournalReports::make_room(std::size_t bytes) {
  if (!file_ && end_.offset > 0) {
    auto file = open_segment(end_.segment, Storage::Access::write);
    if (!file.ok()) return file.status();
    file_ = std::move(*file);
  }
  const std::size_t left = bytes_from(file_.get(), end_.offset).size();
  if (left >= bytes) return {};
  const std::size_t segment = end_.offset > 0 ? end_.segment + 1 : end_.segment;
  if (!ahead_ || ahead_->bytes().size() < bytes) {
    ahead_.reset();  // its file may be replaced, and then not be there
    auto file = empty_segment(segment, bytes);
    if (!file.ok()) return file.status();
    ahead_ = std::move(*file);
  }
  // A record that was forgotten may be at the end of this one, and must not be taken for the next.
  if (file_) file_->store(end_.offset, std::string(std::min(left, kRecordHeadBytes), '\0'));
  file_ = std::move(ahead_);
  end_.segment = segment;
  end_.offset = 0;
  return {};
}

Status JournalReports::append(std::uint64_t number, std::string_view report) {
  if (number < end_.number || number > kNumberMax)
    return {Code::invalid_argument, fmt::format("report {} can't follow report {}", number, end_.number)};
  if (report.size() > kRecordBytesMax)
    return {Code::too_large,
            fmt::format("report {} has {} bytes, more than {}", number, report.size(), kRecordBytesMax)};
  std::string bytes = encode_record(number, report, end_.chain);
  if (Status room = make_room(bytes.size()); !room) return room;
  const JournalRecord record = *decode_record(bytes, end_.chain);
  const std::size_t behind = end_.offset + bytes.size();
  // An empty head behind it, so that what was left there isn't told as damage.
  bytes.resize(bytes.size() + std::min(kRecordHeadBytes, file_->bytes().size() - behind));
  file_->store(end_.offset, bytes);
  pass({number + 1, end_.segment, behind, record.checksum});
  // A side thread could do this, were 1 MiB of room ever slow to get. Failures are told when the segment is needed.
  if (!ahead_ && behind > file_->bytes().size() / 4 * 3)
    if (auto ahead = empty_segment(end_.segment + 1, kSegmentBytes); ahead.ok()) ahead_ = std::move(*ahead);
  return {};
}

}  // namespace rcb::scene
