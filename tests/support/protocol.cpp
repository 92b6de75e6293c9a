#include "tests/support/protocol.hpp"

#include <map>
#include <set>
#include <stdexcept>
#include <string_view>

#include <fmt/format.h>
#include <xxhash.h>

namespace rcb::testing::protocol {
namespace {

constexpr std::size_t kHeaderBytes = 40;
constexpr std::size_t kSummedBytes = 32;  // of the header

const std::map<std::string, std::uint64_t> kDtypes{{"<f8", 8}, {"<f4", 4}, {"<i8", 8}, {"<i4", 4}, {"<u8", 8}};

const std::map<int, const char*> kCodes{
    {1, "invalid_argument"}, {2, "not_found"},    {3, "already_exists"},     {4, "busy"},
    {6, "stale_step"},       {8, "not_finite"},   {9, "protocol_error"},     {10, "too_large"},
    {11, "not_authorised"},  {12, "unavailable"}, {13, "deadline_exceeded"}, {14, "aborted"},
    {15, "io_error"},        {16, "unsupported"}, {17, "internal"},          {20, "not_conserved"},
    {21, "duplicate_id"}};
const std::map<std::string, int> kExits{{"unavailable", 3}, {"not_authorised", 4}, {"deadline_exceeded", 5}};  // else 1

void need(bool holds, const std::string& what) {
  if (!holds) throw std::runtime_error("a frame that breaks the protocol: " + what);
}

std::string little_endian(std::uint64_t value, int bytes) {
  std::string out;
  for (int i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i) & 0xFF);
  return out;
}

std::uint64_t number_at(std::string_view bytes, std::size_t offset, std::size_t width) {
  std::uint64_t value = 0;
  for (std::size_t i = width; i-- > 0;) value = value << 8U | static_cast<unsigned char>(bytes[offset + i]);
  return value;
}

std::uint64_t xxh3(const std::string& bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

Json parse(const std::string& text) {
  std::map<int, std::set<std::string>> keys;  // by depth
  bool twice = false;
  Json json = Json::parse(
      text,
      [&](int depth, Json::parse_event_t event, Json& key) {
        if (event == Json::parse_event_t::object_start) keys[depth + 1].clear();
        if (event == Json::parse_event_t::key) twice = !keys[depth].insert(key.get<std::string>()).second || twice;
        return true;
      },
      false);
  need(json.is_object() && !twice && text.find('\0') == std::string::npos, text);
  return json;
}

std::vector<Array> arrays_of(const Json& json, const std::string& bulk) {
  std::vector<Array> arrays;
  std::set<std::string> names;
  std::size_t at = 0;
  for (const Json& entry : json.value("arrays", Json::array())) {
    Array array{entry.at("name"), entry.at("dtype"), entry.at("shape"), {}};
    need(names.insert(array.name).second && !array.name.empty() && array.name.size() <= 64, json.dump());
    need(!array.shape.empty() && array.shape.size() <= 8 && kDtypes.contains(array.dtype), json.dump());
    std::uint64_t bytes = kDtypes.at(array.dtype);
    for (const std::uint64_t length : array.shape) bytes *= length;
    need(bytes <= bulk.size() - at, "less bulk than arrays in " + json.dump());
    array.bytes = bulk.substr(at, bytes);
    at += bytes;
    arrays.push_back(std::move(array));
  }
  need(arrays.size() <= 16 && at == bulk.size(), "more arrays, or more bulk than arrays, in " + json.dump());
  return arrays;
}

}  // namespace

std::string head(FrameType type, std::uint64_t request, const std::string& json, std::uint64_t bulk_bytes,
                 bool summed) {
  const std::string header = "RCBD" + little_endian(2, 2) + little_endian(static_cast<std::uint16_t>(type), 2) +
                             little_endian(summed ? 1 : 0, 4) + little_endian(json.size(), 4) +
                             little_endian(request, 8) + little_endian(bulk_bytes, 8);
  return header + little_endian(xxh3(header + json), 8) + json;
}

std::string frame(FrameType type, std::uint64_t request, Json json, const std::vector<Array>& arrays, bool summed) {
  std::string bulk;
  for (const Array& array : arrays) {
    json["arrays"].push_back({{"name", array.name}, {"dtype", array.dtype}, {"shape", array.shape}});
    bulk += array.bytes;
  }
  return head(type, request, json.dump(), bulk.size(), summed) + bulk + (summed ? little_endian(xxh3(bulk), 8) : "");
}

std::optional<Frame> receive(const std::function<bool(char* to, std::size_t size)>& read) {
  std::string header(kHeaderBytes, '\0');
  if (!read(header.data(), header.size())) return std::nullopt;
  const std::uint64_t type = number_at(header, 6, 2), flags = number_at(header, 8, 4);
  need(header.starts_with("RCBD") && number_at(header, 4, 2) == 2 && type >= 1 && type <= 7 && flags <= 1,
       "its header");
  std::string text(number_at(header, 12, 4), '\0');
  if (!read(text.data(), text.size())) return std::nullopt;
  need(number_at(header, kSummedBytes, 8) == xxh3(header.substr(0, kSummedBytes) + text), "the checksum of " + text);
  std::string bulk(number_at(header, 24, 8), '\0'), sum(flags == 1 ? 8 : 0, '\0');
  if (!read(bulk.data(), bulk.size()) || !read(sum.data(), sum.size())) return std::nullopt;
  need(flags == 0 || sum == little_endian(xxh3(bulk), 8), "the checksum of the bulk of " + text);
  Frame out{static_cast<FrameType>(type), number_at(header, 16, 8), parse(text), {}, {}};
  need(out.request != 0 || out.type == FrameType::goodbye, "request 0 of " + text);
  if (out.json.value("command", "") == "count")
    out.record = std::move(bulk);
  else
    out.arrays = arrays_of(out.json, bulk);
  return out;
}

Json failure_json(const Status& status) {
  const std::string code = kCodes.at(static_cast<int>(status.code()));
  const auto exit = kExits.find(code);
  return {{"failure",
           {{"code", code},
            {"message", status.message()},
            {"hint", status.hint()},
            {"exit", exit == kExits.end() ? 1 : exit->second}}}};
}

std::string hex64(std::uint64_t value) { return fmt::format("{:016x}", value); }

bool is_hex64(const Json& json) {
  const auto text = json.get<std::string>();
  return text.size() == 16 && text.find_first_not_of("0123456789abcdefABCDEF") == std::string::npos;
}

}  // namespace rcb::testing::protocol
