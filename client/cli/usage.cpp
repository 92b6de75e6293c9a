#include "client/cli/usage.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "common/base/nearest.hpp"

namespace rcb::cli {
namespace {

struct Chosen {
  const CLI::App* command;
  std::string path;  // "scene create"
};

Chosen chosen_in(const CLI::App& app) {
  Chosen chosen{&app, ""};
  while (!chosen.command->get_subcommands().empty()) {
    chosen.command = chosen.command->get_subcommands().front();
    chosen.path += (chosen.path.empty() ? "" : " ") + chosen.command->get_name();
  }
  return chosen;
}

std::vector<std::string> commands_of(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : app.get_subcommands(nullptr)) names.push_back(command->get_name());
  return names;
}

std::vector<std::string> options_of(const CLI::App& app, const CLI::App& command) {
  std::vector<std::string> names;
  for (const CLI::App* owner : {&command, &app})
    for (const CLI::Option* option : owner->get_options())
      for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  return names;
}

std::string did_you_mean(const std::string& word, const std::vector<std::string>& names) {
  const auto near = names_like(word, names);
  return near.empty() ? "" : fmt::format("did you mean {}? ", near.front());
}

struct UsageMessage {
  std::string message;
  std::string meant;  // "did you mean --parts? "
};

// A word or option that no command takes.
UsageMessage unexpected(const CLI::App& app, const Chosen& chosen, const std::string& word) {
  if (word.size() < 2 || word[0] != '-') return {fmt::format("'{}' is one word too many", word), ""};
  const std::string name = word.substr(0, word.find('='));
  const std::vector<std::string> options = options_of(app, *chosen.command);
  if (std::find(options.begin(), options.end(), name) != options.end())  // so the parser met "--" before it
    return {fmt::format("{} stands behind --, where no options are read", name), ""};
  return {fmt::format("there is no option {}", name), did_you_mean(name, options)};
}

UsageMessage unknown_command(const Chosen& chosen, const std::string& word) {
  return {fmt::format("there is no command {}{}", chosen.path.empty() ? "" : chosen.path + " ", word),
          did_you_mean(word, commands_of(*chosen.command))};
}

template <typename Kind>
bool is(const CLI::ParseError& error) {
  return dynamic_cast<const Kind*>(&error) != nullptr;
}

// The parser's own message, with its terms replaced by plain ones.
std::string plain(const CLI::ParseError& error) {
  std::string text = error.what();
  const auto replace = [&text](std::string_view from, std::string_view to) {
    if (const std::size_t at = text.find(from); at != std::string::npos) text.replace(at, from.size(), to);
  };
  if (is<CLI::RequiredError>(error)) replace(" is required", " is missing");
  if (is<CLI::ExcludesError>(error)) replace(" excludes ", " doesn't go with ");
  if (is<CLI::RequiresError>(error)) replace(" requires ", " goes only with ");
  if (!is<CLI::ArgumentMismatch>(error)) return text;
  // "--parts: 1 required P missing", "--parts: At Most 1 required but received 2"
  const std::string option = text.substr(0, text.find(':'));
  if (text.ends_with(" missing")) return option + ": its value is missing";
  if (text.find("At Most") != std::string::npos) return option + ": more values than it takes";
  return option + ": fewer values than it takes";
}

}  // namespace

Status usage_failure(const CLI::App& app, const CLI::ParseError& error) {
  const Chosen chosen = chosen_in(app);
  UsageMessage words{plain(error), ""};
  const std::vector<std::string> extra = app.remaining(true);
  const auto is_dashed = [](const std::string& word) { return word.starts_with("-"); };
  const auto dashed = std::find_if(extra.begin(), extra.end(), is_dashed);
  const auto word = std::find_if_not(extra.begin(), extra.end(), is_dashed);
  const bool command_missing = !commands_of(*chosen.command).empty();
  if (command_missing && word != extra.end())
    words = unknown_command(chosen, *word);
  else if (dashed != extra.end())  // report a mistyped option before what is missing because of it
    words = unexpected(app, chosen, *dashed);
  else if (command_missing)
    words = {fmt::format("rcbctl {}wants a command: {}", chosen.path.empty() ? "" : chosen.path + " ",
                         fmt::join(commands_of(*chosen.command), ", ")),
             ""};
  else if (is<CLI::ExtrasError>(error) && !extra.empty())
    words = unexpected(app, chosen, extra.front());
  return {Code::usage, words.message,
          fmt::format("{}rcbctl{}{} --help", words.meant, chosen.path.empty() ? "" : " ", chosen.path)};
}

}  // namespace rcb::cli
