#include "cli/option_uses.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>

namespace gld {
namespace {

using Condition = OptionUse::Condition;

bool begins_with(const std::string& text, const std::string& beginning) {
  return text.compare(0, beginning.size(), beginning) == 0;
}

std::string group_of(const std::string& key) { return key.substr(0, key.rfind('.') + 1); }

std::string name_of(const std::string& key) { return key.substr(key.rfind('.') + 1); }

// Looks for that of the same group first. Returns null where there is none.
const OptionDescription* needed_option(const std::vector<OptionDescription>& options, const std::string& key,
                                       const std::string& name) {
  const OptionDescription* any = nullptr;
  for (const auto& option : options) {
    if (option.key == group_of(key) + name) return &option;
    if (any == nullptr && name_of(option.key) == name) any = &option;
  }
  return any;
}

bool holds(const OptionUse& use, const std::string& value) {
  const bool found = std::find(use.values.begin(), use.values.end(), value) != use.values.end();
  return found == (use.condition == Condition::kOneOf);
}

}  // namespace

const std::vector<OptionUse>& option_uses() {
  static const std::vector<OptionUse> uses{
      {"eval", "synthetic", "scenes", Condition::kOneOf, {""}, "drawn rooms in the place of --scenes"},
      {"eval", "generator.seed", "", Condition::kOneOf, {}, "--synthetic-seed in its place"},
      {"eval", "generator.scene_count", "", Condition::kOneOf, {}, "--synthetic in its place"},
      {"eval", "generator.", "scenes", Condition::kOneOf, {""}, "drawn rooms in the place of --scenes"},
      {"eval", "pose_model", "poses", Condition::kNoneOf, {"none"}, "a --poses other than none"},
      {"eval",
       "solver.evaluations",
       "solver",
       Condition::kNoneOf,
       {"bs32", "dp54", "rodas3"},
       "a --solver of fixed steps (an adaptive one has --solver.tolerance)"},
      {"eval", "schedule_file", "schedule", Condition::kOneOf, {"file"}, "--schedule file"},
      {"eval",
       "solver.tolerance",
       "solver",
       Condition::kOneOf,
       {"bs32", "dp54", "rodas3"},
       "an adaptive --solver"},
      {"eval",
       "max_evaluations",
       "solver",
       Condition::kOneOf,
       {"bs32", "dp54", "rodas3"},
       "an adaptive --solver"},
      {"eval",
       "diffusion",
       "solver",
       Condition::kOneOf,
       {"euler_maruyama", "stochastic_heun"},
       "a stochastic --solver"},
      {"eval",
       "diffusion_strength",
       "solver",
       Condition::kOneOf,
       {"euler_maruyama", "stochastic_heun"},
       "a stochastic --solver"},
      {"eval",
       "noise_seed",
       "solver",
       Condition::kOneOf,
       {"euler_maruyama", "stochastic_heun"},
       "a stochastic --solver"},
      {"eval",
       "guidance_interval",
       "guidance_scale",
       Condition::kNoneOf,
       {"1"},
       "a --guidance-scale other than 1"},
      {"eval",
       "views.",
       "source_frames",
       Condition::kOneOf,
       {""},
       "views that are drawn, without --source-frames"},
      {"eval", "views.fewest_sources", "source_counts", Condition::kOneOf, {""}, "--source-counts left out"},
      {"eval", "views.most_sources", "source_counts", Condition::kOneOf, {""}, "--source-counts left out"},
      {"plan", "out", "", Condition::kOneOf, {}, "gld sample, for gld plan writes nothing"},
      {"plan", "overwrite", "", Condition::kOneOf, {}, "gld sample, for gld plan writes nothing"},
      {"plan", "resume", "", Condition::kOneOf, {}, "gld sample, for gld plan writes nothing"},
      {"splat eval", "synthetic", "scenes", Condition::kOneOf, {""}, "drawn rooms in the place of --scenes"},
      {"splat eval", "generator.seed", "", Condition::kOneOf, {}, "--synthetic-seed in its place"},
      {"splat eval", "generator.scene_count", "", Condition::kOneOf, {}, "--synthetic in its place"},
      {"splat eval", "generator.", "scenes", Condition::kOneOf, {""}, "drawn rooms in the place of --scenes"},
      {"splat fit", "model", "features", Condition::kNoneOf, {"", "none"}, "--features"},
      {"splat fit", "solve.", "features", Condition::kNoneOf, {"", "none"}, "--features"},
      {"", "lpips.net", "lpips_backbone", Condition::kNoneOf, {""}, "--lpips-backbone and --lpips-heads"},
      {"", "lpips.version", "lpips_backbone", Condition::kNoneOf, {""}, "--lpips-backbone and --lpips-heads"},
      {"", "optimiser.momentum", "algorithm", Condition::kOneOf, {"muon"}, "--algorithm muon"},
      {"",
       "learning_rate.final",
       "schedule",
       Condition::kOneOf,
       {"linear", "cosine"},
       "--loop.learning-rate.schedule linear or cosine"},
      {"",
       "learning_rate.decay_start_step",
       "schedule",
       Condition::kOneOf,
       {"linear", "cosine"},
       "--loop.learning-rate.schedule linear or cosine"},
      {"",
       "learning_rate.decay_end_step",
       "schedule",
       Condition::kOneOf,
       {"linear", "cosine"},
       "--loop.learning-rate.schedule linear or cosine"},
      {"",
       "correspondence_blocks",
       "correspondence_weight",
       Condition::kNoneOf,
       {"0"},
       "a --correspondence-weight above 0"},
      {"train backbone",
       "objective.pixel_weights",
       "training",
       Condition::kNoneOf,
       {"head_only"},
       "a --training of the backbone"},
      {"train backbone",
       "objective.geometry_weights",
       "training",
       Condition::kNoneOf,
       {"head_only"},
       "a --training of the backbone"},
      {"train backbone",
       "objective.head_probability",
       "training",
       Condition::kNoneOf,
       {"head_only"},
       "a --training of the backbone"},
      {"train backbone",
       "objective.correspondence_weight",
       "training",
       Condition::kNoneOf,
       {"head_only"},
       "a --training of the backbone"},
      {"stats",
       "data.validation_folder",
       "",
       Condition::kOneOf,
       {},
       "gld train, for stats validates nothing"},
      {"stats", "data.validation_seed", "", Condition::kOneOf, {}, "gld train, for stats validates nothing"},
      {"stats",
       "data.validation_scenes",
       "",
       Condition::kOneOf,
       {},
       "gld train, for stats validates nothing"},
      {"stats",
       "data.validation_sources",
       "",
       Condition::kOneOf,
       {},
       "gld train, for stats validates nothing"},
      {"stats", "data.synthetic.", "scenes", Condition::kOneOf, {""}, "drawn rooms in the place of --scenes"},
  };
  return uses;
}

bool applies_to(const OptionUse& use, const Command& command, const std::string& key) {
  if (!begins_with(command.name, use.command)) return false;
  if (use.key.back() == '.') return begins_with(key, use.key);
  if (key == use.key) return true;
  const std::string end = "." + use.key;
  return key.size() > end.size() && key.compare(key.size() - end.size(), end.size(), end) == 0;
}

void refuse_without_effect(const Command& command, const std::vector<NamedOption>& named) {
  const auto options = describe_options(*command.options);
  for (const NamedOption& option : named) {
    for (const OptionUse& use : option_uses()) {
      if (!applies_to(use, command, option.key)) continue;
      std::string found = "none";
      if (!use.needs.empty()) {
        const OptionDescription* needed = needed_option(options, option.key, use.needs);
        if (needed == nullptr || holds(use, needed->default_value)) continue;
        if (!needed->default_value.empty()) found = needed->key + " " + needed->default_value;
      }
      fail({option.flag, use.what + ", without which nothing looks at it", found,
            "change that, or leave " + option.flag + " out"});
    }
  }
}

}  // namespace gld
