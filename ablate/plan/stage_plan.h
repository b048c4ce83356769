#pragma once

#include "ablate/configuration/ablation.h"
#include "ablate/plan/program_commands.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// One run of a stage, which all variants and seeds share that need exactly it.
struct StageTask {
  std::string key;      // 16 hexadecimal digits: of everything that its result depends on
  std::string stage;    // name in the description
  std::string command;  // "train level", "assemble"
  std::string depends;  // the text whose hash the key is
  // Likewise of everything but the seed and the program's version: what tasks of other seeds and days have in common
  // that answer the same question.
  std::string question;
  // YAML of all options of the command but those that only say how it runs; ${STAGE} stands for the folder of the run
  // of an earlier stage. Of assemble: model.yaml.
  std::string options;
  std::vector<size_t> needs;  // tasks that must be done before, by their number
  bool takes_model = false;
  bool takes_threads = false;
  bool takes_kept_scenes = false;    // a training on scenes (train/data/kept_folder.h)
  std::filesystem::path base_model;  // the bundle it takes where no stage makes one
  std::string base_hash;             // of that bundle's content, when this was planned
  std::string base_stamp;            // files_stamp() then: hashing gigabytes for every stage takes long
  std::optional<size_t> model;       // the task that makes the bundle it takes
  std::vector<size_t> parts;         // assemble: tasks whose trained parts are taken
  std::optional<size_t> resumed;     // the task whose run it goes on with
  std::vector<std::pair<std::string, size_t>> named;  // stages in ${...}, and their tasks
  bool resumable = false;
  bool alone = false;
  std::shared_ptr<BundleOptions> bundle;  // what is in the bundle it makes; null where it makes none
  std::vector<std::string> used_by;       // "n1, seed 0"
};

struct VariantRun {
  size_t variant = 0;  // of Ablation::variants
  int64_t seed = 0;
  std::vector<size_t> results;  // the tasks whose rows count
};

struct AblationPlan {
  std::vector<StageTask> tasks;  // each behind those that it needs
  std::vector<VariantRun> runs;
};

// Returns what an ablation has to run. Keys are known before anything runs: a stage's is the hash of the program's
// version, the command, its options after all settings, its seed among them, and the keys of the stages before it or
// the content of the bundle; of one that runs alone, for its seconds, the number of threads too. Files and folders
// that options name count by their name, not by their content. Throws Error where an option does not exist or has a
// wrong value, a bundle cannot be opened or a folder of scenes is missing.
AblationPlan plan_ablation(const Ablation& ablation, const ProgramCommands& commands);

// Returns variants that cannot differ, "a" and "b": the same rows and columns of the same stages.
std::vector<std::pair<std::string, std::string>> equal_variants(const Ablation& ablation,
                                                                const AblationPlan& plan);

// Returns names, sizes and times of the files in a folder: where it is the same they are the same files.
std::string files_stamp(const std::filesystem::path& folder);

// Returns whether text looks like StageTask::key.
bool is_stage_key(const std::string& text);

// Seeds of stages lie so far apart: evaluations give each next scene the next seed, and each next sample the next
// million.
constexpr int64_t kSeedStride = 1'000'000'000;

}  // namespace gld
