#include "cli/stats_command.h"

#include "train/stages/latent_stages.h"

#include <iostream>
#include <memory>
#include <string>

namespace gld {

Command make_stats_command() {
  auto options = std::make_shared<StatsOptions>();
  Command command;
  command.name = "stats";
  command.summary = "Compute the latent statistics that level and cascade models need";
  command.description =
      "Example: gld stats --config configs/tiny/stats.yaml --model runs/decoder/model --out runs/stats\n"
      "model/ in the run folder is a copy of the bundle, "
      "with the statistics of every level that it generates.";
  command.options = options;
  command.usual = {{"Statistics",
                    {"model", "scene_count", "data.scenes", "data.views.views", "data.loading.batch_size",
                     "data.loading.seed"}}};
  command.run = [options](const std::vector<std::string>&) {
    std::cout << compute_statistics(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
