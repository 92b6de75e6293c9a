// Typed reading of a message's fields. Errors name the field, what was expected and what was found.
#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "common/wire/field_reader.hpp"
#include "common/wire/message.hpp"

namespace rcb::wire {
namespace {

// The field; nullptr if it is absent or null, or if `json` is not an object.
const Json* field(const Json& json, const char* name) {
  const auto found = json.find(name);
  return found == json.end() || found->is_null() ? nullptr : &*found;
}

// A short description of the value for an error message; at most about one line.
std::string shown(const Json& value) {
  constexpr std::size_t kShownMax = 40;
  if (value.is_structured()) return value.is_array() ? "a list" : "an object";
  std::string text = dump_json(value);
  if (text.size() <= kShownMax) return text;
  std::size_t end = kShownMax;  // don't split a UTF-8 character
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U) --end;
  return text.substr(0, end) + "...";
}

Status unexpected(const char* name, const std::string& expected, const Json* value) {
  return {Code::invalid_argument,
          fmt::format("field '{}': expected {}, got {}", name, expected, value == nullptr ? "nothing" : shown(*value))};
}

// Some languages write all numbers as doubles, so 8.0 counts as the integer 8.
bool as_integer(const Json& value, std::int64_t& out) {
  if (value.is_number_unsigned()) {
    const auto number = value.get<std::uint64_t>();
    if (number > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) return false;
    out = static_cast<std::int64_t>(number);
    return true;
  }
  if (value.is_number_integer()) {
    out = value.get<std::int64_t>();
    return true;
  }
  if (!value.is_number_float()) return false;
  const auto number = value.get<double>();
  constexpr double kExactMax = 9007199254740992.0;  // 2^53: a larger double may stand for several integers
  if (!(std::abs(number) <= kExactMax) || std::trunc(number) != number) return false;
  out = static_cast<std::int64_t>(number);
  return true;
}

}  // namespace

Result<std::int64_t> integer_field(const Json& json, const char* name, std::int64_t low, std::int64_t high) {
  const Json* value = field(json, name);
  std::int64_t number = 0;
  if (value == nullptr || !as_integer(*value, number) || number < low || number > high)
    return unexpected(name, fmt::format("an integer of {} to {}", low, high), value);
  return number;
}

Result<std::int64_t> integer_field_or(const Json& json, const char* name, std::int64_t low, std::int64_t high,
                                      std::int64_t otherwise) {
  if (field(json, name) == nullptr) return otherwise;
  return integer_field(json, name, low, high);
}

Result<double> number_field_or(const Json& json, const char* name, double low, double high, double otherwise,
                               bool infinity_allowed) {
  const Json* value = field(json, name);
  if (value == nullptr) return otherwise;
  if (infinity_allowed && value->is_string() && value->get_ref<const std::string&>() == "inf")
    return std::numeric_limits<double>::infinity();
  const double number = value->is_number() ? value->get<double>() : std::numeric_limits<double>::quiet_NaN();
  if (!(std::isfinite(number) && number >= low && number <= high)) {
    const std::string range = std::isfinite(high) && high < std::numeric_limits<double>::max()
                                  ? fmt::format("a number of {} to {}", low, high)
                                  : fmt::format("a number of at least {}", low);
    return unexpected(name, infinity_allowed ? range + " or \"inf\"" : range, value);
  }
  return number;
}

Result<std::string> string_field(const Json& json, const char* name, std::size_t length_max) {
  const Json* value = field(json, name);
  if (value == nullptr || !value->is_string())
    return unexpected(name, fmt::format("a string of at most {} bytes", length_max), value);
  const auto& text = value->get_ref<const std::string&>();
  if (text.size() > length_max)
    return Status(Code::invalid_argument,
                  fmt::format("field '{}': {} bytes, at most {} are taken", name, text.size(), length_max));
  if (text.find('\0') != std::string::npos)
    return Status(Code::invalid_argument, fmt::format("field '{}': a null character inside", name));
  return text;
}

Result<bool> bool_field(const Json& json, const char* name) {
  const Json* value = field(json, name);
  if (value == nullptr) return false;
  if (!value->is_boolean()) return unexpected(name, "true or false", value);
  return value->get<bool>();
}

bool is_true(const Json& json, const char* name) {
  const Json* value = field(json, name);
  return value != nullptr && value->is_boolean() && value->get<bool>();
}

Result<std::vector<double>> numbers_field_or_empty(const Json& json, const char* name, std::size_t count_max) {
  const Json* value = field(json, name);
  if (value == nullptr) return std::vector<double>{};
  if (!value->is_array() || value->size() > count_max)
    return unexpected(name, fmt::format("a list of at most {} numbers", count_max), value);
  std::vector<double> numbers;
  numbers.reserve(value->size());
  for (const Json& entry : *value) {
    if (!entry.is_number() || !std::isfinite(entry.get<double>()))
      return Status(Code::invalid_argument,
                    fmt::format("field '{}': entry {}: expected a finite number, got {}{}", name, numbers.size(),
                                shown(entry), entry.is_null() ? ", as JSON writes NaN and infinity" : ""));
    numbers.push_back(entry.get<double>());
  }
  return numbers;
}

Result<std::vector<std::string>> strings_field_or_empty(const Json& json, const char* name, std::size_t count_max) {
  const Json* value = field(json, name);
  if (value == nullptr) return std::vector<std::string>{};
  const auto good = [](const Json& entry) {
    return entry.is_string() && entry.get_ref<const std::string&>().find('\0') == std::string::npos;
  };
  if (!value->is_array() || value->size() > count_max || !std::all_of(value->begin(), value->end(), good))
    return unexpected(name, fmt::format("a list of at most {} strings", count_max), value);
  return value->get<std::vector<std::string>>();
}

bool FieldReader::has(const char* name) const { return field(json_, name) != nullptr; }

std::string FieldReader::word(const char* name, std::initializer_list<const char*> words) {
  std::string found = text_or(name, 16, *words.begin());
  std::string expected;
  for (const char* const* word = words.begin(); word != words.end(); ++word) {
    if (found == *word) return found;
    expected += fmt::format("{}\"{}\"", word == words.begin() ? "" : word + 1 == words.end() ? " or " : ", ", *word);
  }
  fail({Code::invalid_argument, fmt::format("field '{}': expected {}, got \"{}\"", name, expected, found)});
  return *words.begin();
}

Status check_scene_name(const std::string& name) {
  const auto allowed = [](char c) {
    return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
           c == '-';
  };
  if (!name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), allowed)) return {};
  return {Code::invalid_argument, fmt::format("scene name {} is not allowed", shown(name)),
          "a scene's name is 1 to 64 of A-Z a-z 0-9 . _ -"};
}

Json number_json(double value) {
  if (std::isnan(value)) return nullptr;
  if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
  return value;
}

}  // namespace rcb::wire
