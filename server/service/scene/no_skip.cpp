#include "server/service/scene/no_skip.hpp"

#include <algorithm>
#include <iterator>
#include <sstream>
#include <utility>

namespace rcb::service {
namespace {

constexpr std::pair<const char*, bool NoSkip::*> kNames[] = {
    {"exchange", &NoSkip::exchange}, {"search", &NoSkip::search}, {"warm", &NoSkip::full_search}};

}  // namespace

Result<NoSkip> NoSkip::parse(const std::string& names) {
  NoSkip no_skip;
  std::istringstream in(names);
  for (std::string name; std::getline(in, name, ',');) {
    const auto found =
        std::find_if(std::begin(kNames), std::end(kNames), [&name](const auto& known) { return name == known.first; });
    if (found == std::end(kNames)) {
      std::string known;
      for (const auto& entry : kNames) known += (known.empty() ? "" : ", ") + std::string(entry.first);
      return Status(Code::usage, "'" + name + "' is no skip that can be switched off", "there are: " + known);
    }
    no_skip.*found->second = true;
  }
  return no_skip;
}

}  // namespace rcb::service
