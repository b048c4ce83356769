#include "cli/inspect_command.h"

#include "gld/base/command_options.h"
#include "gld/base/json_text.h"
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
  command.summary = "List the tensors of a weight file, or the parts of a model bundle";
  command.description =
      "Reads safetensors and PyTorch files (.pt, .pth) without running anything in them. "
      "The parts of a bundle are checked against its model.yaml.";
  command.arguments = {"FILE|BUNDLE", 1, 1};
  command.options = options;
  command.run = [options](const std::vector<std::string>& arguments) {
    const auto inspection = inspect(arguments[0]);
    std::cout << (options->json ? json_text(inspection, 2) + "\n" : inspection_text(inspection));
    return 0;
  };
  return command;
}

}  // namespace gld
