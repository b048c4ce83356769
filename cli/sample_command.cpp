#include "cli/sample_command.h"

#include "infer/sample/sampling.h"

namespace gld {

std::vector<UsualOptions> usual_sampling_options() {
  return {
      {"Views", {"scene", "photos", "views.sources", "views.targets", "views.path", "views.frames", "size"}},
      {"Sampling", {"model", "quality", "outputs"}}};
}

Command make_sample_command() {
  auto options = std::make_shared<SampleOptions>();
  Command command;
  command.name = "sample";
  command.summary = "Synthesise novel views of a scene, with depth, rays and a point cloud";
  command.description =
      "Example: gld sample --model configs/tiny --photos my_photos --frames 4 --out runs/first\n"
      "Targets are frames of the scene (--targets) or a camera path (--path orbit|spline|cameras.json).\n"
      "How it is sampled: the solver, guidance and approximate options, or instead of them --quality\n"
      "(published, exact, fast) or --tolerance (the largest relative error of the latents).";
  command.options = options;
  command.usual = usual_sampling_options();
  command.on_named = [options](const std::vector<std::string>& keys) { options->named = keys; };
  command.run = [options](const std::vector<std::string>&) {
    sample(*options);
    return 0;
  };
  return command;
}

}  // namespace gld
