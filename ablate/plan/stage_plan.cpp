#include "ablate/plan/stage_plan.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/option_differences.h"
#include "gld/base/sha256.h"
#include "models/bundle/bundle.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr size_t kKeyDigits = 16;
constexpr const char* kTrainBackboneCommand = "train backbone";
constexpr const char* kBenchPrefix = "bench ";
constexpr const char* kSampleBenchmark = "bench sample";  // the one that samples
constexpr int64_t kSmokeRepeats = 2;

std::string hash_key(const std::string& text) {
  Sha256 hash;
  hash.update(text);
  return hash.hex_digest().substr(0, kKeyDigits);
}

bool has_field(const OptionsGroup& options, const std::string& key) {
  const auto fields = describe_options(options);
  return std::any_of(fields.begin(), fields.end(), [&](const auto& field) { return field.key == key; });
}

// Returns the option that a stage's random numbers follow from: that of training, else of what is drawn. It is empty
// where there is none.
std::string seed_field(const OptionsGroup& options) {
  for (const char* key : {"loop.seed", "seed"}) {
    if (has_field(options, key)) return key;
  }
  return "";
}

int64_t integer_field(const OptionsGroup& options, const std::string& key) {
  for (const auto& field : describe_options(options)) {
    if (field.key == key) return std::stoll(field.default_value);
  }
  return 0;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return text;
}

class Planner {
 public:
  Planner(const Ablation& ablation, const ProgramCommands& commands)
      : ablation_(ablation), commands_(commands) {}

  AblationPlan plan() {
    for (size_t variant = 0; variant < ablation_.variants.size(); ++variant) {
      for (const int64_t seed : ablation_.options.seeds) add_run(variant, seed);
    }
    return std::move(plan_);
  }

 private:
  // The stages of one variant and seed that are planned so far, by name.
  struct Run {
    const VariantDescription& variant;
    int64_t seed = 0;
    std::map<std::string, size_t> tasks;  // the first of repeated ones
    std::map<std::string, std::vector<size_t>> repeats;
    std::string last_bundle;  // stage; empty: the base
  };

  std::string where(const Run& run, const StageDescription& stage) const {
    return ablation_.file.string() + ", variant '" + run.variant.name + "', stage '" + stage.name + "'";
  }

  void add_run(size_t number, int64_t seed) {
    const VariantDescription& variant = ablation_.variants[number];
    Run run{variant, seed, {}, {}, ""};
    std::string last;
    for (const StageDescription& stage : ablation_.stages) {
      const auto& wanted = variant.stages;
      if (!wanted.empty() && std::find(wanted.begin(), wanted.end(), stage.name) == wanted.end()) continue;
      std::vector<size_t> repeats;
      const int64_t count = ablation_.options.smoke ? std::min(kSmokeRepeats, stage.repeat) : stage.repeat;
      for (int64_t number = 0; number < count; ++number) {
        repeats.push_back(add_task(run, stage, number));
        auto& users = plan_.tasks[repeats.back()].used_by;
        const std::string user = variant.name + ", seed " + std::to_string(seed);
        if (users.empty() || users.back() != user) users.push_back(user);
      }
      const std::set<size_t> different(repeats.begin(), repeats.end());
      if (different.size() < repeats.size()) {
        fail({where(run, stage) + ", key 'repeat'", "options with ${number}, by which the runs differ",
              "the same ones each time", "write it into one of them, or leave repeat out"});
      }
      run.tasks[stage.name] = repeats.front();
      run.repeats[stage.name] = repeats;
      if (makes_bundle(stage.command)) run.last_bundle = stage.name;
      last = stage.name;
    }
    const std::string result = variant.result.empty() ? last : variant.result;
    task_of(run, result, "result", ablation_.stage(result));
    plan_.runs.push_back({number, seed, run.repeats.at(result)});
  }

  size_t task_of(const Run& run, const std::string& name, const std::string& key,
                 const StageDescription& stage) const {
    const auto found = run.tasks.find(name);
    if (found == run.tasks.end()) {
      fail({where(run, stage) + ", key '" + key + "'", "a stage that the variant takes", "'" + name + "'",
            "add it to the variant's stages"});
    }
    return found->second;
  }

  // The bundle that a stage takes is that of a task, or a folder.
  void choose_model(const Run& run, const StageDescription& stage, StageTask& task) {
    const std::string& wanted = stage.model.empty() ? run.last_bundle : stage.model;
    if (!wanted.empty() && wanted != kBaseModel) {
      task.model = task_of(run, wanted, "model", stage);
      task.needs.push_back(*task.model);
      return;
    }
    task.base_model = run.variant.model.empty() ? ablation_.options.model : run.variant.model;
    task.base_hash = base(task.base_model).hash;
    task.base_stamp = base(task.base_model).stamp;
  }

  struct Base {
    BundleOptions options;
    std::string hash;
    std::string stamp;
    bool has_backbone = false;
  };
  const Base& base(const std::filesystem::path& folder) {
    const auto known = bases_.find(folder.string());
    if (known != bases_.end()) return known->second;
    const auto bundle = ModelBundle::open(folder);
    const std::string stamp = files_stamp(folder);
    const Base made{bundle.options(), bundle.content_hash(), stamp, bundle.has(BundlePart::backbone())};
    return bases_.emplace(folder.string(), made).first->second;
  }

  const BundleOptions& bundle_of(const StageTask& task) {
    return task.model ? *plan_.tasks[*task.model].bundle : base(task.base_model).options;
  }

  bool makes_backbone(const StageTask& task) const {
    const auto made = [&](size_t number) { return makes_backbone(plan_.tasks[number]); };
    return task.command == kTrainBackboneCommand || (task.model && made(*task.model)) ||
           std::any_of(task.parts.begin(), task.parts.end(), made);
  }

  // Without the weights of what encodes pictures nothing but its own training and the benchmarks of random models run:
  // that is better said before hours of stages.
  void require_backbone(const Run& run, const StageDescription& stage, const StageTask& task) {
    if (task.command == kTrainBackboneCommand ||
        (task.command.rfind(kBenchPrefix, 0) == 0 && task.command != kSampleBenchmark))
      return;
    if (makes_backbone(task)) return;
    const StageTask* first = &task;
    while (first->model) first = &plan_.tasks[*first->model];
    if (base(first->base_model).has_backbone) return;
    fail({where(run, stage), "a backbone with weights in " + first->base_model.string(), "none",
          "train it or convert it into that folder (docs/WEIGHTS.md), or name another --model"});
  }

  size_t add_task(const Run& run, const StageDescription& stage, int64_t number) {
    StageTask task;
    task.stage = stage.name;
    task.command = stage.command;
    task.alone = stage.alone;
    std::string without_seed;  // task.options
    if (stage.command == kAssembleCommand) {
      plan_assembly(run, stage, task);
      without_seed = task.options;
    } else {
      without_seed = plan_command(run, stage, number, task);
      for (std::string* options : {&task.options, &without_seed})
        *options = replaced(*options, "${number}", fmt::format("{:06d}", number));
    }
    std::sort(task.needs.begin(), task.needs.end());
    task.needs.erase(std::unique(task.needs.begin(), task.needs.end()), task.needs.end());
    const std::string by_program = "gld ablation stage 1\nprogram: " + commands_.version + "\n";
    task.depends = by_program + dependencies(task, task.options, &StageTask::key);
    task.key = hash_key(task.depends);
    task.question = hash_key(dependencies(task, without_seed, &StageTask::question));
    const auto known = numbers_.find(task.key);
    if (known != numbers_.end()) return known->second;
    numbers_[task.key] = plan_.tasks.size();
    plan_.tasks.push_back(std::move(task));
    return plan_.tasks.size() - 1;
  }

  void plan_assembly(const Run& run, const StageDescription& stage, StageTask& task) {
    if (!stage.config.empty()) {
      fail({where(run, stage) + ", key 'config'", "options alone in a stage that assembles",
            "'" + stage.config + "'", "write the settings of model.yaml below options"});
    }
    task.takes_model = true;
    choose_model(run, stage, task);
    for (const std::string& name : stage.parts) {
      task.parts.push_back(task_of(run, name, "parts", stage));
      task.needs.push_back(task.parts.back());
    }
    task.bundle = std::make_shared<BundleOptions>(bundle_of(task));
    for (const OptionSetting& setting : ablation_.settings_of(run.variant, stage)) {
      apply_setting(*task.bundle, setting.key, setting.value, setting.where);
    }
    check_options(*task.bundle, where(run, stage));
    task.options = to_yaml(*task.bundle);
  }

  // Returns task.options as they are for every seed.
  std::string plan_command(const Run& run, const StageDescription& stage, int64_t number, StageTask& task) {
    const auto options = commands_.options(stage.command);
    if (!options) {
      const auto near = nearest_name(stage.command, commands_.names);
      fail({where(run, stage) + ", key 'command'", "a command of gld, or assemble", "'" + stage.command + "'",
            near.empty() ? "see gld --help" : "did you mean '" + near + "'?"});
    }
    if (!stage.config.empty()) load_yaml(*options, stage.config);
    for (const OptionSetting& setting : ablation_.settings_of(run.variant, stage)) {
      refuse_own(setting);
      apply_setting(*options, setting.key, setting.value, setting.where);
    }
    check_smoke_settings(stage);
    const std::string seed = stage.seed.empty() ? seed_field(*options) : stage.seed;
    const bool seeded = !stage.shared && !seed.empty();
    const int64_t first_seed = seeded ? integer_field(*options, seed) : 0;
    if (seeded) set(*options, seed, std::to_string(first_seed + kSeedStride * run.seed), run, stage);
    task.takes_threads = has_field(*options, "threads");
    task.takes_kept_scenes = has_field(*options, "kept_scenes");
    task.takes_model = has_field(*options, "model");
    if (task.takes_model) {
      choose_model(run, stage, task);
      require_backbone(run, stage, task);
      set(*options, "model", "bundle", run, stage);  // for the checks alone
    }
    set(*options, "out", "run", run, stage);
    if (has_field(*options, "device")) set(*options, "device", ablation_.options.device, run, stage);
    // One that was interrupted would be timed without what it had done.
    task.resumable = has_field(*options, "resume") && !stage.alone;
    if (!stage.resume.empty()) {
      if (!trains(stage.command)) {
        fail({where(run, stage) + ", key 'resume'", "a stage that trains", "'" + stage.command + "'",
              "remove it"});
      }
      task.resumed = task_of(run, stage.resume, "resume", stage);
      task.needs.push_back(*task.resumed);
    }
    check_options(*options, where(run, stage));
    check_folders(*options, run, stage);
    std::vector<std::string> beside = options_beside_the_result();
    beside.emplace_back("model");
    task.options = to_yaml_without(*options, beside);
    for (const auto& [name, earlier] : run.tasks) {
      if (task.options.find("${" + name + "}") == std::string::npos) continue;
      const std::vector<size_t>& repeats = run.repeats.at(name);
      if (repeats.size() > 1 && stage.repeat != ablation_.stage(name).repeat) {
        fail({where(run, stage) + ", key 'options'",
              fmt::format("${{{}}} of as many runs as this stage has", name),
              fmt::format("{} and {}", ablation_.stage(name).repeat, stage.repeat),
              "give both the same repeat"});
      }
      const size_t one = repeats.size() > 1 ? repeats[static_cast<size_t>(number)] : earlier;
      task.named.emplace_back(name, one);
      task.needs.push_back(one);
    }
    if (makes_bundle(stage.command)) task.bundle = std::make_shared<BundleOptions>(bundle_of(task));
    if (seeded) set(*options, seed, std::to_string(first_seed), run, stage);
    return to_yaml_without(*options, beside);
  }

  // What the ablation gives each stage itself.
  static void refuse_own(const OptionSetting& setting) {
    const std::string group = setting.key.substr(0, setting.key.find('.'));
    for (const char* own : {"out", "overwrite", "resume", "model", "kept_scenes", "threads", "processes",
                            "json", "preview", "device"}) {
      if (group != own) continue;
      fail({setting.where + ", key '" + setting.key + "'", "an option that changes a result",
            "one that the ablation sets itself",
            setting.key == "model" ? "write 'model' beside 'options', for the stage or the variant"
            : setting.key == "threads" || setting.key == "device"
                ? "say it to gld ablate, or in the description's first lines"
                : "remove it"});
    }
  }

  // A wrong name there would be found by the next smoke run alone.
  void check_smoke_settings(const StageDescription& stage) const {
    const auto found = ablation_.smoke.find(stage.name);
    if (found == ablation_.smoke.end()) return;
    const auto options = commands_.options(stage.command);
    for (const OptionSetting& setting : found->second) {
      refuse_own(setting);
      apply_setting(*options, setting.key, setting.value, setting.where);
    }
  }

  void set(OptionsGroup& options, const std::string& key, const std::string& value, const Run& run,
           const StageDescription& stage) const {
    apply_setting(options, key, value, where(run, stage));
  }

  // A long ablation should not find out at its end that its scenes are not there.
  void check_folders(const OptionsGroup& options, const Run& run, const StageDescription& stage) const {
    for (const auto& field : describe_options(options)) {
      const bool scenes = field.key == "scenes" || field.key == "scene" || field.key == "data.scenes";
      if (!scenes || field.default_value.empty()) continue;
      std::string rest = field.default_value + ",";
      for (size_t comma = rest.find(','); comma != std::string::npos; comma = rest.find(',')) {
        const std::string folder = rest.substr(0, comma);
        rest = rest.substr(comma + 1);
        if (folder.find("${") != std::string::npos || std::filesystem::exists(folder)) continue;
        fail({where(run, stage) + ", key '" + field.key + "'", "a folder that exists", "'" + folder + "'",
              "say where it is with --overrides " + stage.name + "." + field.key + "=FOLDER"});
      }
    }
  }

  // Returns what a task's result follows from, those that it needs by their `name`. options are those of the task, in
  // the form that counts.
  std::string dependencies(const StageTask& task, std::string options, std::string StageTask::*name) {
    const auto named = [&](size_t number) { return plan_.tasks[number].*name; };
    std::string text = "command: " + task.command + "\n";
    if (task.model) {
      text += "model: stage " + named(*task.model) + "\n";
    } else if (task.takes_model) {
      text += "model: bundle " + base(task.base_model).hash + "\n";
    }
    for (const size_t part : task.parts) text += "parts: stage " + named(part) + "\n";
    if (task.resumed) text += "resume: stage " + named(*task.resumed) + "\n";
    for (const auto& [stage, number] : task.named) {
      options = replaced(options, fmt::format("${{{}}}", stage), "stage " + named(number));
    }
    if (task.alone && task.takes_threads)
      text += fmt::format("threads: {}\n", threads_to_use(ablation_.options.threads));
    return text + options;
  }

  const Ablation& ablation_;
  const ProgramCommands& commands_;
  AblationPlan plan_;
  std::map<std::string, size_t> numbers_;  // of tasks, by key
  std::map<std::string, Base> bases_;      // by folder
};

}  // namespace

std::string files_stamp(const std::filesystem::path& folder) {
  std::set<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    files.insert(fmt::format("{} {} {}\n", entry.path().filename().string(), entry.file_size(),
                             entry.last_write_time().time_since_epoch().count()));
  }
  return fmt::format("{}", fmt::join(files, ""));
}

bool is_stage_key(const std::string& text) {
  return text.size() == kKeyDigits && text.find_first_not_of("0123456789abcdef") == std::string::npos;
}

AblationPlan plan_ablation(const Ablation& ablation, const ProgramCommands& commands) {
  return Planner(ablation, commands).plan();
}

std::vector<std::pair<std::string, std::string>> equal_variants(const Ablation& ablation,
                                                                const AblationPlan& plan) {
  std::vector<std::pair<std::string, std::string>> equal;
  const auto results_of = [&](size_t variant) {
    std::map<int64_t, std::vector<size_t>> results;
    for (const VariantRun& run : plan.runs) {
      if (run.variant == variant) results[run.seed] = run.results;
    }
    return results;
  };
  for (size_t first = 0; first < ablation.variants.size(); ++first) {
    for (size_t second = first + 1; second < ablation.variants.size(); ++second) {
      const VariantDescription &a = ablation.variants[first], &b = ablation.variants[second];
      if (a.rows == b.rows && a.columns == b.columns && results_of(first) == results_of(second))
        equal.emplace_back(a.name, b.name);
    }
  }
  return equal;
}

}  // namespace gld
