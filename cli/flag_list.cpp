#include "cli/flag_list.h"

#include "cli/option_uses.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"

#include <algorithm>

namespace gld {
namespace {

std::string last_part(const std::string& key) { return key.substr(key.rfind('.') + 1); }

std::string group_key(const std::string& key) {
  const size_t dot = key.rfind('.');
  return dot == std::string::npos ? "" : key.substr(0, dot);
}

void add_outermost_types(const std::vector<Command>& commands, OutermostTypes& types) {
  for (const auto& command : commands) {
    add_outermost_types(command.subcommands, types);
    if (!command.options) continue;
    for (const auto& option : describe_options(*command.options)) {
      if (option.key.find('.') == std::string::npos) types[option.key].insert(option.type + option.range);
    }
  }
}

// Returns what a choice may be: "a|b|c". Other types have no bar.
std::vector<std::string> values_of(const std::string& type) {
  if (type == "true|false" || type.find('|') == std::string::npos) return {};
  std::vector<std::string> values;
  for (size_t begin = 0; begin != std::string::npos;) {
    const size_t bar = type.find('|', begin);
    values.push_back(type.substr(begin, bar - begin));
    begin = bar == std::string::npos ? bar : bar + 1;
  }
  return values;
}

// This collects what visit() says of groups, which describe_options() leaves out.
class GroupHelp : public FieldVisitor {
 public:
  void boolean(const Field&, bool&) override {}
  void integer(const Field&, int64_t&, const IntegerRange&) override {}
  void real(const Field&, double&, const RealRange&) override {}
  void text(const Field&, std::string&) override {}
  void choice(const Field&, int&, const std::vector<std::string>&) override {}
  void integers(const Field&, std::vector<int64_t>&, const IntegerRange&) override {}
  void reals(const Field&, std::vector<double>&, const RealRange&) override {}
  void texts(const Field&, std::vector<std::string>&) override {}
  void group(const Field& field, OptionsGroup& value) override {
    const std::string outer = prefix_;
    prefix_ += (outer.empty() ? "" : ".") + field.name;
    help[prefix_] = field.help;
    value.visit(*this);
    prefix_ = outer;
  }

  std::map<std::string, std::string> help;

 private:
  std::string prefix_;
};

void add_levels(const std::vector<Command>& commands, std::vector<const Command*>& all) {
  for (const auto& command : commands) {
    all.push_back(&command);
    add_levels(command.subcommands, all);
  }
}

}  // namespace

OutermostTypes outermost_types(const std::vector<Command>& commands) {
  OutermostTypes types;
  add_outermost_types(commands, types);
  return types;
}

std::vector<Flag> list_flags(const Command& command, const OutermostTypes& outermost) {
  if (!command.options) return {};
  const auto descriptions = describe_options(*command.options);
  std::map<std::string, int> uses_of_last_part{
      {"config", 1}, {"set", 1}, {"help", 1}, {"help_all", 1}, {"quiet", 1}};
  for (const auto& description : descriptions) {
    const std::string last = last_part(description.key);
    ++uses_of_last_part[last];
    // "--tolerance" is what gld sample calls so, and not the solver's where a command has that alone.
    const auto other = outermost.find(last);
    if (last != description.key && other != outermost.end() &&
        other->second.count(description.type + description.range) == 0) {
      ++uses_of_last_part[last];
    }
  }
  std::vector<Flag> flags;
  flags.reserve(descriptions.size());
  for (const auto& description : descriptions) {
    const std::string last = last_part(description.key);
    const bool has_short_form = last != description.key && uses_of_last_part.at(last) == 1;
    flags.push_back({description.key, "--" + dashed_name(has_short_form ? last : description.key),
                     "--" + dashed_name(description.key), description.help, description.type,
                     description.range, description.default_value, values_of(description.type)});
  }
  return flags;
}

std::vector<Flag> offered_flags(const Command& command, const OutermostTypes& outermost) {
  std::vector<Flag> flags = list_flags(command, outermost);
  const auto is_of_no_use = [&](const Flag& flag) {
    return std::any_of(option_uses().begin(), option_uses().end(), [&](const OptionUse& use) {
      return use.needs.empty() && applies_to(use, command, flag.key);
    });
  };
  flags.erase(std::remove_if(flags.begin(), flags.end(), is_of_no_use), flags.end());
  return flags;
}

std::vector<FlagGroup> group_flags(const Command& command, const OutermostTypes& outermost) {
  std::vector<FlagGroup> groups;
  if (!command.options) return groups;
  GroupHelp said;
  command.options->visit(said);
  groups.push_back({"", "", {}});
  for (const Flag& flag : offered_flags(command, outermost)) {
    const std::string key = group_key(flag.key);
    auto group = std::find_if(groups.begin(), groups.end(),
                              [&](const FlagGroup& candidate) { return candidate.key == key; });
    if (group == groups.end()) group = groups.insert(groups.end(), {key, said.help[key], {}});
    group->flags.push_back(flag);
  }
  return groups;
}

const std::vector<CommonFlag>& common_flags() {
  static const std::vector<CommonFlag> flags{
      {"--config", "FILE", "YAML file of options, applied before --set and flags"},
      {"--set", "KEY=VALUE", "set one option, applied after --config; may be repeated"},
      {"--quiet", "", "print warnings and errors only"}};
  return flags;
}

std::vector<const Command*> all_levels(const std::vector<Command>& commands) {
  std::vector<const Command*> all;
  add_levels(commands, all);
  return all;
}

std::string last_word(const Command& command) { return command.name.substr(command.name.rfind(' ') + 1); }

}  // namespace gld
