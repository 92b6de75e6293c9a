#include "common/wire/frame.hpp"

#include <fmt/format.h>

#define XXH_STATIC_LINKING_ONLY  // needed for a hash state on the stack
#include <algorithm>
#include <concepts>

#include <xxhash.h>

#include "common/base/narrow.hpp"

namespace rcb::wire {
namespace {

constexpr std::string_view kMagic = "RCBD";
constexpr std::size_t kChecksumOffset = 32;

template <std::unsigned_integral T>
void put(std::byte* to, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i)
    to[i] = static_cast<std::byte>((std::uint64_t{value} >> (8U * i)) & std::uint64_t{0xFF});
}

template <std::unsigned_integral T>
T get(const std::byte* from) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) value |= std::to_integer<std::uint64_t>(from[i]) << (8U * i);
  return static_cast<T>(value);
}

std::uint64_t checksum_of(const std::byte* header, std::string_view json) {
  XXH3_state_t state;
  XXH3_64bits_reset(&state);
  XXH3_64bits_update(&state, header, kChecksumOffset);
  XXH3_64bits_update(&state, json.data(), json.size());
  return XXH3_64bits_digest(&state);
}

}  // namespace

HeaderBytes encode_header(FrameHeader header, std::string_view json) {
  HeaderBytes bytes{};
  std::transform(kMagic.begin(), kMagic.end(), bytes.begin(), [](char c) { return static_cast<std::byte>(c); });
  put(&bytes[4], kProtocolVersion);
  put(&bytes[6], static_cast<std::uint16_t>(header.type));
  put(&bytes[8], header.flags);
  put(&bytes[12], narrow<std::uint32_t>(json.size()));
  put(&bytes[16], header.request);
  put(&bytes[24], header.bulk_bytes);
  put(&bytes[kChecksumOffset], checksum_of(bytes.data(), json));
  return bytes;
}

std::string encode_frame(FrameHeader header, std::string_view json) {
  const HeaderBytes bytes = encode_header(header, json);
  std::string frame;
  frame.reserve(bytes.size() + json.size());
  frame.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  frame.append(json);
  return frame;
}

Result<FrameHeader> decode_header(std::span<const std::byte, kHeaderBytes> bytes) {
  if (!std::equal(kMagic.begin(), kMagic.end(), bytes.begin(),
                  [](char c, std::byte b) { return static_cast<std::byte>(c) == b; }))
    return Status(Code::protocol_error, "frame: the first four bytes aren't 'RCBD'",
                  "the peer speaks another protocol, or the stream lost its place");
  const auto version = get<std::uint16_t>(&bytes[4]);
  if (version != kProtocolVersion)
    return Status(Code::protocol_error,
                  fmt::format("frame: protocol version {}, expected {}", version, kProtocolVersion),
                  "use a client and a service of the same protocol version");
  const auto type = get<std::uint16_t>(&bytes[6]);
  if (type < static_cast<std::uint16_t>(FrameType::welcome) || type > static_cast<std::uint16_t>(FrameType::goodbye))
    return Status(Code::protocol_error, fmt::format("frame: unknown type {}", type));
  FrameHeader header;
  header.type = static_cast<FrameType>(type);
  header.flags = get<std::uint32_t>(&bytes[8]);
  header.json_bytes = get<std::uint32_t>(&bytes[12]);
  header.request = get<std::uint64_t>(&bytes[16]);
  header.bulk_bytes = get<std::uint64_t>(&bytes[24]);
  header.checksum = get<std::uint64_t>(&bytes[kChecksumOffset]);
  return header;
}

Status verify_checksum(std::span<const std::byte, kHeaderBytes> bytes, std::string_view json) {
  const std::uint64_t computed = checksum_of(bytes.data(), json);
  const auto claimed = get<std::uint64_t>(&bytes[kChecksumOffset]);
  if (computed == claimed) return {};
  return {
      Code::protocol_error,
      fmt::format("frame: checksum {:016x} in the header, {:016x} computed over header and JSON", claimed, computed),
      "the bytes were damaged on the way, or the sender computes the checksum wrongly"};
}

Status check_lengths(const FrameHeader& header, std::uint64_t json_bytes_max, std::uint64_t bulk_bytes_max) {
  if (header.json_bytes > json_bytes_max)
    return {Code::too_large,
            fmt::format("frame: {} bytes of JSON, at most {} are taken", header.json_bytes, json_bytes_max)};
  if (header.bulk_bytes > bulk_bytes_max)
    return {Code::too_large,
            fmt::format("frame: {} bytes of arrays, at most {} are taken", header.bulk_bytes, bulk_bytes_max),
            "the welcome frame announces the limits"};
  return {};
}

struct BulkChecksum::State {
  XXH3_state_t hash;
};

BulkChecksum::BulkChecksum() : state_(std::make_unique<State>()) { XXH3_64bits_reset(&state_->hash); }
BulkChecksum::~BulkChecksum() = default;

void BulkChecksum::add(std::span<const std::byte> bytes) {
  if (!bytes.empty()) XXH3_64bits_update(&state_->hash, bytes.data(), bytes.size());
}

std::uint64_t BulkChecksum::value() const { return XXH3_64bits_digest(&state_->hash); }

std::array<std::byte, 8> BulkChecksum::encode(std::uint64_t value) {
  std::array<std::byte, 8> bytes{};
  put(bytes.data(), value);
  return bytes;
}

std::uint64_t BulkChecksum::decode(std::span<const std::byte, 8> bytes) { return get<std::uint64_t>(bytes.data()); }

}  // namespace rcb::wire
