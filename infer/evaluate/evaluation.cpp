#include "infer/evaluate/evaluation.h"

#include "datasets/images/image_file.h"
#include "datasets/loading/batching.h"
#include "datasets/loading/dataset.h"
#include "datasets/pictures/contact_sheet.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/latents/noise.h"
#include "gld/metrics/depth_metrics.h"
#include "gld/metrics/image_metrics.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "infer/pipeline/bundle_models.h"
#include "models/layers/imagenet.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

struct Column {
  const char* name;
  double SceneEvaluation::*value;
};
constexpr Column kColumns[] = {
    {"psnr", &SceneEvaluation::psnr},
    {"psnr_nearest_source", &SceneEvaluation::psnr_nearest_source},
    {"psnr_mean_source", &SceneEvaluation::psnr_mean_source},
    {"psnr_mean_color", &SceneEvaluation::psnr_mean_color},
    {"ssim", &SceneEvaluation::ssim},
    {"depth_abs_rel", &SceneEvaluation::depth_abs_rel},
    {"reconstruction_psnr", &SceneEvaluation::reconstruction_psnr},
};

double mean_of(const torch::Tensor& values) { return values.mean().item<double>(); }

// Repeats one image for every target.
double psnr_of_constant(const torch::Tensor& targets, const torch::Tensor& image) {
  return mean_of(psnr(targets, image.expand_as(targets)));
}

double psnr_of_nearest_source(const SceneTensors& scene) {
  double sum = 0;
  for (int64_t target = scene.views.num_sources; target < scene.views.size(); ++target) {
    const auto centre = scene.views.cameras[static_cast<size_t>(target)].world_from_camera.translation();
    int64_t nearest = 0;
    double distance = std::numeric_limits<double>::infinity();
    for (int64_t source = 0; source < scene.views.num_sources; ++source) {
      const auto& camera = scene.views.cameras[static_cast<size_t>(source)];
      const double length = (camera.world_from_camera.translation() - centre).norm();
      if (length < distance) {
        distance = length;
        nearest = source;
      }
    }
    sum += mean_of(psnr(scene.images.narrow(0, target, 1), scene.images.narrow(0, nearest, 1)));
  }
  return sum / static_cast<double>(scene.views.num_targets());
}

double reconstruction_psnr(const PipelineModels& models, const SceneTensors& scene,
                           const torch::Device& device) {
  const auto backbone = models.backbone();
  const auto& sizes = backbone->options();
  const auto images = imagenet_normalise(scene.images.to(device));
  std::vector<torch::Tensor> levels;
  for (const auto& level : backbone->encode(images, sizes.levels() - 1)) {
    levels.push_back(backbone->decodable(level).patches);
  }
  const auto grid = sizes.grid_of(images.size(0), images.size(2), images.size(3));
  const auto decoded = models.rgb_decoder()->decode(torch::cat(levels, 2), grid).to(torch::kCPU);
  return mean_of(psnr(scene.images, decoded));
}

class Evaluator {
 public:
  Evaluator(const EvaluationOptions& options, const ModelBundle& bundle, const torch::Device& device)
      : options_(options), bundle_(bundle), device_(device), models_(kept_bundle_models(bundle, device)) {}

  struct Result {
    SceneEvaluation numbers;
    torch::Tensor images;  // of the targets
  };

  Result scene(const SceneTensors& scene, const std::string& name, int64_t index) const {
    const int64_t sources = scene.views.num_sources, targets = scene.views.num_targets();
    PipelineRequest request;
    request.views = scene.views;
    request.source_images = scene.images.narrow(0, 0, sources);
    const auto grid =
        bundle_.options().backbone.grid_of(scene.views.size(), scene.images.size(2), scene.images.size(3));
    const auto noise = [&](const char* stream, int64_t channels) {
      return views_noise(static_cast<uint64_t>(options_.seed + index), stream, grid.views,
                         {grid.tokens_per_view(), channels});
    };
    request.level1_noise = noise("level 1", bundle_.options().level1.in_channels);
    request.level0_noise = noise("level 0", bundle_.options().cascade.in_channels);
    request.level1_solver = solver_for(bundle_.options().level1_time_shift);
    request.cascade_solver = solver_for(bundle_.options().cascade_time_shift);
    request.guidance = options_.guidance;
    request.image_views = DecodedViews::kTargets;
    request.geometry_views = scene.depth.defined() ? DecodedViews::kTargets : DecodedViews::kNone;
    request.geometry_maps = GeometryMaps::kDepth;
    request.device = device_;
    StageRecords stages;
    const PipelineResult made = run_pipeline(models_, request, stages);

    Result result;
    result.images = made.images.to(torch::kCPU);
    const auto truth = scene.images.narrow(0, sources, targets);
    SceneEvaluation& numbers = result.numbers;
    numbers.scene = name;
    numbers.psnr = mean_of(psnr(truth, result.images));
    numbers.ssim = mean_of(ssim(truth, result.images));
    numbers.psnr_nearest_source = psnr_of_nearest_source(scene);
    numbers.psnr_mean_source = psnr_of_constant(truth, request.source_images.mean(0, /*keepdim=*/true));
    numbers.psnr_mean_color =
        psnr_of_constant(truth, request.source_images.mean({0, 2, 3}, /*keepdim=*/true));
    numbers.depth_abs_rel = std::numeric_limits<double>::quiet_NaN();
    if (scene.depth.defined()) {
      const auto depth = made.geometry.depth.to(torch::kCPU);
      const auto true_depth = scene.depth.narrow(0, sources, targets);
      const double scale = median_depth_scale(true_depth, depth);
      numbers.depth_abs_rel = mean_of(depth_errors(true_depth, depth * scale).abs_rel);
    }
    numbers.reconstruction_psnr = reconstruction_psnr(models_, scene, device_);
    return result;
  }

 private:
  SolverOptions solver_for(const TimeShiftOptions& model_shift) const {
    SolverOptions solver = options_.solver;
    if (solver.schedule.shift == 0) solver.schedule.shift = model_shift.evaluation;
    return solver;
  }

  const EvaluationOptions& options_;
  const ModelBundle& bundle_;
  torch::Device device_;
  PipelineModels models_;
};

Image scene_sheet(const SceneTensors& scene, const Evaluator::Result& result) {
  std::vector<SheetView> views;
  for (int64_t view = 0; view < scene.views.size(); ++view) {
    SheetView sheet;
    sheet.name = fmt::format("view {}", view);
    const bool source = view < scene.views.num_sources;
    sheet.role = source ? SheetRole::kSource : SheetRole::kTarget;
    sheet.image = to_image(source ? scene.images[view] : result.images[view - scene.views.num_sources]);
    if (!source) sheet.truth = to_image(scene.images[view]);
    views.push_back(std::move(sheet));
  }
  SheetText text;
  text.title = "gld eval, " + result.numbers.scene;
  text.subtitle =
      fmt::format("target PSNR {:.2f} dB, depth AbsRel {:.3f}, reconstruction {:.2f} dB", result.numbers.psnr,
                  result.numbers.depth_abs_rel, result.numbers.reconstruction_psnr);
  return make_contact_sheet(views, text);
}

SceneTensors load_scene(const Scene& scene, const EvaluationOptions& options, const BundleOptions& model,
                        int64_t index) {
  const SampledViews chosen =
      held_out_sample(scene, options.views, held_out_key(options.synthetic_seed, index));
  const Camera& first = scene.frames.front().camera;
  const ImageSize size = nearest_trained_size(first.width, first.height, model.image_sizes());
  SceneImages loaded;
  loaded.scene = scene.name;
  loaded.num_sources = chosen.num_sources;
  for (const int64_t frame : chosen.frames) {
    const Frame& source = scene.frames[static_cast<size_t>(frame)];
    loaded.frame_names.push_back(source.name);
    loaded.views.push_back(
        load_sized(source, size, source.has_depth() ? FrameParts::kImageAndDepth : FrameParts::kImage));
  }
  return to_tensors(loaded);
}

std::string summary_table(const nlohmann::ordered_json& summary) {
  std::string text;
  for (const auto& item : summary.at("means").items()) {
    if (item.value().at("mean").is_null()) continue;
    text += fmt::format("{:<22} {:8.3f} +- {:.3f}\n", item.key(), item.value().at("mean").get<double>(),
                        item.value().at("confidence_95").get<double>());
  }
  return text + fmt::format("margin over {}: {:.2f} dB\n",
                            summary.at("best_trivial_predictor").get<std::string>(),
                            summary.at("margin_over_best_trivial_db").get<double>());
}

}  // namespace

EvaluationOptions::EvaluationOptions() {
  views = held_out_views();
  solver.schedule.shift = 0;  // the model's
  // PSNR rewards the mean of what could be there, and one evaluation of each flow predicts it. More evaluations draw
  // one of the possibilities: sharper, and at a lower PSNR.
  solver.evaluations = 1;
  guidance.guidance_scale = 1.0;
}

void EvaluationOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder"}, model);
  visit_out(visitor, out);
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes; training must not have used it"},
                  synthetic_seed, {0, 1'000'000'000'000});
  visit_scenes(visitor, scenes, "generated ones");
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visitor.group({"views", "which frames are sources and targets"}, views);
  visitor.group({"solver", "solver of both flows"}, solver);
  visitor.group({"guidance", "guidance of both flows"}, guidance);
  visit_seed(visitor, seed, "the noise");
  visitor.integer({"pictures", "scenes that are drawn as contact sheets"}, pictures, {0, 1'000'000});
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
  check_out(out, "runs/eval");
}

MeanWithInterval mean_with_interval(const std::vector<double>& values) {
  MeanWithInterval result;
  double sum = 0;
  for (const double value : values) {
    if (!std::isfinite(value)) continue;
    sum += value;
    ++result.count;
  }
  if (result.count == 0) {
    result.mean = result.half_width = std::numeric_limits<double>::quiet_NaN();
    return result;
  }
  const auto count = static_cast<double>(result.count);
  result.mean = sum / count;
  double squares = 0;
  for (const double value : values) {
    if (std::isfinite(value)) squares += (value - result.mean) * (value - result.mean);
  }
  if (result.count > 1) result.half_width = 1.96 * std::sqrt(squares / (count - 1) / count);
  return result;
}

std::string evaluation_csv(const std::vector<SceneEvaluation>& scenes) {
  std::string text = "scene";
  for (const Column& column : kColumns) text += std::string(",") + column.name;
  text += '\n';
  for (const SceneEvaluation& scene : scenes) {
    text += scene.scene;
    for (const Column& column : kColumns) text += fmt::format(",{:.6f}", scene.*column.value);
    text += '\n';
  }
  return text;
}

nlohmann::ordered_json evaluation_summary(const std::vector<SceneEvaluation>& scenes) {
  nlohmann::ordered_json summary = {{"scenes", scenes.size()}};
  std::string best;
  double best_psnr = -std::numeric_limits<double>::infinity(), own_psnr = 0;
  for (const Column& column : kColumns) {
    std::vector<double> values;
    values.reserve(scenes.size());
    for (const SceneEvaluation& scene : scenes) values.push_back(scene.*column.value);
    const MeanWithInterval mean = mean_with_interval(values);
    summary["means"][column.name] = {
        {"mean", mean.mean}, {"confidence_95", mean.half_width}, {"scenes", mean.count}};
    const std::string name = column.name;
    if (name == "psnr") own_psnr = mean.mean;
    if (name.rfind("psnr_", 0) == 0 && mean.mean > best_psnr) {
      best_psnr = mean.mean;
      best = name;
    }
  }
  summary["best_trivial_predictor"] = best;
  summary["margin_over_best_trivial_db"] = own_psnr - best_psnr;
  return summary;
}

std::string evaluate(const EvaluationOptions& options) {
  install_interrupt_handler();
  const torch::NoGradGuard no_grad;
  use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  const auto device = device_from_text(options.device);
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder folder(options.out, "eval", options);
  const Evaluator evaluator(options, bundle, device);

  std::vector<SceneEvaluation> results;
  Progress progress("evaluating", dataset->size());
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted("evaluation stopped after " + std::to_string(index) + " scenes");
    const Scene scene = dataset->scene(index);
    const SceneTensors tensors = load_scene(scene, options, bundle.options(), index);
    const auto result = evaluator.scene(tensors, scene.name, index);
    results.push_back(result.numbers);
    if (index < options.pictures) {
      write_png(folder.subfolder("sheets") / (scene.name + ".png"), scene_sheet(tensors, result));
    }
    progress.update(index + 1, fmt::format("PSNR {:.2f} dB", result.numbers.psnr));
  }
  progress.finish();

  write_file_atomically(folder.path() / "eval.csv", evaluation_csv(results));
  nlohmann::ordered_json report = {
      {"command", "eval"}, {"model", options.model}, {"model_hash", bundle.content_hash()}};
  const auto summary = evaluation_summary(results);
  report.update(summary);
  folder.write_report(report);
  folder.note("table", "eval.csv");
  folder.note("report", "report.json");
  if (options.pictures > 0) folder.note("pictures", "sheets");
  return summary_table(summary) + folder.closing_box();
}

}  // namespace gld
