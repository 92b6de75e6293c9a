// Which addresses other machines may reach.
#include "common/tls/off_loopback.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

namespace rcb::tls {
namespace {

bool off(int family, const char* text) {
  sockaddr_storage place{};
  place.ss_family = static_cast<sa_family_t>(family);
  void* bytes = family == AF_INET ? static_cast<void*>(&reinterpret_cast<sockaddr_in&>(place).sin_addr)
                                  : static_cast<void*>(&reinterpret_cast<sockaddr_in6&>(place).sin6_addr);
  EXPECT_EQ(::inet_pton(family, text, bytes), 1) << text;
  return off_loopback(reinterpret_cast<const sockaddr&>(place));
}

TEST(OffLoopback, IsWhatOtherMachinesMayReach) {
  for (const char* here : {"127.0.0.1", "127.255.3.2"}) EXPECT_FALSE(off(AF_INET, here)) << here;
  for (const char* here : {"::1", "::ffff:127.0.0.1", "::ffff:127.9.8.7"}) EXPECT_FALSE(off(AF_INET6, here)) << here;
  for (const char* out : {"10.0.0.1", "128.0.0.1", "126.255.255.255", "0.0.0.0", "1.0.0.127"})
    EXPECT_TRUE(off(AF_INET, out)) << out;
  for (const char* out : {"::", "::2", "fe80::1", "2001:db8::1", "::ffff:10.0.0.127", "::127.0.0.1", "7f00::1"})
    EXPECT_TRUE(off(AF_INET6, out)) << out;
  sockaddr unix_socket{};
  unix_socket.sa_family = AF_UNIX;
  EXPECT_FALSE(off_loopback(unix_socket));
}

}  // namespace
}  // namespace rcb::tls
