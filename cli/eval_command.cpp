#include "cli/eval_command.h"

#include "infer/evaluate/evaluation.h"

#include <iostream>
#include <memory>
#include <string>

namespace gld {

Command make_eval_command() {
  auto options = std::make_shared<EvaluationOptions>();
  Command command;
  command.name = "eval";
  command.summary = "Measure novel views, depth and reconstruction on scenes with known truth";
  command.description =
      "Example: gld eval --model configs/tiny --synthetic 64 --out runs/eval\n"
      "Or on one's own scenes, with the published solver: "
      "gld eval --scenes my_scenes --solver euler --schedule published --evaluations 49 --out runs/eval\n"
      "Writes eval.csv (one row a scene) and report.json (means with 95 % confidence intervals), "
      "beside three trivial predictors: the nearest source, the mean of the sources, and their mean colour.";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    std::cout << evaluate(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
