// The pages of --help: plain names for what an option takes, defaults and required options in words, lines of a
// terminal's width.
#include <memory>
#include <utility>

#include <fmt/format.h>

#include "client/cli/options.hpp"

namespace rcb::cli {
namespace {

constexpr std::size_t kTextColumn = 28;
constexpr std::size_t kWidth = 100;

// `text` in lines of at most `width`, broken at spaces.
std::vector<std::string> wrapped(const std::string& text, std::size_t width) {
  std::vector<std::string> lines;
  std::size_t at = 0;
  while (text.size() - at > width) {
    const std::size_t end = text.rfind(' ', at + width);
    if (end == std::string::npos || end <= at) break;
    lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  lines.push_back(text.substr(at));
  return lines;
}

std::string entry(const std::string& name, const std::string& text) {
  const std::string margin(kTextColumn, ' ');
  std::string line = "  " + name;
  std::string out;
  if (line.size() + 2 > kTextColumn)
    out = std::exchange(line, margin) + "\n";
  else
    line.resize(kTextColumn, ' ');
  for (const std::string& part : wrapped(text, kWidth - kTextColumn)) out += std::exchange(line, margin) + part + "\n";
  return out;
}

class HelpFormat : public CLI::Formatter {
 public:
  HelpFormat() {
    label("Positionals", "Arguments");
    label("SUBCOMMAND", "COMMAND");
    column_width(kTextColumn);
  }

  std::string make_option(const CLI::Option* option, bool positional) const override {
    return entry(make_option_name(option, positional) + make_option_opts(option), make_option_desc(option));
  }
  std::string make_subcommand(const CLI::App* command) const override {
    return entry(command->get_name(), command->get_description());
  }
  std::string make_option_name(const CLI::Option* option, bool positional) const override {
    if (positional) return option->get_type_name();
    const std::string names = option->get_name(false, true);
    const std::size_t comma = names.find(',');
    return comma == std::string::npos ? names : names.substr(0, comma) + ", " + names.substr(comma + 1);
  }
  std::string make_option_opts(const CLI::Option* option) const override {
    if (!option->nonpositional() || option->get_type_size() == 0) return "";
    return " " + option->get_type_name();
  }
  std::string make_option_desc(const CLI::Option* option) const override {
    std::string text = option->get_description();
    if (!option->get_default_str().empty()) text += fmt::format(" (default {})", option->get_default_str());
    if (option->get_required() && option->nonpositional()) text += " (required)";
    return text;
  }
  std::string make_option_usage(const CLI::Option* option) const override {
    return option->get_required() ? option->get_type_name() : "[" + option->get_type_name() + "]";
  }
  std::string make_usage(const CLI::App* app, std::string name) const override {
    std::string usage = CLI::Formatter::make_usage(app, std::move(name));
    // The usage line also shows the options that must be given.
    std::string needed;
    for (const CLI::Option* option : app->get_options())
      if (option->get_required() && option->nonpositional())
        needed += " " + make_option_name(option, false) + make_option_opts(option);
    if (const std::size_t end = usage.rfind('\n'); end != std::string::npos) usage.insert(end, needed);
    return "\n" + usage;
  }
  std::string make_footer(const CLI::App* app) const override {
    return app->get_footer() +
           (app->get_parent() == nullptr ? "" : "\n--json and --endpoint go with every command: rcbctl --help\n");
  }
};

}  // namespace

std::shared_ptr<CLI::Formatter> help_format() { return std::make_shared<HelpFormat>(); }

}  // namespace rcb::cli
