#include "cli/convert_command.h"

#include "models/bundle/conversion.h"

#include <iostream>
#include <memory>

namespace gld {

Command make_convert_command() {
  auto options = std::make_shared<ConversionOptions>();
  Command command;
  command.name = "convert";
  command.summary = "Convert the published weight files into a model bundle";
  command.description =
      "Example: gld convert --release GLD --out bundles/gld-da3\n"
      "Takes the published files of backbones (DA3, VGGT, DINOv2, autoencoders), GLD's .pt files and latent statistics. "
      "Every tensor must be known and of the right shape. "
      "Parts can be converted one after the other into the same folder.";
  command.options = options;
  command.usual = {{"Published files",
                    {"release", "da3", "vggt", "dinov2", "dpt_decoder", "rgb_decoder", "level1", "cascade",
                     "statistics_level0", "statistics_level1"}},
                   {"Bundle", {"description", "weights", "store"}}};
  command.run = [options](const std::vector<std::string>&) {
    std::cout << conversion_text(convert(*options));
    return 0;
  };
  return command;
}

}  // namespace gld
