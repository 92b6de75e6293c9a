#include "common/wire/message.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <string>

#include <gtest/gtest.h>

#include "common/base/random.hpp"
#include "common/wire/limits.hpp"

namespace rcb::wire {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

Json parsed(std::string_view text) {
  auto json = parse_json(text);
  EXPECT_TRUE(json.ok()) << text << ": " << json.status().message();
  return json.ok() ? *json : Json::object();
}

Status specs_status(std::string_view text, std::uint64_t bulk_bytes) {
  return array_specs(parsed(text), bulk_bytes).status();
}

TEST(ParseJson, TakesAnObject) {
  const Json json = parsed(R"( {"a":[1,-2,2.5,true,null,"\u00e9",{"b":{}}],"n":18446744073709551615} )");
  EXPECT_EQ(json["a"].size(), 7U);
  EXPECT_EQ(json["a"][6]["b"], Json::object());
  EXPECT_EQ(json["n"].get<std::uint64_t>(), ~std::uint64_t{0});
  EXPECT_EQ(dump_json(parsed("{}")), "{}");
}

TEST(ParseJson, RefusesTheRest) {
  for (const char* text : {"",
                           " ",
                           "null",
                           "1",
                           "\"a\"",
                           "[]",
                           "[{}]",
                           "{",
                           "}",
                           "{}}",
                           "{} {}",
                           "{\"a\":}",
                           "{\"a\":1,}",
                           "{a:1}",
                           "{\"a\":1e999}",
                           "{\"a\":NaN}",
                           "{\"a\":Infinity}",
                           "{\"a\":01}",
                           "{\"a\":\"\xff\"}",
                           "{\"a\":\"\xc0\xaf\"}",
                           "{\"a\":\"\\ud800\"}",
                           "{\"a\":\"\n\"}",
                           "{\"a\":1,\"a\":2}",
                           "{\"b\":{\"a\":1,\"c\":2,\"a\":{}}}",
                           "\xef\xbb\xbf[]",
                           "{\"a\":1} // comment"}) {
    const auto json = parse_json(text);
    ASSERT_FALSE(json.ok()) << text;
    EXPECT_EQ(json.status().code(), Code::protocol_error);
    EXPECT_LT(json.status().message().size(), 300U);
  }
  EXPECT_NE(parse_json(R"({"a":1,"a":2})").status().message().find("'a' stands twice"), std::string::npos);
  EXPECT_FALSE(parse_json(std::string_view("{}\0", 3)).ok());
  EXPECT_FALSE(parse_json(std::string_view("{}\0}", 4)).ok());
}

TEST(ParseJson, DepthAndSizeAreBounded) {
  const auto nested = [](int depth) {  // depth objects and lists in all
    std::string text = "{\"a\":";
    for (int i = 1; i < depth; ++i) text += '[';
    for (int i = 1; i < depth; ++i) text += ']';
    return text + "}";
  };
  EXPECT_FALSE(parse_json(nested(1)).ok());  // no value
  EXPECT_TRUE(parse_json(nested(kJsonDepthMax)).ok());
  EXPECT_FALSE(parse_json(nested(kJsonDepthMax + 1)).ok());
  EXPECT_FALSE(parse_json("{\"a\":" + std::string(1000000, '[')).ok());
  std::string objects;
  for (int i = 0; i < 100000; ++i) objects += "{\"a\":";
  EXPECT_FALSE(parse_json(objects).ok());
  const std::string ten_bytes = R"({"a":"xx"})";
  EXPECT_TRUE(parse_json(ten_bytes, 10).ok());
  EXPECT_FALSE(parse_json(ten_bytes, 9).ok());
  EXPECT_FALSE(parse_json("{\"a\":\"" + std::string(kJsonBytesMax, 'x') + "\"}").ok());
}

TEST(DumpJson, NeverThrows) {
  EXPECT_EQ(dump_json(Json{{"path", "a\xff"}}), "{\"path\":\"a\xef\xbf\xbd\"}");
  EXPECT_EQ(dump_json(Json{{"x", std::nan("")}}), R"({"x":null})");
}

TEST(Arrays, DescriptionRoundTrip) {
  std::vector<Array> arrays(2);
  arrays[0] = {"x", "<f8", {2, 3}, Buffer<std::byte>(48)};
  arrays[1] = {"part", "<i4", {5}, Buffer<std::byte>(20)};
  const Json json = parsed(dump_json(Json{{"arrays", describe(arrays)}}));
  const auto specs = array_specs(json, 68);
  ASSERT_TRUE(specs.ok()) << specs.status().message();
  ASSERT_EQ(specs->size(), 2U);
  EXPECT_EQ(specs.value()[0].shape, (std::vector<std::uint64_t>{2, 3}));
  EXPECT_EQ(specs.value()[0].bytes, 48U);
  EXPECT_EQ(specs.value()[1].name, "part");
  EXPECT_EQ(specs.value()[1].dtype, "<i4");
  EXPECT_EQ(find_array(arrays, "part"), &arrays[1]);
  EXPECT_EQ(find_array(arrays, "id"), nullptr);
}

TEST(Arrays, NoneMeansNoBulk) {
  EXPECT_TRUE(specs_status("{}", 0).ok());
  EXPECT_TRUE(specs_status(R"({"arrays":[]})", 0).ok());
  EXPECT_FALSE(specs_status("{}", 1).ok());
  EXPECT_FALSE(specs_status(R"({"arrays":null})", 0).ok());
  EXPECT_TRUE(
      specs_status(R"({"arrays":[{"name":"x","dtype":"<f8","shape":[0,281474976710656,281474976710656]}]})", 0).ok());
}

TEST(Arrays, HostileDescriptions) {
  for (const char* shape :
       {"[-1]", "[-0]", "[1.0]", "[\"1\"]", "[null]", "[[1]]", "1", "[]", "null", "{}", "[281474976710657]",
        "[9223372036854775807]", "[18446744073709551615]", "[1,1,1,1,1,1,1,1,1]", "[281474976710656,281474976710656]",
        "[4294967296,536870912]", "[65536,65536,65536,65536]", "[2,-1,0]"}) {
    const std::string text = std::string(R"({"arrays":[{"name":"x","dtype":"<f8","shape":)") + shape + "}]}";
    for (const std::uint64_t bulk : {std::uint64_t{0}, std::uint64_t{8}, ~std::uint64_t{0}}) {
      const Status status = specs_status(text, bulk);
      EXPECT_EQ(status.code(), Code::protocol_error) << text << " with " << bulk;
    }
  }
  for (const char* entry :
       {"1", "[]", "null", R"({"dtype":"<f8","shape":[1]})", R"({"name":"","dtype":"<f8","shape":[1]})",
        R"({"name":1,"dtype":"<f8","shape":[1]})", R"({"name":"x","shape":[1]})",
        R"({"name":"x","dtype":">f8","shape":[1]})", R"({"name":"x","dtype":"<f2","shape":[4]})",
        R"({"name":"x","dtype":8,"shape":[1]})", R"({"name":"x","dtype":"<f8"})"})
    EXPECT_FALSE(specs_status(std::string("{\"arrays\":[") + entry + "]}", 8).ok()) << entry;
  const std::string one = R"({"name":"x","dtype":"<f8","shape":[1]})";
  EXPECT_TRUE(specs_status("{\"arrays\":[" + one + "]}", 8).ok());
  EXPECT_FALSE(specs_status("{\"arrays\":[" + one + "," + one + "]}", 16).ok()) << "a name twice";
  std::string many;  // each fits, together they are 2^64 bytes, which wraps to 0
  for (int i = 0; i < 2; ++i)
    many += (i == 0 ? "" : ",") + std::string("{\"name\":\"a") + std::to_string(i) +
            R"(","dtype":"<f8","shape":[281474976710656,4096]})";
  EXPECT_FALSE(specs_status("{\"arrays\":[" + many + "]}", 0).ok());
  std::string crowd;
  for (std::size_t i = 0; i <= kArraysMax; ++i)
    crowd += (i == 0 ? "" : ",") + std::string("{\"name\":\"a") + std::to_string(i) + R"(","dtype":"<f8","shape":[0]})";
  EXPECT_FALSE(specs_status("{\"arrays\":[" + crowd + "]}", 0).ok());
}

TEST(Failure, RoundTripForEveryCode) {
  for (std::uint16_t number = 1; number <= static_cast<std::uint16_t>(Code::usage); ++number) {
    const Status status(static_cast<Code>(number), "what was wrong", "what to do");
    if (code_name(status.code()) == "internal" && status.code() != Code::internal) continue;  // no longer used
    const Json json = parsed(dump_json(failure_json(status)));
    EXPECT_EQ(json["failure"]["exit"], exit_code(status.code()));
    const Status back = status_from_failure(json);
    EXPECT_EQ(back.code(), status.code());
    EXPECT_EQ(back.message(), "what was wrong");
    EXPECT_EQ(back.hint(), "what to do");
  }
}

TEST(Failure, HostileOnesAreStillFailures) {
  for (const char* text : {"{}", R"({"failure":1})", R"({"failure":{}})", R"({"failure":{"code":"ok","message":"m"}})",
                           R"({"failure":{"code":7,"message":[]}})", R"({"failure":{"code":"of_the_future"}})"}) {
    const Status status = status_from_failure(parsed(text));
    EXPECT_FALSE(status.ok()) << text;
    EXPECT_FALSE(status.message().empty()) << text;
  }
  EXPECT_FALSE(status_from_failure(Json(3)).ok());
  EXPECT_EQ(status_from_failure(parsed(R"({"failure":{"code":"of_the_future","message":"m"}})")).code(),
            Code::internal);
}

TEST(Fields, Integers) {
  const Json json = parsed(R"({"a":8,"b":8.0,"c":8.5,"d":"8","e":null,"f":-3,"g":18446744073709551615,"h":1e300,
                               "long":"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"})");
  EXPECT_EQ(integer_field(json, "a", 1, 8).value(), 8);
  EXPECT_EQ(integer_field(json, "b", 1, 8).value(), 8);
  EXPECT_EQ(integer_field(json, "f", -3, 8).value(), -3);
  EXPECT_EQ(integer_field(json, "a", 1, 7).status().message(), "field 'a': expected an integer of 1 to 7, got 8");
  EXPECT_EQ(integer_field(json, "d", 1, 1048576).status().message(),
            "field 'd': expected an integer of 1 to 1048576, got \"8\"");
  EXPECT_EQ(integer_field(json, "none", 0, 1).status().message(),
            "field 'none': expected an integer of 0 to 1, got nothing");
  EXPECT_LT(integer_field(json, "long", 0, 1).status().message().size(), 120U);
  for (const char* name : {"c", "e", "g", "h", "none"})
    EXPECT_EQ(
        integer_field(json, name, std::numeric_limits<std::int64_t>::min(), std::numeric_limits<std::int64_t>::max())
            .status()
            .code(),
        Code::invalid_argument)
        << name;
  EXPECT_EQ(integer_field_or(json, "e", 0, 9, 5).value(), 5);
  EXPECT_EQ(integer_field_or(json, "none", 0, 9, 5).value(), 5);
  EXPECT_FALSE(integer_field_or(json, "d", 0, 9, 5).ok());
  EXPECT_FALSE(integer_field(Json(3), "a", 0, 9).ok());
}

TEST(Fields, Numbers) {
  const Json json = parsed(R"({"a":0.5,"b":3,"c":"inf","d":"-inf","e":"0.5","f":[1,2.5,-3],"g":[1,"2"],"h":[]})");
  EXPECT_EQ(number_field_or(json, "a", 0, 1, 9).value(), 0.5);
  EXPECT_EQ(number_field_or(json, "b", 0, kInfinity, 9).value(), 3);
  EXPECT_EQ(number_field_or(json, "none", 0, 1, 9).value(), 9);
  EXPECT_EQ(number_field_or(json, "c", 0, kInfinity, 9, true).value(), kInfinity);
  EXPECT_FALSE(number_field_or(json, "c", 0, kInfinity, 9).ok());
  EXPECT_FALSE(number_field_or(json, "d", -kInfinity, kInfinity, 9, true).ok());
  EXPECT_EQ(number_field_or(json, "b", 0, 1, 9).status().message(), "field 'b': expected a number of 0 to 1, got 3");
  EXPECT_EQ(number_field_or(json, "e", 0, kInfinity, 9, true).status().message(),
            "field 'e': expected a number of at least 0 or \"inf\", got \"0.5\"");
  EXPECT_EQ(numbers_field_or_empty(json, "f", 3).value(), (std::vector<double>{1, 2.5, -3}));
  EXPECT_TRUE(numbers_field_or_empty(json, "h", 3).value().empty());
  EXPECT_TRUE(numbers_field_or_empty(json, "none", 3).value().empty());
  EXPECT_FALSE(numbers_field_or_empty(json, "f", 2).ok());
  EXPECT_FALSE(numbers_field_or_empty(json, "g", 3).ok());
  EXPECT_EQ(number_json(kInfinity), Json("inf"));
  EXPECT_EQ(number_json(-kInfinity), Json("-inf"));
  EXPECT_TRUE(number_json(std::nan("")).is_null());
  EXPECT_EQ(number_json(0.1).get<double>(), 0.1);
}

TEST(Fields, StringsAndBooleans) {
  const Json json = parsed(R"({"a":"text","b":"a\u0000b","c":true,"d":1})");
  EXPECT_EQ(string_field(json, "a").value(), "text");
  EXPECT_FALSE(string_field(json, "a", 3).ok());
  EXPECT_FALSE(string_field(json, "b").ok());
  EXPECT_FALSE(string_field(json, "c").ok());
  EXPECT_FALSE(string_field(json, "none").ok());
  EXPECT_TRUE(bool_field(json, "c").value());
  EXPECT_FALSE(bool_field(json, "none").value());
  EXPECT_FALSE(bool_field(json, "d").ok());
  EXPECT_TRUE(is_true(json, "c"));
  EXPECT_FALSE(is_true(json, "none"));
  EXPECT_FALSE(is_true(json, "d"));
}

TEST(Fields, SceneNames) {
  for (const char* name : {"a", "Jet-1.0_b", "..."}) EXPECT_TRUE(check_scene_name(name).ok()) << name;
  EXPECT_TRUE(check_scene_name(std::string(64, 'x')).ok());
  for (const std::string& name : {std::string(), std::string(65, 'x'), std::string("a b"), std::string("a/b"),
                                  std::string("\xc3\xa9"), std::string("a\0b", 3), std::string("\xff")})
    EXPECT_EQ(check_scene_name(name).code(), Code::invalid_argument) << name;
}

TEST(Hex, RoundTrip) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  for (int i = 0; i < 1000; ++i) {
    const std::uint64_t value = random.next() >> random.below(64);
    EXPECT_EQ(hex64(value).size(), 16U);
    EXPECT_EQ(parse_hex64(hex64(value)).value(), value);
  }
  EXPECT_EQ(hex64(0xAB), "00000000000000ab");
  EXPECT_EQ(parse_hex64("00000000000000AB").value(), 0xABU);
  for (const char* text : {"", "ab", "00000000000000ag", "+0000000000000ab", "00000000000000ab0", "0x000000000000ab"})
    EXPECT_FALSE(parse_hex64(text).ok()) << text;
}

}  // namespace
}  // namespace rcb::wire
