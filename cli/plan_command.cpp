#include "cli/plan_command.h"

#include "infer/sample/sampling.h"

#include <iostream>

namespace gld {
namespace {

// The options of gld sample; nothing is written, so no folder is asked for.
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
  command.on_named = [options](const std::vector<std::string>& keys) { options->named = keys; };
  command.run = [options](const std::vector<std::string>&) {
    std::cout << sampling_plan_report(*options,
                                      options->measure ? PlanTiming::kMeasured : PlanTiming::kPredicted);
    return 0;
  };
  return command;
}

}  // namespace gld
