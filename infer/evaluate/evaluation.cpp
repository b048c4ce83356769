#include "infer/evaluate/evaluation.h"

#include "datasets/images/image_file.h"
#include "datasets/loading/batching.h"
#include "datasets/loading/dataset.h"
#include "datasets/pictures/contact_sheet.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "infer/evaluate/evaluation_report.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/pipeline/bundle_models.h"
#include "models/bundle/part_lineage.h"

#include <iostream>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// The sources, then of each target view the truth, the prediction of the mean and the sample.
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
  const auto number = [&](const char* column) { return evaluated.evaluation.number(column).value; };
  SheetText text;
  text.title = "gld eval, " + scene.name;
  text.subtitle = fmt::format(
      "PSNR of targets: sample {:.2f} dB, mean prediction {:.2f} dB; sharpness of the sample {:.2f}",
      number("sample_psnr"), number("mean_prediction_psnr"), number("sample_sharpness"));
  return make_picture_sheet(sections, text);
}

nlohmann::ordered_json methods_json(const SamplingMethod& sampling, const EvaluationOptions& options) {
  return {
      {"sample", {{"method", method_text(sampling)}, {"guidance_scale", options.guidance.guidance_scale}}},
      {"mean_prediction", {{"method", "one evaluation a level"}, {"guidance_scale", 1}}}};
}

}  // namespace

EvaluationOptions::EvaluationOptions() : views(held_out_views()) {}

void EvaluationOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder"}, model);
  visitor.boolean({"allow_mixed", "take parts that were not trained on each other"}, allow_mixed);
  visit_out(visitor, out, overwrite);
  visit_json(visitor, json);
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes; training must not have used it"},
                  synthetic_seed, {0, 1'000'000'000'000});
  visit_scenes(visitor, scenes, "generated ones");
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visitor.group({"views", "which frames are sources and targets"}, views);
  visitor.group({"solver", "solver of both flows, for the samples"}, solver);
  visitor.group({"guidance", "guidance of both flows, for the samples"}, guidance);
  visit_seed(visitor, seed, "the first scene's noise, each next scene has the next one");
  lpips.visit(visitor);
  visitor.integer({"pictures", "scenes that are drawn as contact sheets"}, pictures, {0, 1'000'000});
  visit_choice(visitor, {"precision", "what models multiply in on the CPU"}, precision,
               compute_precision_names());
  visit_device(visitor, device);
  visit_threads(visitor, threads);
}

void EvaluationOptions::check() const {
  if (scenes.empty() && synthetic == 0) {
    fail({"gld eval", "scenes", "none", "give --scenes DIR or --synthetic N"});
  }
  if (views.most_sources >= views.views) {
    fail({"views.most_sources", "fewer sources than views", std::to_string(views.most_sources),
          "leave at least one target"});
  }
  lpips.check();
  check_precision_on(device, precision);
  check_out(out, "runs/eval");
}

SamplingMethod EvaluationOptions::sampling_method(const BundleOptions& bundle) const {
  SampleOptions sample;
  sample.solver = solver;
  sample.guidance = guidance;
  sample.precision = static_cast<PrecisionChoice>(precision);
  return sample.method(bundle);
}

std::string evaluate(const EvaluationOptions& options) {
  use_threads(options.threads);
  check_run_folder(options.out, "eval", earlier_run(options.overwrite));
  const auto bundle = ModelBundle::open(options.model);
  std::vector<BundlePart> parts;
  for (const auto& part : bundle_parts(bundle.options())) {
    if (bundle.has(part)) parts.push_back(part);
  }
  for (const auto& warning : mixed_parts(bundle, parts, options.allow_mixed)) {
    std::cerr << "warning: " << warning << "\n";
  }
  const auto device = device_from_text(options.device);
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder folder(options.out, "eval", options, earlier_run(options.overwrite));
  const EvaluationModels models{bundle.options(), kept_bundle_models(bundle, device, options.precision),
                                load_lpips(options.lpips), device};
  const SamplingMethod method = options.sampling_method(bundle.options());
  const FlowSettings sampling = flow_settings(method, options.guidance, bundle.options());

  std::vector<SceneEvaluation> results;
  Progress progress("evaluating", dataset->size());
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted("evaluation stopped after " + std::to_string(index) + " scenes");
    const SamplingScene scene = load_held_out_scene(
        dataset->scene(index), options.views, held_out_key(options.synthetic_seed, index), bundle.options());
    const EvaluatedScene evaluated = evaluate_scene(models, scene, sampling, options.seed + index);
    results.push_back(evaluated.evaluation);
    if (index < options.pictures) {
      write_png(folder.subfolder("sheets") / (scene.name + ".png"), scene_sheet(scene, evaluated));
    }
    progress.update(index + 1, fmt::format("PSNR of the sample {:.2f} dB, of the mean prediction {:.2f} dB",
                                           results.back().number("sample_psnr").value,
                                           results.back().number("mean_prediction_psnr").value));
  }
  progress.finish();

  write_file_atomically(folder.path() / "eval.csv", evaluation_csv(results));
  nlohmann::ordered_json report = {{"command", "eval"},
                                   {"model", options.model},
                                   {"model_hash", bundle.content_hash()},
                                   {"precision", precision_text(options.precision)},
                                   {"methods", methods_json(method, options)}};
  const auto summary = evaluation_summary(results);
  report.update(summary);
  folder.write_report(report);
  folder.note("table", "eval.csv");
  folder.note("report", "report.json");
  if (options.pictures > 0) folder.note("pictures", "sheets");
  if (options.json) return report.dump(2) + "\n";
  return evaluation_text(summary) + folder.closing_box();
}

}  // namespace gld
