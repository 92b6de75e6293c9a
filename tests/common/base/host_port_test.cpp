#include "common/base/host_port.hpp"

#include <gtest/gtest.h>

namespace rcb {
namespace {

TEST(HostPort, IsCutAtTheLastColon) {
  const auto expect = [](std::string_view text, std::string_view host, std::string_view port, bool brackets) {
    const HostPort parts = split_host_port(text);
    EXPECT_EQ(parts.host, host) << text;
    EXPECT_EQ(parts.port, port) << text;
    EXPECT_EQ(parts.brackets, brackets) << text;
  };
  expect("host:1", "host", "1", false);
  expect("[::1]:7470", "::1", "7470", true);
  expect("::1:7470", "::1", "7470", false);
  expect("host", "host", "", false);
  expect("[]:1", "", "1", true);
  expect("[:1", "[", "1", false);
  expect("", "", "", false);
}

TEST(HostPort, PortsHaveSixteenBits) {
  EXPECT_EQ(port_number("0"), 0);
  EXPECT_EQ(port_number("65535"), 65535);
  for (const char* wrong : {"", "65536", "-1", "+1", "1 ", " 1", "0x1", "99999999999999999999"})
    EXPECT_FALSE(port_number(wrong).has_value()) << wrong;
}

TEST(HostPort, JoinsWhatItCuts) {
  EXPECT_EQ(join_host_port("host", 1), "host:1");
  EXPECT_EQ(join_host_port("::1", 7470), "[::1]:7470");
}

}  // namespace
}  // namespace rcb
