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
      "Or on one's own scenes, with the published solver: gld eval --scenes my_scenes --solver euler "
      "--schedule published --evaluations 49 --out runs/eval\n"
      "Or as the paper: gld eval --scenes my_scenes --samples 4 --source-counts 1,2,4 --views.views 8 "
      "--guidance-scale 1.5 --poses vggt --pose-model vggt_bundle --out runs/eval\n"
      "Measures two things side by side: samples, drawn as gld sample draws them (--solver and --guidance "
      "options change that), and the prediction of the mean, one evaluation without guidance. "
      "Writes eval.csv (one row a scene), targets.csv (one a target view) and report.json (means with 95 % "
      "confidence intervals; what could not be measured is absent, with the reason), "
      "beside three trivial predictors: the nearest source, the mean of the sources, and their mean colour; "
      "and beside the photographs carried into the target views, as they are and encoded and decoded. "
      "With --samples 4 or so the energy score says whether samples are as likely as the truth: neither a "
      "blur nor an invention wins it. "
      "A run that was killed goes on with the next scene with --resume.";
  command.options = options;
  command.usual = {
      {"Scenes", {"scenes", "synthetic", "source_counts", "views.views"}},
      {"Measurement",
       {"model", "samples", "solver.solver", "solver.evaluations", "guidance.guidance_scale", "poses"}}};
  command.run = [options](const std::vector<std::string>&) {
    std::cout << evaluate(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
