// Names and numbers of the codes travel on the wire and in scripts: they are fixed here a second time, on purpose.
#include "common/base/status.hpp"

#include <array>
#include <memory>

#include <gtest/gtest.h>

namespace rcb {
namespace {

struct Promised {
  int number;
  const char* name;
  int exit;
};

constexpr std::array kPromised{
    Promised{0, "ok", 0},
    Promised{1, "invalid_argument", 1},
    Promised{2, "not_found", 1},
    Promised{3, "already_exists", 1},
    Promised{4, "busy", 1},
    Promised{6, "stale_step", 1},
    Promised{8, "not_finite", 1},
    Promised{9, "protocol_error", 1},
    Promised{10, "too_large", 1},
    Promised{11, "not_authorised", 4},
    Promised{12, "unavailable", 3},
    Promised{13, "deadline_exceeded", 5},
    Promised{14, "aborted", 1},
    Promised{15, "io_error", 1},
    Promised{16, "unsupported", 1},
    Promised{17, "internal", 1},
    Promised{18, "usage", 2},
    Promised{19, "interrupted", 130},
    Promised{20, "not_conserved", 1},
    Promised{21, "duplicate_id", 1},
};

TEST(Status, NamesNumbersAndExitCodesAreThePromisedOnes) {
  for (const Promised& promised : kPromised) {
    const auto code = static_cast<Code>(promised.number);
    EXPECT_EQ(code_name(code), promised.name);
    EXPECT_EQ(code_from_name(promised.name), code);
    EXPECT_EQ(exit_code(code), promised.exit) << promised.name;
  }
}

TEST(Status, WhatANewerPeerSaysIsInternal) {
  EXPECT_EQ(code_from_name("from_the_future"), Code::internal);
  EXPECT_EQ(code_from_name(""), Code::internal);
  EXPECT_EQ(code_name(static_cast<Code>(999)), "internal");
  EXPECT_EQ(exit_code(static_cast<Code>(999)), 1);
}

TEST(Status, DefaultIsOk) {
  EXPECT_TRUE(Status().ok());
  const Status failure(Code::busy, "what", "do");
  EXPECT_FALSE(failure.ok());
  EXPECT_FALSE(static_cast<bool>(failure));
  EXPECT_EQ(failure.message(), "what");
  EXPECT_EQ(failure.hint(), "do");
}

TEST(Result, HoldsAValueOrAFailure) {
  Result<std::unique_ptr<int>> good(std::make_unique<int>(7));
  ASSERT_TRUE(good.ok());
  EXPECT_TRUE(good.status().ok());
  const std::unique_ptr<int> taken = std::move(good).value();
  EXPECT_EQ(*taken, 7);
  const Result<std::unique_ptr<int>> bad(Status(Code::not_found, "gone"));
  EXPECT_FALSE(bad.ok());
  EXPECT_EQ(bad.status().code(), Code::not_found);
}

TEST(ResultDeathTest, AValueThatIsNotThereIsABug) {
  Result<int> bad(Status(Code::not_found, "gone for good"));
  EXPECT_DEATH(static_cast<void>(bad.value()), "gone for good");
  EXPECT_DEATH(static_cast<void>(Result<int>(Status())), "needs a value or a failure");
}

}  // namespace
}  // namespace rcb
