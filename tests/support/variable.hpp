// A variable of the environment for as long as a test runs.
#pragma once

#include <cstdlib>
#include <optional>
#include <string>

namespace rcb::testing {

class Variable {
 public:
  // value: null for a variable that is not there.
  Variable(const char* name, const char* value) : name_(name) {
    if (const char* old = std::getenv(name)) old_ = old;
    set(value);
  }
  ~Variable() { set(old_ ? old_->c_str() : nullptr); }
  Variable(const Variable&) = delete;
  Variable& operator=(const Variable&) = delete;

  void set(const char* value) const { value == nullptr ? ::unsetenv(name_) : ::setenv(name_, value, 1); }

 private:
  const char* name_;
  std::optional<std::string> old_;
};

}  // namespace rcb::testing
