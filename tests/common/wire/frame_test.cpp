#include "common/wire/frame.hpp"

#include <algorithm>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "common/wire/limits.hpp"
#include "common/wire/message.hpp"

namespace rcb::wire {
namespace {

std::span<const std::byte, kHeaderBytes> header_of(const std::string& frame) {
  return std::span<const std::byte, kHeaderBytes>(reinterpret_cast<const std::byte*>(frame.data()), kHeaderBytes);
}

std::string hex(std::string_view bytes) {
  std::string text;
  for (const char c : bytes) {
    constexpr std::string_view kDigits = "0123456789abcdef";
    text += kDigits[static_cast<unsigned char>(c) >> 4U];
    text += kDigits[static_cast<unsigned char>(c) & 15U];
  }
  return text;
}

// What a receiver does with the first bytes of a stream; ok only for a whole, sound frame.
Status receive(const std::string& bytes) {
  if (bytes.size() < kHeaderBytes) return {Code::protocol_error, "short"};
  const auto header = decode_header(header_of(bytes));
  if (!header) return header.status();
  if (Status status = check_lengths(*header, kJsonBytesMax, 1U << 16U); !status) return status;
  const std::uint64_t tail = (header->flags & kFlagBulkChecksum) != 0 ? 8 : 0;
  if (bytes.size() != kHeaderBytes + header->json_bytes + header->bulk_bytes + tail)
    return {Code::protocol_error, "length"};
  const std::string_view json = std::string_view(bytes).substr(kHeaderBytes, header->json_bytes);
  if (Status status = verify_checksum(header_of(bytes), json); !status) return status;
  const auto parsed = parse_json(json);
  if (!parsed) return parsed.status();
  const auto specs = array_specs(*parsed, header->bulk_bytes);
  return specs.status();
}

TEST(Frame, RoundTrip) {
  FrameHeader header;
  header.type = FrameType::reply;
  header.flags = kFlagBulkChecksum | 0x80000000U;
  header.request = 0xFEDCBA9876543210U;
  header.bulk_bytes = 0x0123456789ABCDEFU;
  const std::string frame = encode_frame(header, R"({"a":1})");
  const auto decoded = decode_header(header_of(frame));
  ASSERT_TRUE(decoded.ok()) << decoded.status().message();
  EXPECT_EQ(decoded->type, FrameType::reply);
  EXPECT_EQ(decoded->flags, header.flags);
  EXPECT_EQ(decoded->json_bytes, 7U);
  EXPECT_EQ(decoded->request, header.request);
  EXPECT_EQ(decoded->bulk_bytes, header.bulk_bytes);
  EXPECT_TRUE(verify_checksum(header_of(frame), R"({"a":1})").ok());
  EXPECT_EQ(verify_checksum(header_of(frame), R"({"a":2})").code(), Code::protocol_error);
}

// The worked example of PROTOCOL.md, byte for byte; its checksum was computed outside this code.
TEST(Frame, GoldenBytes) {
  FrameHeader header;
  header.type = FrameType::request;
  header.request = 1;
  EXPECT_EQ(hex(encode_frame(header, R"({"command":"status"})")),
            "52434244"                                    // RCBD
            "0200"                                        // version 2
            "0300"                                        // request
            "00000000"                                    // flags
            "14000000"                                    // 20 bytes of JSON
            "0100000000000000"                            // request 1
            "0000000000000000"                            // no arrays
            "aec032e00578f745"                            // XXH3-64
            "7b22636f6d6d616e64223a22737461747573227d");  // the JSON
}

TEST(Frame, EveryBitOfHeaderAndJsonIsCovered) {
  FrameHeader header;
  header.bulk_bytes = 16;
  std::string frame = encode_frame(header, R"({"arrays":[{"name":"x","dtype":"<f8","shape":[2]}]})");
  const std::size_t covered = frame.size();
  frame.append(16, '\7');
  ASSERT_TRUE(receive(frame).ok()) << receive(frame).message();
  for (std::size_t bit = 0; bit < covered * 8; ++bit) {
    std::string damaged = frame;
    damaged[bit / 8] = static_cast<char>(damaged[bit / 8] ^ (1 << (bit % 8)));
    EXPECT_FALSE(receive(damaged).ok()) << "bit " << bit;
  }
}

TEST(Frame, EveryTruncationIsRefused) {
  FrameHeader header;
  header.bulk_bytes = 8;
  std::string frame = encode_frame(header, R"({"arrays":[{"name":"x","dtype":"<i8","shape":[1]}]})") + "12345678";
  ASSERT_TRUE(receive(frame).ok());
  for (std::size_t size = 0; size < frame.size(); ++size) EXPECT_FALSE(receive(frame.substr(0, size)).ok()) << size;
}

TEST(Frame, WrongMagicVersionTypeAndLengthsAreNamed) {
  const std::string frame = encode_frame({}, "{}");
  const auto changed = [&](std::size_t offset, char value) {
    std::string damaged = frame;
    damaged[offset] = value;
    return decode_header(header_of(damaged)).status();
  };
  EXPECT_EQ(changed(0, 'X').code(), Code::protocol_error);
  EXPECT_NE(changed(4, 1).message().find("version 1, expected 2"), std::string::npos);
  EXPECT_NE(changed(6, 0).message().find("type 0"), std::string::npos);
  EXPECT_NE(changed(6, 8).message().find("type 8"), std::string::npos);
  FrameHeader header;
  header.json_bytes = 11;
  EXPECT_EQ(check_lengths(header, 10, 0).code(), Code::too_large);
  header.json_bytes = 10;
  EXPECT_TRUE(check_lengths(header, 10, 0).ok());
  header.bulk_bytes = ~std::uint64_t{0};
  EXPECT_EQ(check_lengths(header, 10, 1U << 30U).code(), Code::too_large);
}

TEST(Frame, RandomBytesNeverCrash) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  for (int round = 0; round < 20000; ++round) {
    std::string bytes(random.below(120), '\0');
    for (char& c : bytes) c = static_cast<char>(random.below(256));
    // Half of them get past the first checks.
    if (round % 2 == 0 && bytes.size() >= 8) std::memcpy(bytes.data(), "RCBD\1\0\3\0", 8);
    EXPECT_FALSE(receive(bytes).ok());
  }
}

// Damaged JSON under a right checksum: what a hostile client sends.
TEST(Frame, MutatedFramesAlwaysGiveAStatus) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  const std::string json =
      R"({"command":"push","scene":"jet","n":3,)"
      R"("arrays":[{"name":"x","dtype":"<f8","shape":[3]},{"name":"id","dtype":"<i8","shape":[3]}]})";
  constexpr std::string_view kAlphabet = "{}[]\":,0123456789-+.eE\\u\x80\xff\n nulltruefalse";
  for (int round = 0; round < 20000; ++round) {
    std::string damaged = json;
    for (std::uint64_t edits = random.below(6); edits > 0; --edits) {
      const std::size_t at = random.below(damaged.size());
      switch (random.below(3)) {
        case 0:
          damaged[at] = kAlphabet[random.below(kAlphabet.size())];
          break;
        case 1:
          damaged.insert(at, damaged.substr(random.below(damaged.size()), random.below(20)));
          break;
        default:
          damaged.erase(at, random.below(8));
          break;
      }
      if (damaged.empty()) damaged = " ";
    }
    FrameHeader header;
    header.bulk_bytes = 48;
    const std::string frame = encode_frame(header, damaged) + std::string(48, '\1');
    const Status status = receive(frame);
    if (!status.ok()) {
      EXPECT_FALSE(status.message().empty());
      continue;
    }
    const auto parsed = parse_json(damaged);
    EXPECT_TRUE(parsed->is_object());
    static_cast<void>(integer_field(*parsed, "count", 0, 100));
    static_cast<void>(string_field(*parsed, "scene"));
    static_cast<void>(number_field_or(*parsed, "plan", 0, 1, 0));
    static_cast<void>(numbers_field_or_empty(*parsed, "arrays", 2));
    static_cast<void>(status_from_failure(*parsed));
    EXPECT_TRUE(parse_json(dump_json(*parsed)).ok());
  }
}

TEST(Frame, BulkChecksumInPieces) {
  const std::uint64_t seed = 7;
  Random random(seed);
  std::vector<std::byte> bulk(100000);
  for (std::byte& b : bulk) b = static_cast<std::byte>(random.below(256));
  BulkChecksum whole;
  whole.add(bulk);
  BulkChecksum pieces;
  for (std::size_t at = 0; at < bulk.size();) {
    const std::size_t size = std::min<std::size_t>(random.below(5000), bulk.size() - at);
    pieces.add(std::span(bulk).subspan(at, size));
    at += size;
  }
  EXPECT_EQ(whole.value(), pieces.value());
  EXPECT_EQ(BulkChecksum::decode(BulkChecksum::encode(0x0102030405060708U)), 0x0102030405060708U);
  EXPECT_EQ(BulkChecksum::encode(0x0102030405060708U)[0], std::byte{8});
  EXPECT_EQ(BulkChecksum().value(), 0x2D06800538D394C2U) << "XXH3-64 of nothing";
}

}  // namespace
}  // namespace rcb::wire
