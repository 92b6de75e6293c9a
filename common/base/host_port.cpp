#include "common/base/host_port.hpp"

#include <charconv>

namespace rcb {

HostPort split_host_port(std::string_view text) {
  HostPort parts;
  const std::size_t colon = text.rfind(':');
  parts.host = text.substr(0, colon);
  if (colon != std::string_view::npos) parts.port = text.substr(colon + 1);
  parts.brackets = parts.host.starts_with('[') && parts.host.ends_with(']');
  if (parts.brackets) parts.host = parts.host.substr(1, parts.host.size() - 2);
  return parts;
}

std::optional<std::uint16_t> port_number(std::string_view digits) {
  std::uint16_t port = 0;
  const char* const end = digits.data() + digits.size();
  const auto [stop, fault] = std::from_chars(digits.data(), end, port);
  if (fault != std::errc() || stop != end) return std::nullopt;
  return port;
}

std::string join_host_port(std::string_view host, std::uint16_t port) {
  const bool brackets = host.find(':') != std::string_view::npos;
  return (brackets ? "[" : "") + std::string(host) + (brackets ? "]:" : ":") + std::to_string(port);
}

}  // namespace rcb
