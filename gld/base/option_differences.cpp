#include "gld/base/option_differences.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/run_journal.h"
#include "gld/base/yaml_text.h"

#include <algorithm>
#include <map>

#include <yaml-cpp/yaml.h>

namespace gld {
namespace {

// Collects the leaves of nested maps under their dotted keys, as YAML on one line.
void flatten(const YAML::Node& node, const std::string& prefix, std::map<std::string, std::string>& leaves) {
  for (const auto& entry : node) {
    if (!entry.first.IsScalar()) continue;
    const std::string key = prefix + entry.first.Scalar();
    if (entry.second.IsMap()) {
      flatten(entry.second, key + ".", leaves);
      continue;
    }
    YAML::Emitter emitter;
    emitter << YAML::Flow << entry.second;
    leaves[key] = emitter.c_str();
  }
}

}  // namespace

std::string difference_text(const OptionDifference& difference) {
  return difference.key + " " + difference.now + " (it was " + difference.before + ")";
}

std::vector<OptionDifference> differences_from(const std::string& yaml, const std::string& where,
                                               const OptionsGroup& options, const OptionsGroup* defaults) {
  std::map<std::string, std::string> before, now;
  if (defaults != nullptr) flatten(parse_yaml(to_yaml(*defaults), where), "", before);
  flatten(parse_yaml(yaml, where), "", before);
  flatten(parse_yaml(to_yaml(options), where), "", now);
  std::vector<OptionDifference> differences;
  for (const auto& [key, value] : now) {
    const auto old = before.find(key);
    if (old != before.end() && old->second != value) differences.push_back({key, old->second, value});
  }
  return differences;
}

bool is_beside_the_result(const std::string& key) {
  const auto& names = options_beside_the_result();
  return std::find(names.begin(), names.end(), key.substr(0, key.find('.'))) != names.end();
}

void refuse_other_options(const std::filesystem::path& run, const OptionsGroup& options,
                          const OptionsGroup& defaults, const std::vector<std::string>& may_differ) {
  const auto file = run / kRunConfiguration;
  if (!std::filesystem::is_regular_file(file)) return;
  for (const auto& difference : differences_from(read_file(file), file.string(), options, &defaults)) {
    if (is_beside_the_result(difference.key)) continue;
    if (std::find(may_differ.begin(), may_differ.end(), difference.key) != may_differ.end()) continue;
    fail({"--resume", "the options of the run, which has " + difference.key + " " + difference.before,
          difference.now, "leave it as it was, or begin again with --overwrite"});
  }
}

}  // namespace gld
