#include "server/net/peers/host.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>
#include <unistd.h>

#include "common/files/paths.hpp"
#include "server/net/sockets/asio.hpp"

namespace rcb::net {
namespace {

asio::ip::address address_in(const sockaddr& socket) {
  if (socket.sa_family == AF_INET) {
    sockaddr_in in{};
    std::memcpy(&in, &socket, sizeof in);
    return asio::ip::address_v4(ntohl(in.sin_addr.s_addr));
  }
  sockaddr_in6 in{};
  std::memcpy(&in, &socket, sizeof in);
  asio::ip::address_v6::bytes_type bytes;
  std::memcpy(bytes.data(), &in.sin6_addr, bytes.size());
  return asio::ip::address_v6(bytes);
}

// Whether `wanted`, an address or a network, holds the address.
bool holds(const std::string& wanted, const asio::ip::address& address) {
  error_code error;
  if (const auto same = asio::ip::make_address(wanted, error); !error) return same == address;
  if (const auto network = asio::ip::make_network_v4(wanted, error); !error)
    return address.is_v4() &&
           asio::ip::make_network_v4(address.to_v4(), network.prefix_length()).canonical() == network.canonical();
  if (const auto network = asio::ip::make_network_v6(wanted, error); !error)
    return address.is_v6() &&
           asio::ip::make_network_v6(address.to_v6(), network.prefix_length()).canonical() == network.canonical();
  return false;
}

}  // namespace

Result<std::vector<std::string>> addresses_on(const std::string& interface) {
  ifaddrs* list = nullptr;
  if (::getifaddrs(&list) != 0)
    return Status(Code::io_error, fmt::format("this machine's interfaces can't be listed: {}", std::strerror(errno)));
  const std::unique_ptr<ifaddrs, decltype(&::freeifaddrs)> owner(list, &::freeifaddrs);
  std::vector<std::string> found;
  std::vector<std::string> names;
  for (const ifaddrs* entry = list; entry != nullptr; entry = entry->ifa_next) {
    if (entry->ifa_addr == nullptr || (entry->ifa_flags & IFF_UP) == 0U || (entry->ifa_flags & IFF_LOOPBACK) != 0U)
      continue;
    if (entry->ifa_addr->sa_family != AF_INET && entry->ifa_addr->sa_family != AF_INET6) continue;
    const asio::ip::address address = address_in(*entry->ifa_addr);
    if (address.is_v6() && address.to_v6().is_link_local()) continue;  // means nothing without its interface
    names.push_back(fmt::format("{} ({})", entry->ifa_name, address.to_string()));
    if (interface.empty() || interface == entry->ifa_name || holds(interface, address))
      found.push_back(address.to_string());
  }
  std::stable_partition(found.begin(), found.end(), [](const std::string& a) { return a.find(':') == a.npos; });
  if (found.empty())
    return Status(Code::invalid_argument,
                  interface.empty() ? "this machine has no network interface that others reach"
                                    : fmt::format("no interface of this machine that others reach is '{}'", interface),
                  names.empty() ? "" : fmt::format("there are {}", fmt::join(names, ", ")));
  return found;
}

}  // namespace rcb::net
