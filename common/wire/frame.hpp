// Frames of protocol version 2 (PROTOCOL.md): encodes and decodes headers. Independent of sockets.
//
// Invariants
// 1. Any bytes may be decoded: a breach of the protocol is returned as protocol_error and never crashes.
// 2. The lengths in a decoded header are the peer's claims; the receiver compares them with its limits (check_lengths)
//    before it allocates anything.
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
inline constexpr std::uint16_t kProtocolVersion = 2;
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
// Header and JSON in one string, to be written before the bulk (the arrays).
std::string encode_frame(FrameHeader header, std::string_view json);
// Checks magic, version and type; not the checksum (the JSON hasn't arrived yet), and not the limits. Errors:
// protocol_error.
Result<FrameHeader> decode_header(std::span<const std::byte, kHeaderBytes> bytes);
// Errors: protocol_error. To be called once the JSON has arrived. Until then only the header's lengths may be used.
Status verify_checksum(std::span<const std::byte, kHeaderBytes> bytes, std::string_view json);
// Compares the claimed lengths with the receiver's limits. Errors: too_large; the connection must then be closed, as
// the rest of the frame isn't read.
Status check_lengths(const FrameHeader& header, std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max);

// XXH3-64 of the bulk, computed piece by piece. With kFlagBulkChecksum its 8 bytes (little-endian) follow the bulk.
class BulkChecksum {
 public:
  BulkChecksum();
  ~BulkChecksum();
  void add(std::span<const std::byte> bytes);
  std::uint64_t value() const;
  // To and from the 8 bytes on the wire.
  static std::array<std::byte, 8> encode(std::uint64_t value);
  static std::uint64_t decode(std::span<const std::byte, 8> bytes);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace rcb::wire
