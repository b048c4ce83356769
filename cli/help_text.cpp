#include "cli/help_text.h"

#include <algorithm>
#include <sstream>

namespace gld {
namespace {

constexpr size_t kWidth = 110;      // columns of a line
constexpr size_t kWidestName = 34;  // of the column of flags in the short help
constexpr size_t kHelpColumn = 44;  // of the full help
constexpr size_t kMostOutermost = 12;

// Where a run writes, how it goes about it and what it prints: the same in every command, and shown last.
const std::vector<std::string>& keys_of_every_run() {
  static const std::vector<std::string> keys{"seed", "precision", "device", "threads",
                                             "out",  "overwrite", "resume", "json"};
  return keys;
}

// Returns a short word for what a flag takes.
std::string value_word(const Flag& flag) {
  constexpr size_t kLongestChoice = 24;
  if (flag.is_switch()) return "";
  if (flag.type == "integer") return "N";
  if (flag.type == "real") return "X";
  if (flag.type == "list of integer") return "N,...";
  if (flag.type == "list of real") return "X,...";
  if (flag.type == "list of text") return "TEXT,...";
  if (flag.type == "text") return "TEXT";
  return flag.type.size() <= kLongestChoice ? flag.type : "NAME";
}

const Flag* find_flag(const std::vector<Flag>& flags, const std::string& key) {
  const auto found =
      std::find_if(flags.begin(), flags.end(), [&](const Flag& flag) { return flag.key == key; });
  return found == flags.end() ? nullptr : &*found;
}

struct ShownGroup {
  std::string heading;
  std::vector<const Flag*> flags;
};

std::vector<ShownGroup> shown_groups(const Command& command, const std::vector<Flag>& flags) {
  std::vector<ShownGroup> groups;
  const auto& last = keys_of_every_run();
  std::vector<std::string> named;
  for (const auto& usual : command.usual) {
    ShownGroup group{usual.heading, {}};
    for (const auto& key : usual.keys) {
      named.push_back(key);
      if (const Flag* flag = find_flag(flags, key)) group.flags.push_back(flag);
    }
    groups.push_back(group);
  }
  if (command.usual.empty()) {
    // All of them where that is few; else those outside groups, which are the command's own.
    const auto is_last = [&](const Flag& flag) {
      return std::find(last.begin(), last.end(), flag.key) != last.end();
    };
    std::vector<const Flag*> all, outermost;
    for (const Flag& flag : flags) {
      if (is_last(flag)) continue;
      all.push_back(&flag);
      if (flag.key.find('.') == std::string::npos && outermost.size() < kMostOutermost)
        outermost.push_back(&flag);
    }
    groups.push_back({"Options", all.size() <= kMostOutermost ? all : outermost});
  }
  ShownGroup of_run{"Run", {}};
  for (const auto& key : last) {
    if (std::find(named.begin(), named.end(), key) != named.end()) continue;
    if (const Flag* flag = find_flag(flags, key)) of_run.flags.push_back(flag);
  }
  groups.push_back(of_run);
  groups.erase(std::remove_if(groups.begin(), groups.end(),
                              [](const ShownGroup& group) { return group.flags.empty(); }),
               groups.end());
  return groups;
}

std::string name_and_word(const Flag& flag) {
  const std::string word = value_word(flag);
  return shown_name(flag) + (word.empty() ? "" : " " + word);
}

// Returns a default that says something beside what is there.
std::string default_note(const Flag& flag) {
  if (flag.is_switch() || flag.default_value.empty() || flag.default_value.size() > 24) return "";
  return " [" + flag.default_value + "]";
}

std::string short_line(const Flag& flag, size_t column) {
  std::string line = "  " + name_and_word(flag);
  line += line.size() + 2 <= column ? std::string(column - line.size(), ' ') : "  ";
  const std::string note = default_note(flag);
  const size_t used = line.size() + note.size();
  return line + first_clause(flag.help, used < kWidth ? kWidth - used : 0) + note + "\n";
}

// Returns text in lines that begin at a column; the first line is there already.
std::string wrapped(const std::string& text, size_t column) {
  std::istringstream words(text);
  std::string result, word;
  size_t at = column;
  while (words >> word) {
    if (at > column && at + 1 + word.size() > kWidth) {
      result += "\n" + std::string(column, ' ');
      at = column;
    }
    if (at > column) {
      result += " ";
      ++at;
    }
    result += word;
    at += word.size();
  }
  return result + "\n";
}

std::string full_line(const std::string& name, const std::string& type, const std::string& help) {
  std::string line = "  " + name + (type.empty() ? "" : " " + type);
  if (line.size() + 2 > kHelpColumn)
    return line + "\n" + std::string(kHelpColumn, ' ') + wrapped(help, kHelpColumn);
  return line + std::string(kHelpColumn - line.size(), ' ') + wrapped(help, kHelpColumn);
}

// Returns "Example: gld sample ...", the line that a description begins with.
std::string example_line(const Command& command) {
  if (command.description.rfind("Example: ", 0) != 0) return "";
  return command.description.substr(0, command.description.find('\n')) + "\n";
}

}  // namespace

std::string usage_line(const Command& command) {
  return "gld " + command.name + (command.arguments.usage.empty() ? "" : " " + command.arguments.usage) +
         (command.options ? " [options]" : "");
}

std::string type_of_value(const Flag& flag) {
  if (flag.is_switch()) return "";
  std::string text = flag.type;
  if (!flag.range.empty()) text += " " + flag.range;
  if (!flag.default_value.empty()) text += "=" + flag.default_value;
  return text;
}

std::string shown_name(const Flag& flag) {
  if (!flag.is_switch() || flag.default_value != "true") return flag.shown;
  return "--[no-]" + flag.shown.substr(2);
}

std::string first_clause(const std::string& help, size_t most) {
  if (help.size() <= most) return help;
  for (const char* end : {"; ", ": ", " (", ", "}) {
    const size_t at = help.rfind(end, most);
    // A clause that says hardly anything is no better than words cut off.
    if (at == std::string::npos || at > most || at * 3 < most) continue;
    // What "0" means is what was cut off.
    const std::string clause = help.substr(0, at), value = "; 0";
    const bool of_a_value = clause.size() > value.size() &&
                            clause.compare(clause.size() - value.size(), value.size(), value) == 0;
    return clause.substr(0, clause.size() - (of_a_value ? value.size() : 0));
  }
  if (most <= 4) return "";
  const size_t space = help.rfind(' ', most - 4);
  return help.substr(0, space == std::string::npos ? most - 4 : space) + " ...";
}

std::string short_help(const Command& command, const OutermostTypes& outermost) {
  std::string text = command.summary + "\n" + example_line(command) + "Usage: " + usage_line(command) + "\n";
  if (!command.options) return text + (command.description.empty() ? "" : command.description + "\n");
  const auto flags = offered_flags(command, outermost);
  const auto groups = shown_groups(command, flags);
  size_t column = 0, shown = 0;
  for (const auto& group : groups) {
    for (const Flag* flag : group.flags) {
      column = std::max(column, name_and_word(*flag).size() + 4);
      ++shown;
    }
  }
  column = std::min(column, kWidestName);
  for (const auto& group : groups) {
    text += group.heading + ":\n";
    for (const Flag* flag : group.flags) text += short_line(*flag, column);
  }
  const std::string more = "gld " + command.name + " --help-all";
  // --config, --set and --quiet are told of in the full help.
  const size_t left = flags.size() - shown + common_flags().size();
  return text + std::to_string(left) + " more options, with type, range and default: " + more + "\n";
}

std::string full_help(const Command& command, const OutermostTypes& outermost) {
  std::string text = command.summary + "\n";
  if (!command.description.empty()) text += "\n" + command.description + "\n";
  text += "\nUsage: " + usage_line(command) + "\n";
  if (!command.options) return text;
  for (const auto& group : group_flags(command, outermost)) {
    if (group.key.empty()) {
      text += "\nOptions:\n";
      text += full_line("--help", "", "the usual options; --help-all: every one");
      for (const auto& flag : common_flags()) text += full_line(flag.name, flag.value, flag.help);
    } else {
      std::string heading = "--" + group.key;
      std::replace(heading.begin(), heading.end(), '_', '-');
      text += "\n" + heading + ".*" + (group.help.empty() ? "" : ": " + group.help) + "\n";
    }
    for (const Flag& flag : group.flags) text += full_line(shown_name(flag), type_of_value(flag), flag.help);
  }
  return text;
}

}  // namespace gld
