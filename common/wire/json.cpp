// Parses JSON that may be hostile: a SAX handler stops at the first breach, so nothing is built beyond the limits.
#include <algorithm>

#include <fmt/format.h>

#include "common/wire/limits.hpp"
#include "common/wire/message.hpp"

namespace rcb::wire {
namespace {

class Builder final : public nlohmann::json_sax<Json> {
 public:
  enum class Binary { refused, taken };
  Builder(std::size_t values_max, Binary binary) : values_left_(values_max), binary_(binary) {}
  bool null() override { return place(nullptr); }
  bool boolean(bool value) override { return place(value); }
  bool number_integer(number_integer_t value) override { return place(value); }
  bool number_unsigned(number_unsigned_t value) override { return place(value); }
  bool number_float(number_float_t value, const string_t&) override { return place(value); }
  bool string(string_t& value) override { return place(std::move(value)); }
  bool binary(binary_t& value) override {
    return binary_ == Binary::taken ? place(std::move(value)) : fail("binary values have no place in it");
  }
  bool start_object(std::size_t) override { return open(Json::object()); }
  bool end_object() override { return close(); }
  bool start_array(std::size_t) override { return open(Json::array()); }
  bool end_array() override { return close(); }

  bool key(string_t& name) override {
    const auto [entry, fresh] = open_.back()->emplace(name, nullptr);
    if (!fresh) return fail(fmt::format("the key '{}' stands twice in an object", name.substr(0, 64)));
    slot_ = &entry.value();
    return true;
  }

  bool parse_error(std::size_t position, const std::string&, const nlohmann::detail::exception& why) override {
    // nlohmann's message quotes the input; truncated, it stays one readable line.
    std::string_view words = why.what();
    if (words.starts_with('[')) words.remove_prefix(std::min(words.find(']') + 2, words.size()));  // the library's name
    return fail(fmt::format("at byte {}: {}", position, words.substr(0, 200)));
  }

  Json take() { return std::move(root_); }
  const std::string& fault() const { return fault_; }

 private:
  bool fail(std::string fault) {
    fault_ = std::move(fault);
    return false;
  }

  // Stores a value where it belongs: as the root, under the key just read, or at the end of the open array.
  Json* put(Json value) {
    --values_left_;
    if (open_.empty()) {
      root_ = std::move(value);
      return &root_;
    }
    if (open_.back()->is_array()) {
      open_.back()->push_back(std::move(value));
      return &open_.back()->back();
    }
    *slot_ = std::move(value);
    return slot_;
  }

  template <typename T>
  bool place(T&& value) {
    if (open_.empty()) return fail("it isn't an object");
    if (values_left_ == 0) return fail("too many values");
    put(Json(std::forward<T>(value)));
    return true;
  }

  bool open(Json value) {
    if (open_.empty() && !value.is_object()) return fail("it isn't an object");
    if (open_.size() >= static_cast<std::size_t>(kJsonDepthMax))
      return fail(fmt::format("nested more than {} deep", kJsonDepthMax));
    if (values_left_ == 0) return fail("too many values");
    open_.push_back(put(std::move(value)));
    return true;
  }

  bool close() {
    open_.pop_back();
    return true;
  }

  Json root_;
  // The objects and arrays not yet closed. The pointers stay valid: a container grows only after the one inside it is
  // closed.
  std::vector<Json*> open_;
  Json* slot_ = nullptr;
  std::size_t values_left_;
  Binary binary_;
  std::string fault_;
};

}  // namespace

Result<Json> parse_json(std::string_view text, std::size_t bytes_max, std::size_t values_max) {
  if (text.size() > bytes_max)
    return Status(Code::protocol_error, fmt::format("JSON: {} bytes, at most {} are taken", text.size(), bytes_max));
  // The parser takes a zero byte for the end of the text and would accept what stands before it.
  if (text.find('\0') != std::string_view::npos) return Status(Code::protocol_error, "JSON: a zero byte inside");
  Builder builder(values_max, Builder::Binary::refused);
  if (!Json::sax_parse(text.begin(), text.end(), &builder))
    return Status(Code::protocol_error, "JSON: " + builder.fault(), "a frame carries one JSON object in UTF-8");
  return builder.take();
}

Result<Json> parse_msgpack(std::string_view bytes) {
  Builder builder(kJsonValuesMax, Builder::Binary::taken);
  if (!Json::sax_parse(bytes.begin(), bytes.end(), &builder, Json::input_format_t::msgpack))
    return Status(Code::protocol_error, "MessagePack: " + builder.fault());
  return builder.take();
}

std::string dump_json(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

}  // namespace rcb::wire
