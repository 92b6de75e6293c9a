// completion: scripts for bash, zsh and fish, generated from the commands.
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "client/cli/app.hpp"
#include "client/cli/print/output.hpp"
#include "client/launch/reach.hpp"

namespace rcb::cli {
namespace {

std::vector<const CLI::App*> children(const CLI::App& app) { return app.get_subcommands(nullptr); }

std::string option_words(const CLI::App& app) {
  std::string text;
  for (const CLI::Option* option : app.get_options())
    for (const std::string& name : option->get_lnames()) text += "--" + name + " ";
  return text;
}

std::string words(const CLI::App& app) {
  std::string text;
  for (const CLI::App* command : children(app)) text += command->get_name() + " ";
  return text + option_words(app);
}

// Appends the words that may follow each command, as branches of a shell's case.
void append_cases(const CLI::App& app, const std::string& path, const std::string& global, std::string& out) {
  for (const CLI::App* command : children(app)) {
    const std::string name = path + command->get_name();
    out += fmt::format("    '{}') words='{}{}' ;;\n", name, words(*command), global);
    append_cases(*command, name + " ", global, out);
  }
}

// Commands whose first argument is an existing scene; the script asks the service for the names.
std::vector<std::string> scene_takers(const CLI::App& app, const std::string& path = "") {
  std::vector<std::string> names;
  for (const CLI::App* command : children(app)) {
    const std::string name = path + command->get_name();
    if (name != "scene create" && command->get_option_no_throw("NAME") != nullptr) names.push_back(name);
    for (std::string& below : scene_takers(*command, name + " ")) names.push_back(std::move(below));
  }
  return names;
}

// Options that take a value.
void append_valued(const CLI::App& app, std::set<std::string>& out) {
  for (const CLI::Option* option : app.get_options())
    if (option->nonpositional() && option->get_items_expected_max() != 0)
      for (const std::string& name : option->get_lnames()) out.insert("--" + name);
  for (const CLI::App* command : children(app)) append_valued(*command, out);
}

std::string bash(const CLI::App& app) {
  std::string cases;
  append_cases(app, "", option_words(app), cases);
  std::set<std::string> valued{"-n"};
  append_valued(app, valued);
  // The script splits the line itself, since the shell splits words at the colon of unix:PATH.
  return fmt::format(R"(# rcbctl completion for bash: source <(rcbctl completion bash)
_rcbctl() {{
  local line=${{COMP_LINE:0:COMP_POINT}} current='' path='' words='' value='' endpoint='' names=0 i n
  set -f
  local typed=($line)
  set +f
  n=${{#typed[@]}}
  if [[ $line != *' ' ]]; then current=${{typed[n-1]}}; n=$((n - 1)); fi
  for ((i = 1; i < n; i++)); do
    if [[ $value == --endpoint ]]; then endpoint=${{typed[i]}}; fi
    if [[ -n $value ]]; then value=''; continue; fi
    case ${{typed[i]}} in
      --endpoint=*) endpoint=${{typed[i]#*=}} ;;
      {}) value=${{typed[i]}} ;;
      -*) ;;
      *) if [[ -z $path ]]; then path=${{typed[i]}}
         elif [[ $path == scene ]]; then path="scene ${{typed[i]}}"
         else names=$((names + 1)); fi ;;
    esac
  done
  if [[ -n $value ]]; then COMPREPLY=(); return; fi
  case $path in
{}    *) words='{}' ;;
  esac
  case $path in
    '{}')
      if [[ $names == 0 && $current != -* ]]; then
        words=$(rcbctl completion scenes ${{endpoint:+--endpoint=$endpoint}} 2>/dev/null)
      fi ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _rcbctl rcbctl
)",
                     fmt::join(valued, "|"), cases, words(app), fmt::join(scene_takers(app), "'|'"));
}

// In quotes, in which fish knows two escapes.
std::string fish_quoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) {
    if (c == '\'' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + "'";
}

void append_fish(const CLI::App& app, const std::string& condition, std::string& out) {
  for (const CLI::App* command : children(app)) {
    out += fmt::format("complete -c rcbctl -n {} -f -a {} -d {}\n", fish_quoted(condition), command->get_name(),
                       fish_quoted(command->get_description()));
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
  std::vector<std::string> names = scene_takers(app);
  for (std::string& name : names) name = name.substr(name.rfind(' ') + 1);
  out += fmt::format(
      "complete -c rcbctl -n '__fish_seen_subcommand_from {}' -a '(rcbctl completion scenes 2>/dev/null)'\n",
      fmt::join(names, " "));
  return out;
}

// For the scripts: prints the scenes of the service, if it answers at once, else nothing.
Status print_scene_names(const Context& context) {
  constexpr double kSeconds = 1;
  std::vector<std::string> names;
  if (auto client = launch::reach(context.endpoint, "rcbctl completion", kSeconds))
    if (const auto reply = ask(*client, "scene.list", Json::object(), kSeconds))
      for (const Json& scene : reply->value("scenes", Json::array())) names.push_back(text_of(scene, "scene"));
  return show(context, {{"scenes", names}}, [&] {
    for (const std::string& name : names) print_line(name);
  });
}

}  // namespace

void add_completion_command(CLI::App& app, Context& context) {
  auto shell = std::make_shared<std::string>();
  CLI::App* command = add_command(
      app, context,
      {"completion", "Prints a completion script",
       "  source <(rcbctl completion bash)\n  source <(rcbctl completion zsh)\n  rcbctl completion fish | source",
       kServiceGroup},
      [shell, &app, &context]() -> Status {
        if (*shell == "scenes") return print_scene_names(context);
        std::string script = *shell == "fish" ? fish(app) : bash(app);
        // zsh can run bash's completions.
        if (*shell == "zsh")
          script = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n" + script;
        return show(context, {{"shell", *shell}, {"script", script}}, [&] { print_line(script); });
      });
  add_value(*command, "SHELL", *shell, kind::one_of("SHELL", {"bash", "zsh", "fish", "scenes"}),
            "bash, zsh or fish; scenes: the names of the scenes, for which these scripts ask")
      ->required();
}

}  // namespace rcb::cli
