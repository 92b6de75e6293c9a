// Frames of protocol version 1 (PROTOCOL.md): bytes to header and back. Knows no socket.
//
// Invariants
// 1. Any bytes may be decoded: what breaks the protocol comes back as protocol_error, never as a crash.
// 2. The lengths of a decoded header are as the peer claims; the receiver compares them with its limits
//    (check_lengths) before it makes room for anything.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "common/base/status.hpp"

namespace rcb::wire {

inline constexpr std::size_t kHeaderBytes = 40;
inline constexpr std::uint16_t kProtocolVersion = 1;
inline constexpr std::uint32_t kFlagBulkChecksum = 1;

enum class FrameType : std::uint16_t {
  welcome = 1,
  hello = 2,
  request = 3,
  reply = 4,
  failure = 5,
  notice = 6,
  goodbye = 7,
};

struct FrameHeader {
  FrameType type = FrameType::request;
  std::uint32_t flags = 0;
  std::uint32_t json_bytes = 0;  // set by encode_header
  std::uint64_t request = 0;
  std::uint64_t bulk_bytes = 0;
  std::uint64_t checksum = 0;  // set by encode_header
};

using HeaderBytes = std::array<std::byte, kHeaderBytes>;

// Sets json_bytes from `json` and computes the checksum over header and JSON.
HeaderBytes encode_header(FrameHeader header, std::string_view json);
// Header and JSON in one string, to be written before the bulk.
std::string encode_frame(FrameHeader header, std::string_view json);
// Checks magic, version, type; not the checksum (the JSON isn't there yet) and not the limits.
// Errors: protocol_error.
Result<FrameHeader> decode_header(std::span<const std::byte, kHeaderBytes> bytes);
// Errors: protocol_error. Call when the JSON has arrived, before believing any field of the header but its lengths.
Status verify_checksum(std::span<const std::byte, kHeaderBytes> bytes, std::string_view json);
// The claimed lengths against limits of the receiver. Errors: too_large; the connection is closed after it, as
// the rest of the frame isn't read.
Status check_lengths(const FrameHeader& header, std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max);

// XXH3-64 of the bulk, piece by piece: what follows it where kFlagBulkChecksum is set (8 bytes, little-endian).
class BulkChecksum {
 public:
  BulkChecksum();
  BulkChecksum(BulkChecksum&&) noexcept;
  BulkChecksum& operator=(BulkChecksum&&) noexcept;
  ~BulkChecksum();
  void add(std::span<const std::byte> bytes);
  std::uint64_t value() const;
  // The 8 bytes as they travel.
  static std::array<std::byte, 8> encode(std::uint64_t value);
  static std::uint64_t decode(std::span<const std::byte, 8> bytes);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::wire
