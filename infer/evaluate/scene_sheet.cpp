#include "infer/evaluate/scene_sheet.h"

#include "datasets/loading/batching.h"
#include "datasets/pictures/contact_sheet.h"

#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {

Image scene_sheet(const SamplingScene& scene, const EvaluatedScene& evaluated) {
  const auto first_target = static_cast<size_t>(scene.views.num_sources);
  SheetSection sources;
  sources.heading = "sources";
  for (size_t view = 0; view < scene.source_images.size(); ++view) {
    sources.pictures.emplace_back(scene.view_names[view], scene.source_images[view]);
  }
  std::vector<SheetSection> sections{sources};
  for (size_t target = 0; target < scene.true_images.size(); ++target) {
    const auto number = static_cast<int64_t>(target);
    SheetSection section;
    section.heading = "target " + scene.view_names[first_target + target];
    if (!scene.true_images[target].empty()) section.pictures.emplace_back("truth", scene.true_images[target]);
    section.pictures.emplace_back("mean prediction", to_image(evaluated.mean_prediction.images[number]));
    section.pictures.emplace_back("sample", to_image(evaluated.sample.images[number]));
    sections.push_back(std::move(section));
  }
  SheetSection decoded;
  decoded.heading = "target " + scene.view_names[first_target] + ", what its features say";
  for (const auto& [level, image] : evaluated.first_reconstructed) {
    decoded.pictures.emplace_back(level ? fmt::format("level {} alone", *level) : "all levels",
                                  to_image(image));
  }
  if (!decoded.pictures.empty()) sections.push_back(std::move(decoded));
  const auto number = [&](const char* column) { return evaluated.evaluation.number(column).value; };
  SheetText text;
  text.title = "gld eval, " + scene.name;
  text.subtitle = fmt::format(
      "PSNR of targets: sample {:.2f} dB, mean prediction {:.2f} dB; sharpness of the sample {:.2f}",
      number("sample_psnr"), number("mean_prediction_psnr"), number("sample_sharpness"));
  return make_picture_sheet(sections, text);
}

}  // namespace gld
