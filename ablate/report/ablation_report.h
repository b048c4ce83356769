#pragma once

#include "ablate/report/comparisons.h"
#include "ablate/report/other_runs.h"
#include "gld/report/plot.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What came out of an ablation.
struct AblationResults {
  std::string program;                  // ProgramCommands::version
  std::vector<VariantNumbers> numbers;  // of this run and the others
  std::vector<OtherRun> others;
  std::vector<ClaimResult> claims;
};

// Returns ablation.md: title, a table of variants and metrics, the claims with their verdicts, other runs whose seeds
// count, what each stage took, how to repeat it.
std::string ablation_markdown(const Ablation& ablation, const AblationPlan& plan, const StageCache& cache,
                              const AblationResults& results);
// Returns ablation.csv: a row for every variant, seed, scene, target view and metric.
std::string ablation_csv(const AblationResults& results);
nlohmann::ordered_json ablation_json(const Ablation& ablation, const AblationPlan& plan,
                                     const StageCache& cache, const AblationResults& results);
// Draws a panel a metric: means with their intervals, over x where variants have one. Metrics without any number are
// left out.
Figure ablation_figure(const Ablation& ablation, const AblationResults& results);
// Draws a panel a metric that claims are about: by how much each holds, with its interval, beside no difference. It is
// without a panel where nothing could be compared.
Figure claims_figure(const Ablation& ablation, const AblationResults& results);

}  // namespace gld
