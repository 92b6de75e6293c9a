#include "server/scene/journal_record.hpp"

#include <cstring>

#include <xxhash.h>

namespace rcb::scene {
namespace {

constexpr std::size_t kSumBytes = sizeof(std::uint64_t);  // of the head, not summed

std::uint64_t record_number_at(std::string_view bytes, std::size_t at) {
  std::uint64_t number = 0;
  std::memcpy(&number, bytes.data() + at, sizeof number);
  return number;
}

}  // namespace

std::string encode_record(std::uint64_t number, std::string_view bytes, std::uint64_t seed) {
  std::string record(kRecordHeadBytes, '\0');
  const std::uint64_t length = bytes.size();
  std::memcpy(record.data() + 8, &number, sizeof number);
  std::memcpy(record.data() + 16, &length, sizeof length);
  record += bytes;
  const std::uint64_t sum = XXH3_64bits_withSeed(record.data() + kSumBytes, record.size() - kSumBytes, seed);
  std::memcpy(record.data(), &sum, sizeof sum);
  return record;
}

std::optional<JournalRecord> decode_record(std::string_view bytes, std::uint64_t seed) {
  if (bytes.size() < kRecordHeadBytes) return {};
  const std::uint64_t length = record_number_at(bytes, 16);
  if (length > kRecordBytesMax || length > bytes.size() - kRecordHeadBytes) return {};
  const JournalRecord record{record_number_at(bytes, 0), record_number_at(bytes, 8),
                             bytes.substr(kRecordHeadBytes, length)};
  const auto sum = XXH3_64bits_withSeed(bytes.data() + kSumBytes, record.size() - kSumBytes, seed);
  return sum == record.checksum ? std::optional(record) : std::nullopt;
}

bool has_record_head(std::string_view bytes) {
  return bytes.substr(0, kRecordHeadBytes).find_first_not_of('\0') != std::string_view::npos;
}

}  // namespace rcb::scene
