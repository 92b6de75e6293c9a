#include "client/cli/options.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/byte_size.hpp"
#include "common/wire/limits.hpp"

namespace rcb::cli {

std::vector<std::string> read_list(const std::string& names, const std::string& text, const Kind& kind) {
  std::vector<std::string> values;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    values.push_back(text.substr(begin, end - begin));
    if (const std::string fault = kind.check(values.back()); !fault.empty()) throw CLI::ValidationError(names, fault);
    begin = end + 1;
  }
  return values;
}

namespace kind {
namespace {

constexpr int kRanksMax = 4096;
constexpr double kWholeMax = 9007199254740992.0;  // 2^53: a larger double may not be an exact count

std::optional<double> number_in(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || std::isnan(value)) return std::nullopt;
  // Infinity must be written as a word: a number too large for a double, such as 1e400, is refused.
  if (std::isinf(value) && text.find_first_of("0123456789") != std::string::npos) return std::nullopt;
  return value;
}

std::optional<std::int64_t> whole_in(const std::string& text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error == std::errc{} && end == text.data() + text.size()) return value;
  const auto number = number_in(text);
  if (!number || std::fabs(*number) > kWholeMax || std::trunc(*number) != *number) return std::nullopt;
  return static_cast<std::int64_t>(*number);
}

// fault_of: what is wrong with a value; for CLI11 an empty text means that it passes.
Kind checked(const std::string& shown, std::function<std::string(std::string&)> fault_of) {
  const auto check = [fault_of = std::move(fault_of)](std::string& text) {
    if (text == kMinusInfinity) text = "-inf";
    return fault_of(text);
  };
  return {shown, CLI::Validator(check, "")};
}

Kind number_kind(const std::string& shown, const std::string& wanted, std::function<bool(double)> good) {
  return checked(shown, [wanted, good = std::move(good)](std::string& text) {
    const auto value = number_in(text);
    return value && good(*value) ? std::string() : fmt::format("'{}' is not {}", text, wanted);
  });
}

// The extension of a file's name in lower case; "" for none.
std::string ending_of(const std::string& path) {
  const std::string name = path.substr(path.rfind('/') + 1);
  const std::size_t dot = name.rfind('.');
  if (dot == std::string::npos || dot == 0) return "";
  std::string ending = name.substr(dot);
  for (char& c : ending)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return ending;
}

struct FormatNames {
  const char* name;
  std::vector<std::string> endings;  // that a file of this format may have
};

FormatNames names_of(Format format) {
  switch (format) {
    case Format::csv:
      return {"CSV", {".csv", ".txt"}};
    case Format::npy:
      return {"an .npy array", {".npy"}};
    case Format::json:
      return {"JSON", {".json", ".txt"}};
    case Format::figure:
      break;
  }
  return {"a figure", {".svg", ".png"}};
}

// Extensions by which other programs recognise a format.
constexpr const char* kKnownEndings[] = {".csv", ".tsv",  ".txt", ".json", ".npy",  ".npz",  ".h5",  ".hdf5",   ".xyz",
                                         ".vtk", ".vtu",  ".vtp", ".xls",  ".xlsx", ".ods",  ".svg", ".png",    ".pdf",
                                         ".jpg", ".jpeg", ".gif", ".eps",  ".ps",   ".webp", ".tif", ".tiff",   ".bmp",
                                         ".htm", ".html", ".gz",  ".zip",  ".bz2",  ".xz",   ".zst", ".parquet"};

}  // namespace

Kind text(const std::string& shown) {
  return checked(shown, [](std::string& value) { return std::string(value.empty() ? "it is empty" : ""); });
}

Kind memory_size() {
  return checked("BYTES", [](std::string& text) { return read_memory_size(text).status().message(); });
}

Kind number(const std::string& shown) {
  return number_kind(shown, "a number", [](double v) { return std::isfinite(v); });
}

Kind number_or_infinity(const std::string& shown) {
  return number_kind(shown, "a number, inf or -inf", [](double) { return true; });
}

Kind number_or(const std::string& shown, const std::string& word) {
  return checked(shown, [word](std::string& text) {
    const auto value = number_in(text);
    if (text == word || (value && std::isfinite(*value))) return std::string();
    return fmt::format("'{}' is neither a number nor {}", text, word);
  });
}

Kind positive_number(const std::string& shown) {
  return number_kind(shown, "a number above 0", [](double v) { return std::isfinite(v) && v > 0; });
}

Kind number_from_zero(const std::string& shown) {
  return number_kind(shown, "a number of at least 0", [](double v) { return std::isfinite(v) && v >= 0; });
}

Kind number_from_one(const std::string& shown) {
  return number_kind(shown, "a number of at least 1", [](double v) { return std::isfinite(v) && v >= 1; });
}

Kind number_between(const std::string& shown, double least, double most) {
  return number_kind(shown, fmt::format("a number from {} to {}", least, most),
                     [least, most](double v) { return v >= least && v <= most; });
}

Kind tolerance() {
  return number_kind("T", "a number of at least 0, or inf", [](double v) { return v >= 0; });
}

Kind whole_number(const std::string& shown, std::int64_t least, std::int64_t most) {
  const std::string wanted = most > static_cast<std::int64_t>(kWholeMax)
                                 ? fmt::format("a whole number of at least {}", least)
                                 : fmt::format("a whole number from {} to {}", least, most);
  return checked(shown, [least, most, wanted](std::string& text) {
    const auto value = whole_in(text);
    const auto number = number_in(text);
    if (value ? *value > most : number && *number > kWholeMax)
      return fmt::format("'{}' is above {}, the most there is", text, most);
    if (!value || *value < least) return fmt::format("'{}' is not {}", text, wanted);
    text = std::to_string(*value);
    return std::string();
  });
}

Kind deadline() {
  return number_kind("SECONDS", fmt::format("a number above 0 and up to {}", wire::kDeadlineSecondsMax),
                     [](double v) { return v > 0 && v <= wire::kDeadlineSecondsMax; });
}
Kind part_count() { return whole_number("P", 1, wire::kPartsMax); }
Kind rank_count() { return whole_number("R", 1, kRanksMax); }
Kind dimensions() { return whole_number("D", 1, 3); }

Kind one_of(const std::string& shown, const std::vector<std::string>& words) {
  return checked(shown, [words](std::string& text) {
    if (std::find(words.begin(), words.end(), text) != words.end()) return std::string();
    return fmt::format("'{}' is none of {}", text, fmt::join(words, ", "));
  });
}

Kind method() { return one_of("METHOD", {"rcb", "bands-x", "bands-y", "bands-z"}); }
Kind policy() { return one_of("POLICY", {"tolerance", "cost"}); }
Kind positions() { return one_of("WHEN", {"every-step", "when-needed"}); }

Kind output_file(Format format) {
  const FormatNames names = names_of(format);
  return checked("F" + names.endings.front(), [names](std::string& path) {
    if (path.empty()) return std::string("it is empty");
    if (path == "-") return std::string("name a file; one of this name is ./-");
    const std::string ending = ending_of(path);
    if (std::ranges::count(kKnownEndings, ending) == 0 || std::ranges::count(names.endings, ending) > 0)
      return std::string();
    return fmt::format("{} is written, and '{}' names another format; end the name in {}", names.name, path,
                       fmt::join(names.endings, " or "));
  });
}

}  // namespace kind
}  // namespace rcb::cli
