#include "common/base/byte_size.hpp"

#include <charconv>
#include <string>

#include <fmt/format.h>
#include <unistd.h>

namespace rcb {
namespace {

// The power of 1024 of a unit; -1: there is none of this name.
int power_of(std::string unit) {
  for (char& letter : unit) letter = static_cast<char>(letter | 0x20);
  if (unit.empty() || unit == "b") return 0;
  constexpr std::string_view kLetters = "kmgt";
  const std::size_t letter = kLetters.find(unit[0]);
  const std::string_view rest = std::string_view(unit).substr(1);
  return letter == std::string_view::npos || (rest != "b" && rest != "ib") ? -1 : static_cast<int>(letter) + 1;
}

}  // namespace

std::uint64_t machine_bytes() {
  return static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
}

Result<std::uint64_t> read_memory_size(std::string_view text) {
  std::uint64_t number = 0;
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), number);
  const int power = power_of(std::string(end, text.data() + text.size()));
  if (fault == std::errc::invalid_argument || power < 0)
    return Status(Code::invalid_argument, fmt::format("'{}' is no number of bytes", text), "for example 512mb or 4gb");
  const unsigned shift = 10U * static_cast<unsigned>(power);
  const std::uint64_t most = machine_bytes();
  if (fault == std::errc::result_out_of_range || number > most >> shift)
    return Status(Code::invalid_argument, fmt::format("{} is more than this machine's memory, {} bytes", text, most));
  if (number == 0) return Status(Code::invalid_argument, "0 bytes are no memory");
  return number << shift;
}

}  // namespace rcb
