// Options and their values: the word by which --help shows a value, and a check with a plain message. The check runs
// before the parser converts the text, so that users don't see the parser's own messages about types.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

namespace rcb::cli {

struct Kind {
  std::string shown;
  CLI::Validator check;  // of one value; may rewrite it into the form that the parser reads
};

// names: "--parts", or "NAME" for a positional argument, as messages call it.
template <typename T>
CLI::Option* add_value(CLI::App& command, const std::string& names, T& variable, const Kind& kind,
                       const std::string& help) {
  return command.add_option(names, variable, help)->type_name(kind.shown)->transform(kind.check);
}

// Stands for -inf on the command line, whose parser would take that for an option.
inline constexpr const char* kMinusInfinity = "-0inf";

// The values of a list with commas between. Throws CLI::ValidationError, in the words of the check.
std::vector<std::string> read_list(const std::string& names, const std::string& text, const Kind& kind);

// One word on the command line, so that what follows it isn't taken for a part of the list.
template <typename T>
CLI::Option* add_list(CLI::App& command, const std::string& names, std::vector<T>& list, const Kind& kind,
                      const std::string& help) {
  const auto read = [names, &list, kind](const std::string& text) {
    list.clear();
    for (const std::string& value : read_list(names, text, kind)) CLI::detail::lexical_cast(value, list.emplace_back());
  };
  return command.add_option_function<std::string>(names, read, help)->type_name(kind.shown);
}

namespace kind {

Kind text(const std::string& shown);  // must not be empty
Kind memory_size();                   // 65536, 512mb, 4gb
Kind number(const std::string& shown);
Kind number_or_infinity(const std::string& shown);  // inf and -inf, too
Kind number_or(const std::string& shown, const std::string& word);
Kind positive_number(const std::string& shown);
Kind number_from_zero(const std::string& shown);
Kind number_from_one(const std::string& shown);
Kind number_between(const std::string& shown, double least, double most);
Kind tolerance();  // 0 to inf
// Also in the form 1e3.
Kind whole_number(const std::string& shown, std::int64_t least,
                  std::int64_t most = std::numeric_limits<std::int64_t>::max());
Kind deadline();
Kind part_count();
Kind rank_count();
Kind dimensions();
Kind one_of(const std::string& shown, const std::vector<std::string>& words);
Kind method();
Kind policy();
Kind positions();
// A file to be written: its extension may not be that of another format.
enum class Format { csv, npy, json, figure };
Kind output_file(Format format);

}  // namespace kind

inline constexpr const char* kToleranceHelp = "repartition at this error; inf: never";
inline constexpr const char* kHysteresisHelp =
    "a repartition keeps a cut's axis until another axis is longer by more than this factor; 1: the longest axis "
    "always";
inline constexpr const char* kPolicyHelp =
    "repartition at the tolerance or, with cost, once imbalance has cost more time than a repartition takes";
inline constexpr const char* kPositionsHelp =
    "when positions travel to the service: at every step, or when needed: the client counts, and sends them where new "
    "cuts are due or a question about positions waits";
inline constexpr const char* kPartSizesHelp = "a share for each part, such as 1,2,3";
inline constexpr const char* kStepSecondsHelp =
    "the solver's computing time since its last push; used by the policy cost";
inline constexpr const char* kCutToleranceHelp =
    "end a search once no part's load can be off its target by more than this fraction, apart from rounding by at most "
    "one particle (with weights, half the greatest weight) a level of the tree; 0: exact";
inline constexpr const char* kGhostWidthHelp =
    "a point of another part is a ghost if it is this near to the box around a part's points (default: 2 (box volume / "
    "points)^(1/dims), without axes along which all points coincide)";
inline constexpr const char* kTemporaryRanksHelp =
    "start a temporary service with this many ranks (default: use the running service, or a temporary one if there is "
    "none)";
inline constexpr const char* kDeadlineHelp = "give up after so many seconds, at most 3600; the exit code is then 5";
inline constexpr const char* kAllHelp = "show every part, however many";

// Formats the pages of --help.
std::shared_ptr<CLI::Formatter> help_format();

}  // namespace rcb::cli
