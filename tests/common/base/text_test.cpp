#include "common/base/text.hpp"

#include <gtest/gtest.h>

namespace rcb {
namespace {

TEST(Text, ControlsAreFoundAndEscaped) {
  for (const char* plain : {"", "plain ~", "Größe → 3", "\u00A0\u00BF", "\xC2"}) {
    EXPECT_FALSE(has_controls(plain)) << plain;
    EXPECT_EQ(escape_controls(plain), plain);
  }
  EXPECT_EQ(escape_controls("a\nb\x1b[2J\x7f"), "a\\x0ab\\x1b[2J\\x7f");
  EXPECT_EQ(escape_controls("\u009B"
                            "2J"),
            "\\xc2\\x9b2J");  // one byte of it drives some terminals
  EXPECT_EQ(escape_controls("two\nlines\t\r", "\n\t"), "two\nlines\t\\x0d");
  for (const char* text : {"\n", "a\x01", "\u0080", "\x7f"}) EXPECT_TRUE(has_controls(text)) << text;
  EXPECT_TRUE(has_controls(std::string_view("\0", 1)));
}

}  // namespace
}  // namespace rcb
