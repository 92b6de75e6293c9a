// Frames of protocol version 1 (PROTOCOL.md): bytes to header and back. Knows no socket.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
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
  std::uint32_t json_bytes = 0;
  std::uint64_t request = 0;
  std::uint64_t bulk_bytes = 0;
  std::uint64_t checksum = 0;  // set by encode_header
};

using HeaderBytes = std::array<std::byte, kHeaderBytes>;

// Computes the checksum over header and JSON.
HeaderBytes encode_header(FrameHeader header, std::string_view json);
// Checks magic, version, type; not the checksum (the JSON isn't there yet) and not the limits.
// Errors: protocol_error.
Result<FrameHeader> decode_header(std::span<const std::byte, kHeaderBytes> bytes);
// Errors: protocol_error. Call when the JSON has arrived, before believing any field of the header but its lengths.
Status verify_checksum(std::span<const std::byte, kHeaderBytes> bytes, std::string_view json);

}  // namespace rcb::wire
