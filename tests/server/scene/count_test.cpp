// Counts: what is read of them, what is refused, and that their loads are those of the positions.
#include "server/scene/count.hpp"

#include <functional>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/server/scene/counting.hpp"
#include "tests/support/scenes.hpp"
#include "tests/support/self_comm.hpp"

namespace rcb::testing {
namespace {

using scene::CountRecord;
using scene::loads_of;
using scene::read_count;
using wire::Json;

// Seven particles in parts 0 and 3, weights 1 to 5.
CountRequest good_request() {
  CountRequest request;
  request.json = {{"session", "run"},
                  {"step", 12},
                  {"incarnation", "00000000000000a5"},
                  {"epoch", 3},
                  {"hash", "000000000000ffff"},
                  {"n", 7},
                  {"id_sum", "8000000000000001"},
                  {"drifted", 2},
                  {"step_seconds", 0.5},
                  {"scale", 60},
                  {"least", 1},
                  {"greatest", 5},
                  {"weights_as_zero", 1}};
  request.arrays.push_back(array_of("part", "<i4", std::vector<std::int32_t>{0, 3}));
  request.arrays.push_back(array_of("count", "<u8", std::vector<std::uint64_t>{5, 2}));
  request.arrays.push_back(array_of("load", "<u8", std::vector<std::uint64_t>{1, 2, 3, 0}, 2));
  return request;
}

TEST(Count, IsReadAsItWasSent) {
  CountRequest request = good_request();
  const auto record = read_count(request.json, request.arrays);
  ASSERT_TRUE(record.ok()) << record.status().message();
  EXPECT_EQ(record->session, "run");
  EXPECT_EQ(record->step, 12);
  EXPECT_EQ(record->incarnation, 0xA5U);
  EXPECT_EQ(record->epoch, 3U);
  EXPECT_EQ(record->hash, 0xFFFFU);
  EXPECT_EQ(record->n, 7U);
  EXPECT_EQ(record->id_sum, 0x8000000000000001U);
  EXPECT_EQ(record->drifted, 2U);
  EXPECT_EQ(record->step_seconds, 0.5);
  EXPECT_EQ(record->parts, (std::vector<std::int32_t>{0, 3}));
  EXPECT_EQ(record->counts, (std::vector<std::uint64_t>{5, 2}));
  ASSERT_TRUE(record->weights.has_value());
  EXPECT_EQ(record->weights->scale, 60);
  EXPECT_EQ(record->weights->least, 1);
  EXPECT_EQ(record->weights->greatest, 5);
  EXPECT_EQ(record->weights->as_zero, 1U);
  EXPECT_EQ(record->weights->loads, (std::vector<u128>{(u128{2} << 64U) + 1, 3}));
  for (const char* name : {"id_sum", "drifted", "step_seconds", "scale"}) request.json[name] = nullptr;
  request.arrays.pop_back();
  const auto bare = read_count(request.json, request.arrays);
  ASSERT_TRUE(bare.ok()) << bare.status().message();
  EXPECT_FALSE(bare->id_sum || bare->drifted || bare->step_seconds || bare->weights);
}

TEST(Count, IsRefusedForWhatIsWrongWithIt) {
  struct Wrong {
    std::string message;  // contains this
    std::function<void(CountRequest&)> make;
  };
  const auto set = [](const char* name, const Json& value) {
    return [name, value](CountRequest& request) { request.json[name] = value; };
  };
  const auto parts = [](std::int32_t first, std::int32_t second) {
    return [=](CountRequest& request) {
      request.arrays[0] = array_of("part", "<i4", std::vector<std::int32_t>{first, second});
    };
  };
  const auto counts = [](std::vector<std::uint64_t> values) {
    return [=](CountRequest& request) { request.arrays[1] = array_of("count", "<u8", values); };
  };
  constexpr std::uint64_t kHuge = ~std::uint64_t{0};
  const Wrong wrongs[] = {
      {"'session'", set("session", 5)},
      {"'session'", set("session", std::string(65, 's'))},
      {"'step'", set("step", -1)},
      {"'epoch'", set("epoch", -1)},
      {"'n'", set("n", std::uint64_t{1} << 60U)},
      {"'drifted'", set("drifted", "2")},
      {"8 of 7 particles drifted", set("drifted", 8)},
      {"'step_seconds'", set("step_seconds", -1)},
      {"'step_seconds'", set("step_seconds", "inf")},
      {"'incarnation'", set("incarnation", nullptr)},
      {"'incarnation'", set("incarnation", "xyz")},
      {"'hash'", set("hash", 4)},
      {"'id_sum'", set("id_sum", 4)},
      {"'scale'", set("scale", 2000)},
      {"'least'", set("least", -1)},
      {"weights from 6 to 5", set("least", 6)},
      {"8 weights as zero of 7", set("weights_as_zero", 8)},
      {"and n is 8", set("n", 8)},
      {"part 0 after part 3", parts(3, 0)},
      {"part 3 after part 3", parts(3, 3)},
      {"part -1 after part -1", parts(-1, 3)},
      {"part 1048576 after part 0", parts(0, 1 << 20)},
      {"no particles in part 3", counts({7, 0})},
      {"n is 7", counts({5, 3})},
      {"n is 7", counts({kHuge, 8})},  // 7 but for the carry
      {"expected arrays", counts({5, 1, 1})},
      {"expected arrays", [](CountRequest& request) { request.arrays.pop_back(); }},
      {"expected arrays", [](CountRequest& request) { request.arrays.push_back(request.arrays[2]); }},
      {"expected arrays", [](CountRequest& request) { std::swap(request.arrays[0], request.arrays[1]); }},
      {"expected arrays", [](CountRequest& request) { request.arrays[0].dtype = "<i8"; }},
      {"expected arrays",
       [](CountRequest& request) {
         request.arrays[0].shape = {2, 1};
       }},
      {"expected arrays", set("scale", nullptr)},
      {"array 'load'", [](CountRequest& request) { request.arrays[2].name = "loads"; }},
      {"array 'load'", [](CountRequest& request) { request.arrays[2].shape = {4}; }},
      {"array 'load'",
       [](CountRequest& request) {
         request.arrays[2].shape = {1, 4};
       }},
      {"array 'load'",
       [](CountRequest& request) {
         request.arrays[2] = array_of("load", "<u8", std::vector<std::uint64_t>{1, 2}, 2);
       }},
  };
  for (const Wrong& wrong : wrongs) {
    CountRequest request = good_request();
    wrong.make(request);
    const auto record = read_count(request.json, request.arrays);
    EXPECT_EQ(record.status().code(), Code::invalid_argument) << wrong.message << request.json.dump();
    EXPECT_NE(record.status().message().find(wrong.message), std::string::npos)
        << record.status().message() << " for " << wrong.message;
  }
}

TEST(Count, OfNothingIsEmpty) {
  CountRequest request = good_request();
  request.json.update({{"n", 0}, {"drifted", 0}, {"weights_as_zero", 0}});
  request.arrays[0] = array_of("part", "<i4", std::vector<std::int32_t>());
  request.arrays[1] = array_of("count", "<u8", std::vector<std::uint64_t>());
  request.arrays[2] = array_of("load", "<u8", std::vector<std::uint64_t>(), 2);
  const auto record = read_count(request.json, request.arrays);
  ASSERT_TRUE(record.ok()) << record.status().message();
  const auto loads = loads_of(*record, 2, {});
  ASSERT_TRUE(loads.ok());
  EXPECT_EQ(loads->counts, (std::vector<std::uint64_t>{0, 0}));
  EXPECT_FALSE(loads->weighted);
}

TEST(Count, HasNoMoreLoadThanWeightsCanHave) {
  const auto loads = [](std::uint64_t first, std::uint64_t second) {
    CountRequest request = good_request();
    request.json["scale"] = ExactScale(5, 7).exponent();
    request.arrays[2] = array_of("load", "<u8", std::vector<std::uint64_t>{0, first, 0, second}, 2);
    return loads_of(*read_count(request.json, request.arrays), 4, {}).status().code();
  };
  constexpr std::uint64_t kHalf = std::uint64_t{1} << 62U;
  EXPECT_EQ(loads(kHalf, kHalf - 1), Code::ok);
  EXPECT_EQ(loads(kHalf, kHalf), Code::invalid_argument);
  EXPECT_EQ(loads(4 * kHalf - 1, kHalf), Code::invalid_argument);
}

TEST(Count, SurvivesWhatNobodySends) {
  const Json odd[] = {nullptr,
                      true,
                      -1,
                      0,
                      1e308,
                      1e-320,
                      "",
                      "inf",
                      "ffffffffffffffff",
                      Json::array(),
                      Json::object(),
                      5,
                      "run",
                      1.5,
                      60,
                      std::uint64_t{1} << 63U};
  std::uint64_t read = 0;
  for (std::uint64_t seed = 1; seed <= 20000; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    Random random(seed);
    CountRequest request = good_request();
    for (std::uint64_t k = 1 + random.below(2); k > 0; --k) {
      auto field = request.json.begin();
      std::advance(field, random.below(request.json.size()));
      wire::Array& array = request.arrays[random.below(request.arrays.size())];
      if (random.below(2) == 0)
        *field = odd[random.below(std::size(odd))];
      else if (random.below(2) == 0)
        array.bytes[random.below(array.bytes.size())] = static_cast<std::byte>(random.next());
      else
        array = request.arrays[random.below(request.arrays.size())];
    }
    const auto record = read_count(request.json, request.arrays);
    if (!record.ok()) {
      ASSERT_FALSE(record.status().message().empty());
      continue;
    }
    ++read;
    ASSERT_EQ(record->parts.size(), record->counts.size());
    ASSERT_LE(record->drifted.value_or(0), record->n);
    const auto loads = loads_of(*record, 4, {});
    if (!loads.ok()) continue;
    u128 sum = 0;
    for (const u128 load : loads->loads) sum += load;
    ASSERT_LT(sum, u128{1} << 127U);
  }
  EXPECT_GT(read, 1000U);
}

// The count of particles in random parts, of which each seat has a share; in the scale of the summary where that is
// due.
Result<CountRecord> counted(Random& random, const particles::ParticleView& particles,
                            std::span<const std::int32_t> part, std::size_t seats,
                            const std::function<void(std::size_t, CountRequest&)>& change = {}) {
  scene::Tally tally(1, seats);
  const int scale = scale_needed(particles).value_or(0);
  for (std::size_t seat = 0, first = 0; seat < seats; ++seat) {
    EXPECT_FALSE(tally.whole());
    const std::size_t last = seat + 1 == seats ? particles.count : first + random.below(particles.count - first + 1);
    CountRequest request = count_rows(particles, part, std::exchange(first, last), last, scale);
    request.json.update(
        {{"session", "run"}, {"step", 1}, {"epoch", 1}, {"hash", wire::hex64(1)}, {"incarnation", wire::hex64(1)}});
    if (change) change(seat, request);
    auto record = read_count(request.json, request.arrays);
    if (!record.ok()) return record.status();
    tally.put(seat, *record);
  }
  EXPECT_TRUE(tally.whole());
  return tally.sum(4);
}

TEST(Count, GivesTheLoadsOfThePositionsHoweverManySeatsCount) {
  SelfComm comm;
  for (std::uint64_t seed = 1; seed <= 800; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    Random random(seed);
    const Scene scene = make_scene(Shape::uniform, static_cast<Weights>(seed % kWeights), 1, random.below(200),
                                   random.below(2) == 0, seed);
    const Share share = deal(scene, 0, 1, seed);
    const auto view = share.particles.view();
    const int parts = 1 + static_cast<int>(random.below(9));
    std::vector<double> sizes;
    for (int p = 0; p < parts && seed % 3 == 0; ++p) sizes.push_back(random.uniform(0.1, 4));
    std::vector<std::int32_t> part(view.count);
    for (std::int32_t& p : part) p = static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(parts)));
    const auto record = counted(random, view, part, 1 + random.below(5));
    ASSERT_TRUE(record.ok()) << record.status().message();
    const auto loads = loads_of(*record, parts, sizes);
    ASSERT_TRUE(loads.ok()) << loads.status().message();
    const auto expected = partition::summarise_loads(comm, view, part, sizes, parts);
    EXPECT_EQ(loads->counts, expected.counts);
    EXPECT_EQ(loads->loads, expected.loads);
    EXPECT_EQ(loads->weighted, expected.weighted);
    EXPECT_EQ(loads->scale_exponent, expected.scale_exponent);
    EXPECT_EQ(loads->weights_as_zero, expected.weights_as_zero);
    EXPECT_EQ(loads->error, expected.error);
    EXPECT_EQ(loads->imbalance, expected.imbalance);
    EXPECT_EQ(loads->part_errors, expected.part_errors);
    EXPECT_EQ(loads->targets, expected.targets);
    EXPECT_EQ(loads->load_values, expected.load_values);
    std::uint64_t id_sum = 0;
    for (std::size_t i = 0; i < view.count; ++i) id_sum += mix64(static_cast<std::uint64_t>(view.id[i]));
    EXPECT_EQ(record->id_sum, id_sum);
    EXPECT_EQ(record->n, view.count);
  }
}

TEST(Count, StrangersAreInPartsOfOtherSeats) {
  const auto strangers = [](int parts, const std::vector<std::vector<std::uint64_t>>& by_seat) {
    scene::Tally tally(1, by_seat.size());
    for (std::size_t seat = 0; seat < by_seat.size(); ++seat) {
      scene::CountRecord record;
      record.id_sum = 0;
      for (std::size_t p = 0; p < by_seat[seat].size(); ++p) {
        record.parts.push_back(static_cast<std::int32_t>(p));
        record.counts.push_back(by_seat[seat][p]);
        record.n += by_seat[seat][p];
      }
      tally.put(seat, record);
    }
    return tally.sum(parts)->strangers;
  };
  EXPECT_EQ(strangers(5, {{1, 2, 4, 8, 16}}), 0U);
  EXPECT_EQ(strangers(5, {{1, 2, 4, 8, 16}, {32, 64, 128, 256, 512}}), 4U + 8 + 16 + 32 + 64);  // parts 0 1, 2 3 4
  EXPECT_EQ(strangers(5, {{1, 2}, {4, 8}, {0, 0, 0, 16}}), 2U + 4);                             // 0, 1 2, 3 4
  EXPECT_EQ(strangers(1, {{1}, {2}, {4}}), 3U);                                                 // none, none, 0
}

TEST(Count, OfSeatsThatDisagreeIsOfNoUse) {
  Random random(7);
  const Share share = deal(make_scene(Shape::uniform, Weights::wide, 2, 400, false, 7), 0, 1, 7);
  const auto view = share.particles.view();
  const std::vector<std::int32_t> part(view.count, 2);
  const auto of_two = [](const char* name, const Json& value) {
    return [=](std::size_t seat, CountRequest& request) {
      if (seat == 2) request.json[name] = value;
    };
  };
  const auto epoch = [&](const auto& change) { return counted(random, view, part, 3, change)->epoch; };
  EXPECT_EQ(epoch([](std::size_t, CountRequest&) {}), 1U);
  EXPECT_EQ(epoch(of_two("hash", wire::hex64(2))), 0U);
  EXPECT_EQ(epoch(of_two("epoch", 2)), 0U);
  const auto scales = counted(random, view, part, 3, of_two("scale", -3));
  EXPECT_NE(scales->weights->scale, scene::scale_due(*scales->weights, scales->n));
  EXPECT_EQ(counted(random, view, part, 3, of_two("id_sum", nullptr)).status().code(), Code::invalid_argument);
  const auto mixed = counted(random, view, part, 3, [](std::size_t seat, CountRequest& request) {
    if (seat != 1) return;
    request.json["scale"] = nullptr;
    request.arrays.pop_back();
  });
  EXPECT_EQ(mixed.status().message(), "the count of seat 1: it has no weights");
}

}  // namespace
}  // namespace rcb::testing
