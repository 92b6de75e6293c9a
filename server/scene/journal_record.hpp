// JournalRecord: how a journal's files hold bytes: checksum, number, length (each 8 bytes, in this machine's order: no
// other machine reads them), then the bytes. The checksum, XXH3-64, is over all that follows it, so a record is whole
// or it is none, whatever the order in which its bytes were stored.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace rcb::scene {

inline constexpr std::size_t kRecordHeadBytes = 24;
inline constexpr std::size_t kRecordBytesMax = std::size_t{64} << 20U;  // without the head

struct JournalRecord {
  std::uint64_t checksum = 0;
  std::uint64_t number = 0;
  std::string_view bytes;
  std::size_t size() const { return kRecordHeadBytes + bytes.size(); }
};

// seed: of the checksum. Where another one was written, there is no record.
std::string encode_record(std::uint64_t number, std::string_view bytes, std::uint64_t seed);
// The record at the beginning of `bytes`, a view of them; nothing if there is no valid one.
std::optional<JournalRecord> decode_record(std::string_view bytes, std::uint64_t seed);
// False where nothing was ever written.
bool has_record_head(std::string_view bytes);

}  // namespace rcb::scene
