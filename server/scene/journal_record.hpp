// JournalRecord: how a journal's files hold bytes: checksum, number, length (each 8 bytes, in this machine's order: no
// other machine reads them), then the bytes. The checksum, XXH3-64, is over all that follows it, so a record is whole
// or it is none, whatever the order in which its bytes were stored.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>

#include <xxhash.h>

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
inline std::string encode_record(std::uint64_t number, std::string_view bytes, std::uint64_t seed) {
  std::string record(kRecordHeadBytes, '\0');
  const std::uint64_t length = bytes.size();
  std::memcpy(record.data() + 8, &number, sizeof number);
  std::memcpy(record.data() + 16, &length, sizeof length);
  record += bytes;
  const std::uint64_t sum = XXH3_64bits_withSeed(record.data() + 8, record.size() - 8, seed);
  std::memcpy(record.data(), &sum, sizeof sum);
  return record;
}

// The record at the beginning of `bytes`, a view of them; nothing if there is no valid one.
inline std::optional<JournalRecord> decode_record(std::string_view bytes, std::uint64_t seed) {
  if (bytes.size() < kRecordHeadBytes) return {};
  std::uint64_t length = 0;
  JournalRecord record;
  std::memcpy(&record.checksum, bytes.data(), sizeof record.checksum);
  std::memcpy(&record.number, bytes.data() + 8, sizeof record.number);
  std::memcpy(&length, bytes.data() + 16, sizeof length);
  if (length > kRecordBytesMax || length > bytes.size() - kRecordHeadBytes) return {};
  record.bytes = bytes.substr(kRecordHeadBytes, length);
  const auto sum = XXH3_64bits_withSeed(bytes.data() + 8, record.size() - 8, seed);
  return sum == record.checksum ? std::optional(record) : std::nullopt;
}

// False where nothing was ever written.
inline bool has_record_head(std::string_view bytes) {
  return bytes.substr(0, kRecordHeadBytes).find_first_not_of('\0') != std::string_view::npos;
}

}  // namespace rcb::scene
