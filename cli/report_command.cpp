#include "cli/report_command.h"

#include "ablate/page/ablation_page.h"
#include "infer/page/eval_page.h"
#include "infer/page/report_command.h"
#include "train/page/training_page.h"

namespace gld {
namespace {

Page stopped_training_page(const std::filesystem::path& run) {
  return unfinished_training_page(run, UnfinishedTraining::kStopped);
}

}  // namespace

Command make_report_command() {
  auto options = std::make_shared<ReportOptions>();
  Command command;
  command.name = "report";
  command.summary = "Make the page of a run again: report.html, one file for any browser";
  command.description =
      "Example: gld report runs/first\n"
      "It reads the run's folder alone and writes RUN/report.html, the same bytes for the same run.";
  command.arguments = {"RUN", 1, 1};
  command.options = options;
  command.on_named = [options](const std::vector<std::string>& keys) { options->named = keys; };
  command.run = [options](const std::vector<std::string>& arguments) {
    report_run(arguments[0], {sample_page_maker(*options),
                              {"eval", evaluation_page},
                              {"train", training_page, stopped_training_page},
                              {"ablate", ablation_page}});
    return 0;
  };
  return command;
}

}  // namespace gld
