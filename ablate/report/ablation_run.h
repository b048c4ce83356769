#pragma once

#include "ablate/configuration/ablation.h"
#include "ablate/plan/program_commands.h"

#include <string>

namespace gld {

struct AblationOutcome {
  std::string text;      // tables and closing box, or JSON
  bool complete = true;  // false where a stage failed
};

// gld ablate plans, runs what is not done, compares and writes the run folder: ablation.md, ablation.csv, ablation.svg,
// .png, report.json, and the stages in cache/. With options.plan it only says what would run, and writes nothing.
AblationOutcome run_ablation(const Ablation& ablation, const ProgramCommands& commands);

}  // namespace gld
