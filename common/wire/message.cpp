#include "common/wire/message.hpp"

#include <algorithm>
#include <set>

#include <fmt/format.h>

#include "common/base/text.hpp"
#include "common/wire/limits.hpp"

namespace rcb::wire {
namespace {

Status bad_array(std::size_t index, const std::string& what) {
  return {Code::protocol_error, fmt::format("arrays[{}]: {}", index, what),
          R"(an entry is {"name":"x","dtype":"<f8","shape":[n]})"};
}

// The text of a string field of a JSON object; nullptr if it is absent or not a string.
const std::string* text_of(const Json& entry, const char* name) {
  const auto found = entry.find(name);
  return found == entry.end() ? nullptr : found->get_ptr<const std::string*>();
}

Result<ArraySpec> array_spec(const Json& entry, std::size_t index) {
  if (!entry.is_object()) return bad_array(index, "not an object");
  const std::string* name = text_of(entry, "name");
  if (name == nullptr || name->empty() || name->size() > kArrayNameMax)
    return bad_array(index, fmt::format("'name' must be a string of 1 to {} bytes", kArrayNameMax));
  const std::string* dtype = text_of(entry, "dtype");
  if (dtype == nullptr || dtype_bytes(*dtype) == 0)
    return bad_array(index, "'dtype' must be <f8, <f4, <i8, <i4 or <u8");
  const auto shape = entry.find("shape");
  if (shape == entry.end() || !shape->is_array() || shape->empty() || shape->size() > kArrayDimensionsMax)
    return bad_array(index, fmt::format("'shape' must be a list of 1 to {} lengths", kArrayDimensionsMax));
  ArraySpec spec{*name, *dtype, {}, dtype_bytes(*dtype)};
  bool none = false;
  for (const Json& length : *shape) {
    if (!length.is_number_unsigned() || length.get<std::uint64_t>() > static_cast<std::uint64_t>(kParticlesMax))
      return bad_array(index, fmt::format("a length in 'shape' must be an integer of 0 to {}", kParticlesMax));
    spec.shape.push_back(length.get<std::uint64_t>());
    none = none || spec.shape.back() == 0;
  }
  // An array with a zero length has no bytes, even if the product of its other lengths overflows.
  if (none) spec.bytes = 0;
  for (const std::uint64_t length : spec.shape)
    if (!none && __builtin_mul_overflow(spec.bytes, length, &spec.bytes))
      return bad_array(index, "'shape' has more bytes than 64 bits can count");
  return spec;
}

}  // namespace

std::size_t dtype_bytes(std::string_view dtype) {
  if (dtype == "<f8" || dtype == "<i8" || dtype == "<u8") return 8;
  return dtype == "<i4" || dtype == "<f4" ? 4 : 0;
}

Result<std::vector<ArraySpec>> array_specs(const Json& json, std::uint64_t bulk_bytes) {
  std::vector<ArraySpec> specs;
  std::uint64_t sum = 0;
  const auto arrays = json.find("arrays");
  if (arrays != json.end()) {
    if (!arrays->is_array() || arrays->size() > kArraysMax)
      return Status(Code::protocol_error, fmt::format("'arrays' must be a list of at most {} entries", kArraysMax));
    std::set<std::string> names;
    for (const Json& entry : *arrays) {
      Result<ArraySpec> spec = array_spec(entry, specs.size());
      if (!spec) return spec.status();
      if (!names.insert(spec->name).second)
        return bad_array(specs.size(), fmt::format("the name '{}' stands twice", spec->name));
      if (__builtin_add_overflow(sum, spec->bytes, &sum))
        return bad_array(specs.size(), "together more bytes than 64 bits can count");
      specs.push_back(std::move(*spec));
    }
  }
  if (sum != bulk_bytes)
    return Status(Code::protocol_error,
                  fmt::format("'arrays' describes {} bytes, the frame's header says {}", sum, bulk_bytes));
  return specs;
}

Json describe(std::span<const Array> arrays) {
  Json list = Json::array();
  for (const Array& array : arrays)
    list.push_back(Json{{"name", array.name}, {"dtype", array.dtype}, {"shape", array.shape}});
  return list;
}

const Array* find_array(std::span<const Array> arrays, std::string_view name) {
  const auto found = std::find_if(arrays.begin(), arrays.end(), [name](const Array& a) { return a.name == name; });
  return found == arrays.end() ? nullptr : &*found;
}

Json failure_json(const Status& status) {
  return Json{{"failure",
               {{"code", code_name(status.code())},
                {"message", escape_controls(status.message())},
                {"hint", escape_controls(status.hint())},
                {"exit", exit_code(status.code())}}}};
}

Status status_from_failure(const Json& json) {
  const auto failure = json.find("failure");
  if (failure == json.end() || !failure->is_object())
    return {Code::protocol_error, "a failure frame without its 'failure' object"};
  const std::string* code = text_of(*failure, "code");
  const std::string* message = text_of(*failure, "message");
  const std::string* hint = text_of(*failure, "hint");
  Code known = code == nullptr ? Code::internal : code_from_name(*code);
  if (known == Code::ok) known = Code::internal;  // a failure is never ok
  return {known, message == nullptr || message->empty() ? "the service gave no reason" : *message,
          hint == nullptr ? std::string{} : *hint};
}

std::string hex64(std::uint64_t value) { return fmt::format("{:016x}", value); }

Result<std::uint64_t> parse_hex64(std::string_view text) {
  const Status bad(Code::invalid_argument, fmt::format("expected 16 hex digits, got {} characters", text.size()));
  if (text.size() != 16) return bad;
  std::uint64_t value = 0;
  for (const char c : text) {
    unsigned digit = 0;
    if (c >= '0' && c <= '9')
      digit = static_cast<unsigned>(c - '0');
    else if (c >= 'a' && c <= 'f')
      digit = static_cast<unsigned>(c - 'a') + 10U;
    else if (c >= 'A' && c <= 'F')
      digit = static_cast<unsigned>(c - 'A') + 10U;
    else
      return Status(Code::invalid_argument, "expected 16 hex digits, got another character among them");
    value = value << 4U | digit;
  }
  return value;
}

}  // namespace rcb::wire
