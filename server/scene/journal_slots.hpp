// JournalSlots: a file of two slots, which hold the newest value of something and the one before. They are overwritten
// in turn, so one of them is whole whenever this process dies; and without asking for room, so a full disk is none of
// their concern. A value that outgrows its slot moves with the one in force to a larger file, which then takes the
// name.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.hpp"
#include "server/scene/storage.hpp"

namespace rcb::scene {

class JournalSlots {
 public:
  JournalSlots(Storage& storage, std::string path, std::uint64_t seed)
      : storage_(&storage), path_(std::move(path)), seed_(seed) {}

  // values: those found, the newest first: two, one or, where the file isn't there, none. faults: what is wrong with
  // the file, in words, is added. Errors: io_error.
  Status open(std::vector<std::string>& values, std::vector<std::string>& faults);
  // After an open() that found two: the older one is in force, so the newer one is overwritten next.
  void hold_older() { current_ = 1 - current_; }
  // Errors: io_error (only if it doesn't fit the slots, or for the first value), too_large; the values stand then.
  Status put(std::string_view bytes);

 private:
  std::string_view slot(std::size_t which) const;
  Status move_to_larger_file(std::string_view bytes);

  Storage* storage_;
  std::string path_;
  std::uint64_t seed_;
  std::unique_ptr<MappedFile> file_;  // null: no value yet
  std::size_t current_ = 0;           // the slot of the value in force, which is valid if there is a file
  std::uint64_t number_ = 0;          // of the newest value; wraps, so compare differences
};

}  // namespace rcb::scene
