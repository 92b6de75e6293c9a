// HOST:PORT, and [HOST]:PORT for IPv6 addresses.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace rcb {

struct HostPort {
  std::string_view host;  // without brackets
  std::string_view port;  // empty: there was no colon
  bool brackets = false;
};

// Cuts at the last colon.
HostPort split_host_port(std::string_view text);
// 0 to 65535; nothing for any other text.
std::optional<std::uint16_t> port_number(std::string_view digits);
// With brackets around a host that has a colon.
std::string join_host_port(std::string_view host, std::uint16_t port);

}  // namespace rcb
