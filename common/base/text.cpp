#include "common/base/text.hpp"

#include <fmt/format.h>

namespace rcb {
namespace {

// Length in bytes of the control character that starts at `at`; 0 if there is none.
std::size_t control_bytes(std::string_view text, std::size_t at) {
  const auto byte = static_cast<unsigned char>(text[at]);
  if (byte < 0x20 || byte == 0x7F) return 1;
  const bool c1 = byte == 0xC2 && at + 1 < text.size() && (static_cast<unsigned char>(text[at + 1]) & 0xE0U) == 0x80;
  return c1 ? 2 : 0;
}

}  // namespace

bool has_controls(std::string_view text) {
  for (std::size_t at = 0; at < text.size(); ++at)
    if (control_bytes(text, at) > 0) return true;
  return false;
}

std::string escape_controls(std::string_view text, std::string_view kept) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t bytes = control_bytes(text, at);
    if (bytes == 0 || kept.find(text[at]) != std::string_view::npos) {
      out += text[at++];
      continue;
    }
    for (std::size_t end = at + bytes; at < end; ++at)
      out += fmt::format("\\x{:02x}", static_cast<unsigned char>(text[at]));
  }
  return out;
}

std::string and_more(std::size_t more) { return more == 0 ? "" : fmt::format(" and {} more", more); }

}  // namespace rcb
