// FieldReader: reads a message's fields one after another and keeps the first error, so that one check after them is
// enough. A wrong field reads as its lowest value, or as the value for an absent one.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

#include "common/wire/message.hpp"

namespace rcb::wire {

class FieldReader {
 public:
  explicit FieldReader(const Json& json) : json_(json) {}

  // Whether the field is there, and not null.
  bool has(const char* name) const;
  std::int64_t integer(const char* name, std::int64_t low, std::int64_t high) {
    return keep(integer_field(json_, name, low, high), low);
  }
  std::int64_t integer_or(const char* name, std::int64_t low, std::int64_t high, std::int64_t otherwise) {
    return keep(integer_field_or(json_, name, low, high, otherwise), otherwise);
  }
  // A count of particles; 0 if absent.
  std::uint64_t particles(const char* name) {
    return static_cast<std::uint64_t>(integer_or(name, 0, kParticlesMax, 0));
  }
  double number_or(const char* name, double low, double high, double otherwise, bool infinity_allowed = false) {
    return keep(number_field_or(json_, name, low, high, otherwise, infinity_allowed), otherwise);
  }
  std::string text(const char* name, std::size_t length_max = 4096) {
    return keep(string_field(json_, name, length_max), std::string());
  }
  std::string text_or(const char* name, std::size_t length_max, std::string otherwise) {
    return has(name) ? keep(string_field(json_, name, length_max), std::move(otherwise)) : otherwise;
  }
  // false if absent
  bool flag(const char* name) { return keep(bool_field(json_, name), false); }
  // One of these words; the first if absent.
  std::string word(const char* name, std::initializer_list<const char*> words);
  // Empty if absent.
  std::vector<double> numbers(const char* name, std::size_t count_max) {
    return keep(numbers_field_or_empty(json_, name, count_max), std::vector<double>());
  }
  std::vector<std::string> texts(const char* name, std::size_t count_max) {
    return keep(strings_field_or_empty(json_, name, count_max), std::vector<std::string>());
  }
  // An error that the caller has found; kept if it is the first.
  void fail(Status status) {
    if (status_.ok()) status_ = std::move(status);
  }

  bool ok() const { return status_.ok(); }
  const Status& status() const { return status_; }

 private:
  template <typename T>
  T keep(Result<T> value, T otherwise) {
    if (value.ok()) return std::move(value).value();
    fail(value.status());
    return otherwise;
  }

  const Json& json_;
  Status status_;
};

}  // namespace rcb::wire
