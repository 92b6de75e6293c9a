#include "common/tls/off_loopback.hpp"

#include <cstring>

#include <netinet/in.h>
#include <sys/socket.h>

namespace rcb::tls {

bool off_loopback(const sockaddr& address) {
  if (address.sa_family == AF_UNIX) return false;
  if (address.sa_family == AF_INET) {
    sockaddr_in v4{};
    std::memcpy(&v4, &address, sizeof v4);
    return ntohl(v4.sin_addr.s_addr) >> 24U != IN_LOOPBACKNET;
  }
  if (address.sa_family != AF_INET6) return true;
  sockaddr_in6 v6{};
  std::memcpy(&v6, &address, sizeof v6);
  const unsigned char* bytes = v6.sin6_addr.s6_addr;
  const bool mapped = IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr);
  return !IN6_IS_ADDR_LOOPBACK(&v6.sin6_addr) && !(mapped && bytes[12] == IN_LOOPBACKNET);
}

}  // namespace rcb::tls
