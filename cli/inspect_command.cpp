#include "cli/inspect_command.h"

#include "gld/base/command_options.h"
#include "gld/base/json_text.h"
#include "infer/export/output_inspection.h"
#include "models/bundle/inspection.h"

#include <iostream>
#include <memory>

namespace gld {
namespace {

struct InspectOptions : OptionsGroup {
  bool json = false;
  void visit(FieldVisitor& visitor) override { visit_json(visitor, json); }
};

}  // namespace

Command make_inspect_command() {
  auto options = std::make_shared<InspectOptions>();
  Command command;
  command.name = "inspect";
  command.summary = "Say what a weight file, model bundle, run folder, PNG, PLY or GLB file holds";
  command.description =
      "Reads safetensors and PyTorch files (.pt, .pth) without running anything in them. "
      "The parts of a bundle are checked against its model.yaml. Of a run folder it says the kind, the state, "
      "the checkpoints with step and loss, and the next command; of PNG, PLY and GLB files where they come from.";
  command.arguments = {"FILE|FOLDER", 1, 1};
  command.options = options;
  command.run = [options](const std::vector<std::string>& arguments) {
    if (const auto output = inspect_output(arguments[0])) {
      std::cout << (options->json ? json_text(*output, 2) + "\n" : output_inspection_text(*output));
      return 0;
    }
    const auto inspection = inspect(arguments[0]);
    std::cout << (options->json ? json_text(inspection, 2) + "\n" : inspection_text(inspection));
    return 0;
  };
  return command;
}

}  // namespace gld
