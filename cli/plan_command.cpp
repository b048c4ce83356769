#include "cli/plan_command.h"

#include "cli/sample_command.h"
#include "gld/report/report_text.h"
#include "infer/sample/sampling.h"

namespace gld {
namespace {

// The options of gld sample; nothing is written, so no folder is asked for. A configuration of gld sample may name one,
// a command line may not (option_uses.h).
struct PlanOptions : SampleOptions {
  bool measure = false;

  void visit(FieldVisitor& visitor) override {
    SampleOptions::visit(visitor);
    visitor.boolean({"measure", "time the machine and parts of the model first; otherwise nothing is run"},
                    measure);
  }
  void check() const override {
    SampleOptions with_folder = *this;
    with_folder.out = "unused";
    with_folder.overwrite = with_folder.resume = false;
    with_folder.SampleOptions::check();
  }
};

}  // namespace

Command make_plan_command() {
  auto options = std::make_shared<PlanOptions>();
  Command command;
  command.name = "plan";
  command.summary = "Say what gld sample would run for a scene, and its time and memory";
  command.options = options;
  command.usual = usual_sampling_options();
  command.usual.back().keys.emplace_back("measure");
  command.on_named = [options](const std::vector<std::string>& keys) { options->named = keys; };
  command.run = [options](const std::vector<std::string>&) {
    print_report(
        sampling_plan_report(*options, options->measure ? PlanTiming::kMeasured : PlanTiming::kPredicted));
    return 0;
  };
  return command;
}

}  // namespace gld
