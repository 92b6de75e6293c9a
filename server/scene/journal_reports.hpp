// JournalReports: the reports of a scene, in the order of their numbers, in files ("segments") steps.0, steps.1, ... of
// 1 MiB, more where a report needs more.
//
// Invariants
// 1. The checksum of a record is seeded with that of the record before. So what an earlier process has left behind the
//    end, or in a segment that wasn't removed, is never taken for what follows; and segments need not be clean.
// 2. Numbers ascend; one that is missing is a report that was lost when the disk was full.
// 3. Of the segments only that where the next report goes is mapped, and the next one; the others while they are read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "server/scene/journal_record.hpp"
#include "server/scene/storage.hpp"

namespace rcb::scene {

class JournalReports {
 public:
  using Visit = std::function<void(std::uint64_t number, std::string_view report)>;

  JournalReports(Storage& storage, std::string folder, std::uint64_t seed)
      : storage_(&storage), folder_(std::move(folder)), end_{.chain = seed} {}

  // Reads all that is there; the first record that isn't valid ends it. Errors: io_error.
  Status open(std::vector<std::string>& faults);
  // number: at least next(). Errors: io_error (no room: the report isn't kept, a later one may be), too_large.
  Status append(std::uint64_t number, std::string_view report);
  // Those of the reports [first, last) that are there, ascending. Errors: io_error.
  Status read(std::uint64_t first, std::uint64_t last, const Visit& visit) const;
  // What read() needs, as of now: for another thread, while this one goes on appending.
  JournalReports reader() const;
  // Forgets those from `number` on. Errors: io_error.
  Status keep_below(std::uint64_t number);
  std::uint64_t count() const { return count_; }
  std::uint64_t next() const { return end_.number; }  // above the last one's number

 private:
  struct Place {
    std::uint64_t number = 0;  // the next record has this number or a higher one
    std::size_t segment = 0;   // and is here, or at the beginning of the next segment
    std::size_t offset = 0;
    std::uint64_t chain = 0;  // checksum of the record before
  };
  struct Reader {
    Place at;
    std::unique_ptr<MappedFile> file;  // of at.segment
  };
  std::string path(std::size_t segment) const;
  // Null if it isn't there, or no file to trust.
  Result<std::unique_ptr<MappedFile>> open_segment(std::size_t segment, Storage::Access access) const;
  Result<std::unique_ptr<MappedFile>> empty_segment(std::size_t segment, std::size_t bytes_min);
  Result<std::optional<JournalRecord>> read_next(Reader& reader) const;
  std::size_t mark_before(std::uint64_t number) const;
  Status make_room(std::size_t bytes);
  void pass(const Place& behind);

  Storage* storage_;
  std::string folder_;
  Place end_;
  std::uint64_t count_ = 0;
  std::vector<Place> marks_;           // of every kMarkRecords-th record
  std::unique_ptr<MappedFile> file_;   // of end_.segment; null: not opened yet
  std::unique_ptr<MappedFile> ahead_;  // the next one, if prepared
};

}  // namespace rcb::scene
