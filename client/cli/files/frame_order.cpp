#include "client/cli/files/frame_order.hpp"

#include <algorithm>
#include <span>
#include <string_view>

#include <fmt/format.h>
#include <locale.h>
#include <string.h>

namespace rcb::cli {
namespace {

// A number of a name, of any length, without zeros that don't count.
struct Number {
  std::string whole;
  std::string fraction;
};

bool less(const Number& a, const Number& b) {
  if (a.whole.size() != b.whole.size()) return a.whole.size() < b.whole.size();
  return a.whole != b.whole ? a.whole < b.whole : a.fraction < b.fraction;
}

struct Name {
  std::string frame;  // a zero byte in place of each number
  std::vector<Number> numbers;
};

Name parse(std::string_view path) {
  const auto digits = [path](std::size_t at) {
    std::size_t end = at;
    while (end < path.size() && path[end] >= '0' && path[end] <= '9') ++end;
    return path.substr(at, end - at);
  };
  Name name;
  for (std::size_t at = 0; at < path.size();) {
    std::string_view whole = digits(at);
    if (whole.empty()) {
      name.frame += path[at++];
      continue;
    }
    at += whole.size();
    std::string_view fraction;
    if (at < path.size() && path[at] == '.') fraction = digits(at + 1);
    if (!fraction.empty()) at += 1 + fraction.size();
    whole.remove_prefix(std::min(whole.find_first_not_of('0'), whole.size()));
    fraction = fraction.substr(0, fraction.find_last_not_of('0') + 1);
    name.frame += '\0';
    name.numbers.push_back({std::string(whole), std::string(fraction)});
  }
  return name;
}

bool before(const Name& a, const Name& b) {
  return std::lexicographical_compare(a.numbers.begin(), a.numbers.end(), b.numbers.begin(), b.numbers.end(), less);
}

// By bytes, or as the user's language sorts.
bool is_alphabetical(std::span<const std::string> files) {
  if (std::is_sorted(files.begin(), files.end())) return true;
  const locale_t language = ::newlocale(LC_COLLATE_MASK, "", static_cast<locale_t>(nullptr));
  if (language == static_cast<locale_t>(nullptr)) return false;
  const bool sorted = std::is_sorted(files.begin(), files.end(), [language](const auto& a, const auto& b) {
    return ::strcoll_l(a.c_str(), b.c_str(), language) < 0;
  });
  ::freelocale(language);
  return sorted;
}

}  // namespace

FrameOrder in_frame_order(const std::vector<std::string>& files) {
  FrameOrder order{files, ""};
  std::vector<Name> names;
  for (const std::string& file : files) names.push_back(parse(file));
  for (std::size_t begin = 0, end = 0; begin < files.size(); begin = end) {
    while (end < files.size() && names[end].frame == names[begin].frame) ++end;
    const auto group = std::span(files).subspan(begin, end - begin);
    const auto first = names.begin() + static_cast<std::ptrdiff_t>(begin);
    const auto last = names.begin() + static_cast<std::ptrdiff_t>(end);
    const auto turned = std::adjacent_find(first, last, [](const Name& a, const Name& b) { return before(b, a); });
    if (turned == last || !is_alphabetical(group)) continue;
    if (order.changed.empty()) {
      const auto at = static_cast<std::size_t>(turned - names.begin());
      order.changed =
          fmt::format("files are taken in the order of their numbers: {} before {}", files[at + 1], files[at]);
    }
    std::vector<std::size_t> sorted(group.size());
    for (std::size_t k = 0; k < sorted.size(); ++k) sorted[k] = begin + k;
    std::stable_sort(sorted.begin(), sorted.end(),
                     [&](std::size_t a, std::size_t b) { return before(names[a], names[b]); });
    for (std::size_t k = 0; k < sorted.size(); ++k) order.files[begin + k] = files[sorted[k]];
  }
  return order;
}

}  // namespace rcb::cli
