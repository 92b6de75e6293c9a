// What the C++ test programs share: a service to be asked, points, and checks that say what they found instead.
#pragma once

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>

#include <rcbd/rcbd.hpp>

#define EXPECT(condition) expect(condition, #condition, __LINE__)
// That a call throws an Error of this code, whose message has this text.
#define EXPECT_ERROR(code, text, call) \
  expect_error(                        \
      code, text, [&] { (void)(call); }, #call, __LINE__)

inline void expect(bool right, const char* what, int line) {
  if (right) return;
  std::fprintf(stderr, "line %d: not so: %s; the last message was: %s\n", line, what, rcbd_message());
  std::exit(1);
}

template <typename Call>
void expect_error(int code, const char* text, const Call& call, const char* what, int line) {
  try {
    call();
  } catch (const rcbd::Error& error) {
    if (error.code() == code && error.message().find(text) != std::string::npos) return;
    std::fprintf(stderr, "line %d: %s: %s: %s\n", line, what, error.code_name(), error.what());
    std::exit(1);
  }
  std::fprintf(stderr, "line %d: %s: no error\n", line, what);
  std::exit(1);
}

constexpr std::size_t kPoints = 3000;

inline std::vector<double> points() {
  std::vector<double> xyz(3 * kPoints);
  for (std::size_t i = 0; i < xyz.size(); ++i) xyz[i] = std::fmod(double(i) * 0.61803398875, 1.0);
  return xyz;
}

inline std::string& endpoint() {
  static std::string value;
  return value;
}

inline rcbd::Scene opened(const rcbd::Client& client, const std::string& name, int dims = 3) {
  rcbd::SceneOptions options;
  options.parts = 8;
  options.dims = dims;
  options.replace = true;
  return client.scene_open(name, options);
}

struct TestCase {
  std::string name;
  std::function<void()> run;
};

// Without arguments lists the cases; PROGRAM ENDPOINT CASE runs one against a service.
inline int run_case(int count, char** arguments, const std::vector<TestCase>& cases) {
  if (count == 1)
    for (const TestCase& one : cases) std::puts(one.name.c_str());
  if (count != 3) return count == 1 ? 0 : 2;
  endpoint() = arguments[1];
  for (const TestCase& one : cases)
    if (one.name == arguments[2]) {
      one.run();
      return 0;
    }
  return 2;
}
