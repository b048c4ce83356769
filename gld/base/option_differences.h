#pragma once

#include "gld/base/options.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Returns to_yaml() of configuration.h without those fields of the outermost group.
std::string to_yaml_without(const OptionsGroup& options, const std::vector<std::string>& leave_out);

// An option that has another value than in a YAML text that to_yaml() wrote; values as YAML.
struct OptionDifference {
  std::string key;  // "group.field"
  std::string before;
  std::string now;
};
// Returns "loop.seed 4 (it was 3)", for example.
std::string difference_text(const OptionDifference& difference);
// Keys that only one of the two has are of a program of another version, which had other options: what it did without
// one is what defaults, as constructed, have of it. Without defaults those keys are left out. where names the text.
std::vector<OptionDifference> differences_from(const std::string& yaml, const std::string& where,
                                               const OptionsGroup& options,
                                               const OptionsGroup* defaults = nullptr);

// Returns whether the option of this dotted key, or the group that it is in, is one of options_beside_the_result().
bool is_beside_the_result(const std::string& key);

// Throws Error naming the first option that has another value than in the config.yaml of the run in this folder, which
// is to go on with --resume: another result would come out. Left out are options_beside_the_result() and those of
// may_differ. A folder without the file is of a run that was killed before it was written. defaults as above.
void refuse_other_options(const std::filesystem::path& run, const OptionsGroup& options,
                          const OptionsGroup& defaults, const std::vector<std::string>& may_differ = {});

}  // namespace gld
