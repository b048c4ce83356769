#pragma once

#include "ablate/configuration/ablation.h"
#include "ablate/plan/stage_plan.h"
#include "ablate/report/comparisons.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// A finished run folder of gld ablate with the same question under other seeds: of another day or machine.
struct OtherRun {
  std::filesystem::path folder;
  std::vector<int64_t> seeds;
  std::string program;  // ProgramCommands::version of its own
  double seconds = 0;   // of its stages together
  std::vector<VariantNumbers> numbers;
};

// Reads those of ablation.options.with_runs. Throws Error where one is not finished, has not measured a variant of this
// ablation, has a seed that this ablation or another one of them has, or asks another question: stages that differ by
// more than their seed and the program's version (StageTask::question), or other numbers read.
std::vector<OtherRun> read_other_runs(const Ablation& ablation, const AblationPlan& plan);

// Returns which numbers of which rows each variant is compared by, as report.json keeps it ("reads"): runs are put
// together only where they read the same.
nlohmann::ordered_json numbers_read(const Ablation& ablation, const AblationPlan& plan);

// Adds the numbers as if this ablation had run their seeds too.
void add_other_runs(const std::vector<OtherRun>& others, std::vector<VariantNumbers>& numbers);

}  // namespace gld
