#include "cli/completion_script.h"

#include "cli/help_text.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr size_t kLongestNote = 80;  // characters that zsh and fish show beside a name

// What can stand behind a command's name, level by level.
struct Level {
  std::string name;                      // "gld train level"
  std::vector<const Command*> commands;  // its subcommands
  std::vector<Flag> flags;
  bool has_options = false;
  bool takes_files = false;            // arguments without a flag
  std::vector<std::string> arguments;  // instead of files: the words that they may be
};

// "bash|zsh|fish" is a choice of words; "FILE|FOLDER" stands for names of files.
std::vector<std::string> words_of_usage(const std::string& usage) {
  std::vector<std::string> words;
  if (usage.find_first_not_of("abcdefghijklmnopqrstuvwxyz|") != std::string::npos) return words;
  for (size_t begin = 0; begin < usage.size();) {
    const size_t bar = std::min(usage.find('|', begin), usage.size());
    words.push_back(usage.substr(begin, bar - begin));
    begin = bar + 1;
  }
  return words;
}

std::vector<const Command*> pointers(const std::vector<Command>& commands) {
  std::vector<const Command*> all;
  all.reserve(commands.size());
  for (const auto& command : commands) all.push_back(&command);
  return all;
}

std::vector<Level> levels_of(const std::vector<Command>& commands, const OutermostTypes& outermost) {
  std::vector<Level> levels{{"gld", pointers(commands), {}, false, false, {}}};
  for (const Command* command : all_levels(commands)) {
    Level level{"gld " + command->name,
                pointers(command->subcommands),
                offered_flags(*command, outermost),
                command->options != nullptr,
                false,
                words_of_usage(command->arguments.usage)};
    level.takes_files = command->arguments.maximum > 0 && level.arguments.empty();
    levels.push_back(level);
  }
  return levels;
}

// The text is put in single quotes, in which bash and zsh take all but the quote itself as it is.
std::string quoted(const std::string& text) {
  std::string result = "'";
  for (const char letter : text) result += letter == '\'' ? std::string("'\\''") : std::string(1, letter);
  return result + "'";
}

// fish takes a backslash as one within single quotes too.
std::string fish_quoted(const std::string& text) {
  std::string result = "'";
  for (const char letter : text) {
    if (letter == '\'' || letter == '\\') result += '\\';
    result += letter;
  }
  return result + "'";
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : " ") + word;
  return text;
}

struct NotedName {
  std::string name;
  std::string note;
};

// Returns the flags that a level is offered, those of every command last.
std::vector<NotedName> offered_flags(const Level& level) {
  std::vector<NotedName> names;
  for (const Flag& flag : level.flags) {
    const bool on = flag.is_switch() && flag.default_value == "true";
    names.push_back(
        {on ? "--no-" + flag.shown.substr(2) : flag.shown, first_clause(flag.help, kLongestNote)});
  }
  if (level.has_options) {
    for (const auto& flag : common_flags()) names.push_back({flag.name, flag.help});
  }
  names.push_back({"--help", "the usual options"});
  names.push_back({"--help-all", "every option"});
  if (level.name == "gld") names.push_back({"--version", "which program this is"});
  return names;
}

std::vector<NotedName> offered_commands(const Level& level) {
  std::vector<NotedName> names;
  for (const Command* command : level.commands) names.push_back({last_word(*command), command->summary});
  if (level.name == "gld") names.push_back({"help", "The options of a command, or the manual (--man)"});
  return names;
}

// Returns patterns of a case for what stands before the cursor: the level, a blank, a spelling of the flag.
std::string patterns(const Level& level, const Flag& flag) {
  std::string text = quoted(level.name + " " + flag.shown);
  if (flag.has_short_form()) text += "|" + quoted(level.name + " " + flag.full);
  return text;
}

bool is_number(const Flag& flag) {
  return flag.type.find("integer") != std::string::npos || flag.type.find("real") != std::string::npos;
}

// Returns the pattern of every command but the outermost, which is what walks down from "gld".
std::string command_patterns(const std::vector<Level>& levels) {
  std::string text;
  for (const Level& level : levels) {
    if (level.name != "gld") text += (text.empty() ? "" : "|") + quoted(level.name);
  }
  return text;
}

// How a script of bash or zsh ends a case: what stands around the names of a choice, and what is done else.
struct Endings {
  std::string before_values, after_values, files, nothing;
};

// Returns the cases that bash and zsh have in common: what follows a flag.
std::string cases_of_values(const std::vector<Level>& levels, const Endings& endings) {
  std::string numbers, texts, text;
  const auto add = [](const std::string& pattern, std::string& to) {
    to += (to.empty() ? "" : "|") + pattern;
  };
  for (const Level& level : levels) {
    if (level.has_options) {
      add(quoted(level.name + " --config"), texts);
      add(quoted(level.name + " --set"), numbers);
    }
    for (const Flag& flag : level.flags) {
      if (flag.is_switch()) continue;
      if (flag.values.empty()) {
        add(patterns(level, flag), is_number(flag) ? numbers : texts);
      } else {
        text += "    " + patterns(level, flag) + ") " + endings.before_values + joined(flag.values) +
                endings.after_values + " ;;\n";
      }
    }
  }
  if (!texts.empty()) text += "    " + texts + ") " + endings.files + " ;;\n";
  if (!numbers.empty()) text += "    " + numbers + ") " + endings.nothing + " ;;\n";
  return text;
}

std::string names_of(const std::vector<NotedName>& noted) {
  std::vector<std::string> names;
  names.reserve(noted.size());
  for (const auto& one : noted) names.push_back(one.name);
  return joined(names);
}

// The text is for _describe of zsh, which divides name and note at the first colon without a backslash.
std::string described(const std::vector<NotedName>& noted) {
  std::string text;
  for (const auto& one : noted) {
    std::string note;
    for (const char letter : one.note) note += letter == ':' ? std::string("\\:") : std::string(1, letter);
    text += " " + quoted(one.name + ":" + note);
  }
  return text;
}

constexpr const char* kMadeBy = ": completes gld; made by 'gld completion ";

}  // namespace

std::string bash_completion(const std::vector<Command>& commands, const OutermostTypes& outermost) {
  const auto levels = levels_of(commands, outermost);
  std::string text = std::string("# bash") + kMadeBy + "bash'\n_gld() {\n";
  text +=
      "  local level=gld current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} i\n"
      "  COMPREPLY=()\n"
      "  # bash divides --flag=value into three words.\n"
      "  if [[ $current == '=' ]]; then\n"
      "    current=\n"
      "  elif [[ $before == '=' && $COMP_CWORD -ge 2 ]]; then\n"
      "    before=${COMP_WORDS[COMP_CWORD-2]}\n"
      "  fi\n"
      "  for ((i = 1; i < COMP_CWORD; i++)); do\n"
      "    case \"$level ${COMP_WORDS[i]}\" in\n"
      "    " +
      command_patterns(levels) +
      ") level=\"$level ${COMP_WORDS[i]}\" ;;\n"
      "    'gld help') ;;\n"
      "    *) break ;;\n"
      "    esac\n"
      "  done\n"
      "  case \"$level $before\" in\n";
  text += cases_of_values(
      levels, {"COMPREPLY=($(compgen -W '", "' -- \"$current\")); return", "_gld_files; return", "return"});
  text += "  esac\n  case $level in\n";
  for (const Level& level : levels) {
    text += "    " + quoted(level.name) + ")\n      if [[ $current == -* ]]; then\n";
    text +=
        "        COMPREPLY=($(compgen -W " + quoted(names_of(offered_flags(level))) + " -- \"$current\"))\n";
    const auto words = level.arguments.empty() ? names_of(offered_commands(level)) : joined(level.arguments);
    if (!words.empty()) {
      text += "      else\n        COMPREPLY=($(compgen -W " + quoted(words) + " -- \"$current\"))\n";
    } else if (level.takes_files) {
      text += "      else\n        _gld_files\n";
    }
    text += "      fi ;;\n";
  }
  text +=
      "  esac\n"
      "}\n"
      "_gld_files() {\n"
      "  # Names may hold blanks; compopt is there only while bash completes.\n"
      "  mapfile -t COMPREPLY < <(compgen -f -- \"$current\")\n"
      "  compopt -o filenames 2>/dev/null\n"
      "  return 0\n"
      "}\n"
      "complete -F _gld gld\n";
  return text;
}

std::string zsh_completion(const std::vector<Command>& commands, const OutermostTypes& outermost) {
  const auto levels = levels_of(commands, outermost);
  std::string text = std::string("#compdef gld\n# zsh") + kMadeBy + "zsh'\n_gld() {\n";
  text +=
      "  local level=gld before=$words[CURRENT-1] i\n"
      "  local -a names\n"
      "  for ((i = 2; i < CURRENT; i++)); do\n"
      "    case \"$level $words[i]\" in\n"
      "    " +
      command_patterns(levels) +
      ") level=\"$level $words[i]\" ;;\n"
      "    'gld help') ;;\n"
      "    *) break ;;\n"
      "    esac\n"
      "  done\n"
      "  case \"$level $before\" in\n";
  text += cases_of_values(levels, {"compadd -- ", "; return", "_files; return", "return"});
  text += "  esac\n  case $level in\n";
  for (const Level& level : levels) {
    text += "    " + quoted(level.name) + ")\n      if [[ $words[CURRENT] == -* ]]; then\n";
    text += "        names=(" + described(offered_flags(level)) + ")\n        _describe option names\n";
    const auto subcommands = offered_commands(level);
    if (!subcommands.empty()) {
      text += "      else\n        names=(" + described(subcommands) + ")\n        _describe command names\n";
    } else if (!level.arguments.empty()) {
      text += "      else\n        compadd -- " + joined(level.arguments) + "\n";
    } else if (level.takes_files) {
      text += "      else\n        _files\n";
    }
    text += "      fi ;;\n";
  }
  // As a file of fpath it is the body of _gld itself; sourced, it has to be named.
  text += "  esac\n}\nif [[ $funcstack[1] == _gld ]]; then _gld \"$@\"; else compdef _gld gld; fi\n";
  return text;
}

std::string fish_completion(const std::vector<Command>& commands, const OutermostTypes& outermost) {
  const auto levels = levels_of(commands, outermost);
  std::string names;
  for (const Level& level : levels) {
    if (level.name != "gld") names += " " + fish_quoted(level.name);
  }
  std::string text = std::string("# fish") + kMadeBy + "fish'\n";
  text +=
      "function __gld_at\n"
      "  set -l level gld\n"
      "  for word in (commandline -opc)[2..-1]\n"
      "    switch \"$level $word\"\n"
      "      case" +
      names +
      "\n"
      "        set level \"$level $word\"\n"
      "      case 'gld help'\n"
      "        continue\n"
      "      case '*'\n"
      "        break\n"
      "    end\n"
      "  end\n"
      "  test \"$level\" = \"$argv[1]\"\n"
      "end\n"
      "complete -c gld -f\n";
  for (const Level& level : levels) {
    const std::string begin = "complete -c gld -n " + fish_quoted("__gld_at " + fish_quoted(level.name));
    for (const auto& command : offered_commands(level)) {
      text += begin + " -a " + fish_quoted(command.name) + " -d " + fish_quoted(command.note) + "\n";
    }
    if (!level.arguments.empty()) text += begin + " -a " + fish_quoted(joined(level.arguments)) + "\n";
    if (level.takes_files) text += begin + " -F\n";
    for (const auto& offered : offered_flags(level)) {
      const auto flag = std::find_if(level.flags.begin(), level.flags.end(),
                                     [&](const Flag& candidate) { return candidate.shown == offered.name; });
      std::string takes;
      if (flag != level.flags.end() && !flag->is_switch()) {
        takes = !flag->values.empty() ? " -x -a " + fish_quoted(joined(flag->values))
                : is_number(*flag)    ? " -x"
                                      : " -r -F";
      } else if (offered.name == "--config") {
        takes = " -r -F";
      } else if (offered.name == "--set") {
        takes = " -x";
      }
      text += fmt::format("{} -l {}{} -d {}\n", begin, fish_quoted(offered.name.substr(2)), takes,
                          fish_quoted(offered.note));
    }
  }
  return text;
}

}  // namespace gld
