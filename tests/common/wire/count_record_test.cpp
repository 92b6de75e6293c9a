// The record of a count: its layout, what is refused of it, and that it is read whatever its bytes are.
#include "common/wire/count_record.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "common/wire/limits.hpp"

namespace rcb::wire {
namespace {

using Words = std::vector<std::uint64_t>;

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint64_t kHuge = ~std::uint64_t{0};

std::uint64_t bits(double value) { return std::bit_cast<std::uint64_t>(value); }

// Where the words of the head are; two words for each row follow, four where there are weights.
constexpr std::size_t says = 0, incarnation = 1, step = 2, epoch = 3, hash = 4, n = 5, inserted = 6, removed = 7,
                      id_sum = 8, drifted = 9, step_seconds = 10, scale = 11, least = 12, greatest = 13,
                      weights_as_zero = 14, rows = 15;

// Seven particles in parts 0 and 3.
const WeightCount kWeights{-60, 1, 5, 1, {(u128{2} << 64U) + 1, 3}};
const CountRecord kFull{12, 0xA5, 3, 0xFFFF, 7, 5, 4, 0x8000000000000001, 2, 0.5, {0, 3}, {5, 2}, kWeights};
const Words kFullWords{15,         0xA5,    12,      3, 0xFFFF, 7, 5, 4, 0x8000000000000001, 2, bits(0.5),  // always
                       kHuge - 59, bits(1), bits(5), 1,                    // of weights
                       0,          5,       1,       2, 3,      2, 3, 0};  // rows

std::string as_bytes(const Words& words) {
  return {reinterpret_cast<const char*>(words.data()), words.size() * sizeof(words[0])};
}

Result<CountRecord> decoded(const std::string& bytes) { return decode_count_record(std::as_bytes(std::span(bytes))); }

TEST(CountRecord, HasTheLayoutOfTheProtocol) {
  EXPECT_EQ(encode(kFull), as_bytes(kFullWords));
  EXPECT_EQ(encode({}), as_bytes(Words(rows)));
  EXPECT_EQ(count_record_bytes_most(2), encode(kFull).size());
}

TEST(CountRecord, IsReadAsItWasSent) {
  for (unsigned mask = 0; mask < 16; ++mask) {
    SCOPED_TRACE(mask);
    CountRecord sent = kFull;
    if ((mask & 1U) == 0) sent.id_sum.reset();
    if ((mask & 2U) == 0) sent.drifted.reset();
    if ((mask & 4U) == 0) sent.step_seconds.reset();
    if ((mask & 8U) == 0) sent.weights.reset();
    const auto record = decoded(encode(sent));
    ASSERT_TRUE(record.ok()) << record.status().message();
    EXPECT_EQ(encode(*record), encode(sent));
    EXPECT_EQ(record->weights.has_value(), sent.weights.has_value());
    EXPECT_TRUE(record->id_sum == sent.id_sum && record->drifted == sent.drifted && record->parts == sent.parts);
  }
}

// Words of the head that have these values instead.
Words changed(const std::vector<std::pair<std::size_t, std::uint64_t>>& changes) {
  Words words = kFullWords;
  for (const auto& [word, value] : changes) words.at(word) = value;
  return words;
}

TEST(CountRecord, ItsNumbersMayBeAsGreatAsTheyGet) {
  constexpr std::uint64_t kMost = kParticlesMax;
  for (const Words& words :
       {changed({{step, kStepMax}, {epoch, kIntegerMax}, {inserted, kMost}, {removed, kMost}}),
        changed({{n, kMost}, {rows + 1, kMost - 2}, {drifted, kMost}, {weights_as_zero, kMost}}),
        changed({{incarnation, kHuge}, {hash, kHuge}, {id_sum, kHuge}, {rows + 2, kHuge}, {rows + 3, kHuge}}),
        changed({{step, 0}, {step_seconds, bits(0)}, {scale, kWeightScaleMost}, {least, bits(0)}, {greatest, bits(0)}}),
        changed({{step_seconds, bits(1e308)}, {scale, -std::uint64_t{kWeightScaleMost}}, {greatest, bits(1e308)}}),
        changed({{rows, kPartsMax - 2}, {rows + 4, kPartsMax - 1}})}) {
    const auto record = decoded(as_bytes(words));
    ASSERT_TRUE(record.ok()) << record.status().message();
    EXPECT_EQ(encode(*record), as_bytes(words));
  }
  // What it doesn't say isn't looked at.
  Words none(rows, kHuge);
  for (const std::size_t word : {says, step, epoch, n, inserted, removed}) none[word] = 0;
  EXPECT_TRUE(decoded(as_bytes(none)).ok());
}

TEST(CountRecord, IsRefusedForWhatIsWrongWithIt) {
  constexpr std::uint64_t kTooMany = kParticlesMax + 1;
  const std::pair<std::string, Words> wrongs[] = {
      {"'says' has unknown bits: 1f", changed({{says, 31}})},
      {"'says' has unknown bits: 800000000000000f", changed({{says, kHuge / 2 + 16}})},
      {"'step' is", changed({{step, kStepMax + 1}})},
      {"'step' is", changed({{step, kHuge}})},
      {"'epoch' is", changed({{epoch, std::uint64_t{1} << 63U}})},
      {"'n' is", changed({{n, kTooMany}, {rows + 1, kTooMany - 2}})},
      {"'inserted' is", changed({{inserted, kTooMany}})},
      {"'removed' is", changed({{removed, kTooMany}})},
      {"8 of 7 particles drifted", changed({{drifted, 8}})},
      {"a step of -1 seconds", changed({{step_seconds, bits(-1)}})},
      {"a step of inf seconds", changed({{step_seconds, bits(kInf)}})},
      {"a step of nan seconds", changed({{step_seconds, bits(kNan)}})},
      {"a scale of 1301", changed({{scale, 1301}})},
      {"a scale of -1301", changed({{scale, kHuge - 1300}})},
      {"a scale of 4294967296", changed({{scale, std::uint64_t{1} << 32U}})},
      {"weights from -1 to 5", changed({{least, bits(-1)}})},
      {"weights from nan to 5", changed({{least, bits(kNan)}})},
      {"weights from 6 to 5", changed({{least, bits(6)}})},
      {"weights from 1 to nan", changed({{greatest, bits(kNan)}})},
      {"weights from 1 to inf", changed({{greatest, bits(kInf)}})},
      {"8 weights as zero of 7", changed({{weights_as_zero, 8}})},
      {"and n is 8", changed({{n, 8}})},
      {"part 0 after part 3", changed({{rows, 3}, {rows + 4, 0}})},
      {"part 3 after part 3", changed({{rows, 3}})},
      {"part 1048576 after part 0", changed({{rows + 4, 1 << 20}})},
      {"part 4294967297 after part 0", changed({{rows + 4, (std::uint64_t{1} << 32U) + 1}})},
      {"part 18446744073709551615 after part -1", changed({{rows, kHuge}})},
      {"no particles in part 3", changed({{rows + 1, 7}, {rows + 5, 0}})},
      {"n is 7", changed({{rows + 5, 3}})},
      {"n is 7", changed({{rows + 1, kHuge}, {rows + 5, 8}})},  // 7 but for the carry
      {"part 3 after part 3", changed({{says, 7}})},            // loads that are no weights' are rows
  };
  for (const auto& [message, words] : wrongs) {
    const Status status = decoded(as_bytes(words)).status();
    EXPECT_EQ(status.code(), Code::invalid_argument) << message;
    EXPECT_NE(status.message().find(message), std::string::npos) << status.message() << " for " << message;
  }
}

TEST(CountRecord, HasAHeadAndWholeRows) {
  for (const bool weighted : {false, true}) {
    CountRecord record = kFull;
    if (!weighted) record.weights.reset();
    const std::size_t whole = encode(record).size(), row = weighted ? 32 : 16;
    for (std::size_t size = 0; size < whole + row; ++size) {
      std::string bytes = encode(record);
      bytes.resize(size);
      const std::string message = decoded(bytes).status().message();
      const std::string expected = size < 120 ? fmt::format("a record of {} bytes, of which the head has 120", size)
                                   : (size - 120) % row > 0
                                       ? fmt::format("{} bytes after the head are not rows of {}", size - 120, row)
                                   : size < whole ? "and n is 7"
                                                  : "";
      EXPECT_NE(message.find(expected), std::string::npos) << message << " for " << expected;
    }
  }
}

void expect_sound(const CountRecord& record) {
  u128 sum = 0;
  for (const std::uint64_t count : record.counts) sum += count;
  EXPECT_EQ(sum, record.n);
  ASSERT_EQ(record.parts.size(), record.counts.size());
  for (std::size_t k = 0; k < record.parts.size(); ++k) {
    EXPECT_GT(record.counts[k], 0U);
    EXPECT_GT(record.parts[k], k == 0 ? -1 : record.parts[k - 1]);
    EXPECT_LT(record.parts[k], kPartsMax);
  }
  EXPECT_TRUE(record.step >= 0 && record.step <= kStepMax);
  for (const std::uint64_t particles : {record.n, record.inserted, record.removed})
    EXPECT_LE(particles, static_cast<std::uint64_t>(kParticlesMax));
  EXPECT_LE(record.drifted.value_or(0), record.n);
  const double seconds = record.step_seconds.value_or(0);
  EXPECT_TRUE(std::isfinite(seconds) && seconds >= 0);
  const WeightCount weights = record.weights.value_or(WeightCount{.loads = std::vector<u128>(record.parts.size())});
  EXPECT_EQ(weights.loads.size(), record.parts.size());
  EXPECT_LE(std::abs(weights.scale), kWeightScaleMost);
  EXPECT_TRUE(0 <= weights.least && weights.least <= weights.greatest && weights.greatest < kInf);
  EXPECT_LE(weights.as_zero, record.n);
}

TEST(CountRecord, IsReadWhateverItsBytesAre) {
  const Words odd{0, 1, 2, 5, 7, 13, kHuge, kHuge / 2, std::uint64_t{1} << 48U, bits(1), bits(kInf), bits(kNan)};
  int read = 0;
  for (std::uint64_t seed = 1; seed <= 20000 && !::testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    Random random(seed);
    Words words = kFullWords;
    for (std::uint64_t k = random.below(3); k > 0; --k)
      words[random.below(words.size())] = odd[random.below(odd.size())];
    std::string bytes = as_bytes(words);
    if (random.below(2) == 0) bytes[random.below(bytes.size())] = static_cast<char>(random.next());
    if (random.below(8) == 0) bytes.resize(random.below(2 * bytes.size()));
    const auto record = decoded(bytes);
    if (!record.ok()) {
      EXPECT_EQ(record.status().code(), Code::invalid_argument);
      continue;
    }
    ++read;
    expect_sound(*record);
    EXPECT_EQ(encode(*decoded(encode(*record))), encode(*record));
  }
  EXPECT_GT(read, 1000);
}

}  // namespace
}  // namespace rcb::wire
