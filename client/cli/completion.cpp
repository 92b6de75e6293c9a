// completion: scripts for bash, zsh and fish, made from the commands themselves.
#include <fmt/format.h>

#include "client/cli/app.hpp"
#include "client/cli/output.hpp"

namespace rcb::cli {
namespace {

std::vector<const CLI::App*> children(const CLI::App& app) {
  std::vector<const CLI::App*> list;
  for (const CLI::App* command : app.get_subcommands(nullptr)) list.push_back(command);
  return list;
}

std::string words(const CLI::App& app) {
  std::string text;
  for (const CLI::App* command : children(app)) text += command->get_name() + " ";
  for (const CLI::Option* option : app.get_options())
    for (const std::string& name : option->get_lnames()) text += "--" + name + " ";
  return text;
}

std::string global_words(const CLI::App& app) {
  std::string text;
  for (const CLI::Option* option : app.get_options())
    for (const std::string& name : option->get_lnames()) text += "--" + name + " ";
  return text;
}

// The words that may follow each command, as the branches of a shell's case.
void append_cases(const CLI::App& app, const std::string& path, const std::string& global, std::string& out) {
  for (const CLI::App* command : children(app)) {
    const std::string name = path + command->get_name();
    out += fmt::format("    '{}') words='{}{}' ;;\n", name, words(*command), global);
    append_cases(*command, name + " ", global, out);
  }
}

std::string bash(const CLI::App& app) {
  std::string cases;
  append_cases(app, "", global_words(app), cases);
  return fmt::format(R"(# rcbctl completion for bash: source <(rcbctl completion bash)
_rcbctl() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} path='' words word
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case "$path $word" in
      ' '[a-z]*) path=$word ;;
      'scene '[a-z]*) path="scene $word" ;;
    esac
  done
  case $path in
{}    *) words='{}' ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _rcbctl rcbctl
)",
                     cases, words(app));
}

void append_fish(const CLI::App& app, const std::string& condition, std::string& out) {
  for (const CLI::App* command : children(app)) {
    out += fmt::format("complete -c rcbctl -n '{}' -f -a {} -d '{}'\n", condition, command->get_name(),
                       command->get_description());
    const std::string inside = "__fish_seen_subcommand_from " + command->get_name();
    for (const CLI::Option* option : command->get_options())
      for (const std::string& name : option->get_lnames())
        out += fmt::format("complete -c rcbctl -n '{}' -l {}\n", inside, name);
    append_fish(*command, inside, out);
  }
}

std::string fish(const CLI::App& app) {
  std::string out = "# rcbctl completion for fish: rcbctl completion fish | source\n";
  for (const CLI::Option* option : app.get_options())
    for (const std::string& name : option->get_lnames()) out += fmt::format("complete -c rcbctl -l {}\n", name);
  append_fish(app, "__fish_use_subcommand", out);
  return out;
}

}  // namespace

void add_completion_command(CLI::App& app, Context& context) {
  auto shell = std::make_shared<std::string>();
  CLI::App* command = add_command(
      app, context,
      {"completion", "Prints a completion script",
       "  source <(rcbctl completion bash)\n  source <(rcbctl completion zsh)\n  rcbctl completion fish | source"},
      [shell, &app, &context]() -> Status {
        std::string script = *shell == "fish" ? fish(app) : bash(app);
        // zsh runs bash's completions.
        if (*shell == "zsh")
          script = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n" + script;
        if (context.json)
          print_json({{"shell", *shell}, {"script", script}});
        else
          print_line(script);
        return {};
      });
  command->add_option("SHELL", *shell, "bash, zsh or fish")->required()->check(CLI::IsMember({"bash", "zsh", "fish"}));
}

}  // namespace rcb::cli
