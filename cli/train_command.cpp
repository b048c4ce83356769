#include "cli/train_command.h"

#include "train/stages/feature_stages.h"
#include "train/stages/latent_stages.h"
#include "train/stages/refiner_stage.h"
#include "train/stages/sample_refiner_stage.h"
#include "train/stages/validation_sheet.h"

#include <iostream>
#include <memory>
#include <string>

namespace gld {
namespace {

// own are options that --help shows and other stages have not; data are those of what it trains on.
template <class Options>
Command stage_command(const std::string& name, const std::string& summary,
                      std::string (*run)(const Options&, const DrawValidation&),
                      const std::vector<std::string>& own,
                      const std::vector<std::string>& data = {"data.scenes", "data.views.views",
                                                              "data.loading.batch_size",
                                                              "data.validation_folder"}) {
  auto options = std::make_shared<Options>();
  Command command;
  command.name = "train " + name;
  command.summary = summary;
  command.options = options;
  command.usual = {{"Data", data},
                   {"Training",
                    {"model", "loop.steps", "loop.learning_rate.peak", "loop.precision", "loop.workers",
                     "loop.seed", "loop.checkpoint_every", "loop.validate_every"}}};
  auto& training = command.usual.back().keys;
  training.insert(training.begin() + 1, own.begin(), own.end());
  command.run = [options, run](const std::vector<std::string>&) {
    std::cout << run(*options, draw_validation_sheet);
    return 0;
  };
  return command;
}

}  // namespace

Command make_train_command() {
  Command command;
  command.name = "train";
  command.summary =
      "Train a part of a model: backbone, decoder, depth, blending, level, cascade, refiner or sample-refiner";
  command.description =
      "Example: gld train decoder --config configs/tiny/first_training.yaml --model configs/tiny --out "
      "runs/first_training\n"
      "Each kind reads a bundle (--model) and writes one with the trained part (model/ in the run folder), "
      "which the next kind takes. Order: backbone, decoder, backbone once more for the head alone "
      "(--training head_only), depth, blending, then gld stats, level, cascade. "
      "--resume continues a run.";
  command.subcommands = {
      stage_command("backbone",
                    "A geometric backbone and its DPT head on scenes with depth, or the head alone",
                    train_backbone, {"objective.training"}),
      stage_command("decoder", "The RGB decoder on the features of a frozen backbone", train_decoder,
                    {"objective.start"}),
      stage_command("depth", "The network that mends the depth of source views", train_depth,
                    {"objective.start"}),
      stage_command("blending", "How photographs are laid together in target views, by which depth",
                    train_blending, {"objective.start"}),
      stage_command("level",
                    "The first generator (M1 of the published model), which makes a level from noise",
                    train_level, {"level", "objective.start"}),
      stage_command("cascade", "a cascade, which generates a level from a deeper one", train_cascade,
                    {"objective.flow.start"}),
      stage_command(
          "refiner",
          "The network that repairs what Gaussians show of latents, beside the nearest views, in one call",
          train_refiner, {"objective.start"}, {"data.pairs", "data.validation_pairs", "data.batch_size"}),
      stage_command("sample-refiner",
                    "The network that repairs a model's own samples of few evaluations, in one call a view",
                    train_sample_refiner, {"objective.start"})};
  return command;
}

}  // namespace gld
