#include "cli/synth_command.h"

#include "datasets/synthetic/synth.h"

namespace gld {

Command make_synth_command() {
  auto options = std::make_shared<SynthOptions>();
  Command command;
  command.name = "synth";
  command.summary = "Generate synthetic scenes with exact depth and cameras, in any of the dataset layouts";
  command.description =
      "Example: gld synth --scene-count 10 --width 504 --height 280 --layout nerfstudio --out runs/rooms\n"
      "Scene number i of a seed is always the same. Training generates the same scenes on the fly.";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    run_synth(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
