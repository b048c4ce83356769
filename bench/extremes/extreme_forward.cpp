// The whole of a small model, in single precision beside double, and on extreme pictures.
#include "bench/extremes/extremes_benchmark.h"
#include "bench/support/benchmark_precisions.h"
#include "gld/base/error.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/bundle/bundle.h"
#include "models/bundle/random_bundle.h"

#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <string>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kPatch = 14;  // pixels

PipelineModels models_in(const ModelBundle& bundle, torch::Dtype dtype) {
  ParameterPlacement placement;
  placement.dtype = dtype;
  PipelineModels models;
  models.backbone = [=] { return bundle.load_backbone(placement); };
  models.levels = bundle.options().level_set();
  models.generator = [=](size_t number) {
    return bundle.load_generator(bundle.options().generators.at(number).generator, placement);
  };
  models.rgb_decoder = [=] { return bundle.load_image_decoder(placement); };
  models.geometry_head = [=] { return bundle.load_geometry_head(placement); };
  for (const auto& part : bundle.options().generators) {
    models.statistics.push_back(bundle.load_statistics(part.generator));
  }
  return models;
}

// A shape is (views, height, width) in pixels; the sources come first.
struct PictureShape {
  int64_t views = 4;
  int64_t sources = 2;
  int64_t height = 42;
  int64_t width = 70;
};

Views views_of(const PictureShape& shape) {
  Views views;
  views.num_sources = shape.sources;
  for (int64_t i = 0; i < shape.views; ++i) {
    const double angle = 0.2 * static_cast<double>(i);
    Camera camera;
    camera.width = shape.width;
    camera.height = shape.height;
    const auto side = static_cast<double>(std::max(shape.width, shape.height));
    camera.intrinsics << side, 0, static_cast<double>(shape.width) / 2, 0, side,
        static_cast<double>(shape.height) / 2, 0, 0, 1;
    camera.world_from_camera.linear() =
        Eigen::AngleAxisd(-angle, Eigen::Vector3d::UnitY()).toRotationMatrix();
    camera.world_from_camera.translation() = Eigen::Vector3d(2 * std::sin(angle), 0.1, -2 * std::cos(angle));
    views.cameras.push_back(camera);
  }
  return views;
}

// The request is for one evaluation of each flow with guidance, then everything that is decoded. images are (sources,
// 3, height, width).
PipelineRequest whole_request(const BundleOptions& bundle, const torch::Tensor& images) {
  PictureShape shape;
  shape.height = images.size(2);
  shape.width = images.size(3);
  PipelineRequest request;
  request.views = views_of(shape);
  request.source_images = images;
  const int64_t tokens = (shape.height / kPatch) * (shape.width / kPatch);
  const auto noise = [&](uint64_t seed) {
    return torch::randn({shape.views, tokens, bundle.backbone.level_channels()},
                        at::detail::createCPUGenerator(seed), torch::TensorOptions(torch::kFloat32))
        .to(images.scalar_type());
  };
  for (size_t number = 0; number < bundle.generators.size(); ++number) {
    request.noise.push_back(noise(number + 1));
    SolverOptions solver;
    solver.solver = SolverKind::kEuler;
    solver.evaluations = 1;
    request.flow.solvers.push_back(solver);
  }
  request.flow.guidance.guidance_scale = 1.5;
  request.image_views = DecodedViews::kAll;
  request.geometry_views = DecodedViews::kAll;
  return request;
}

// Returns for example "M1" or "the cascade".
std::string with_article(const LevelGenerator& generator) {
  return (generator.is_cascade() ? "the " : "") + generator_stage(generator);
}

std::map<std::string, torch::Tensor> run_whole(const PipelineModels& models, const PipelineRequest& request) {
  StageRecords stages;
  const auto result = run_pipeline(models, request, stages);
  std::map<std::string, torch::Tensor> made{{"images", result.images},
                                            {"depth", result.geometry.depth},
                                            {"depth confidence", result.geometry.depth_confidence},
                                            {"rays", result.geometry.rays},
                                            {"ray confidence", result.geometry.ray_confidence}};
  for (const LevelGenerator& generator : models.levels.generators) {
    made[fmt::format("level {} after {}", generator.level, with_article(generator))] =
        result.latents.at(generator.level);
  }
  for (int64_t level = models.levels.boundary + 1; level < models.levels.levels; ++level) {
    made[fmt::format("level {} after propagation", level)] = result.levels.at(static_cast<size_t>(level));
  }
  return made;
}

torch::Tensor random_pictures(uint64_t seed, int64_t height, int64_t width) {
  return torch::rand({2, 3, height, width}, at::detail::createCPUGenerator(seed),
                     torch::TensorOptions(torch::kFloat32));
}

// Returns how many of the three things that a message about a number that is not finite must say are missing.
double missing_in_message(const std::function<void()>& action, const std::string& stage) {
  try {
    action();
  } catch (const Error& error) {
    const std::string text = error.what();
    const auto missing = [&](const std::string& word) {
      return text.find(word) == std::string::npos ? 1.0 : 0.0;
    };
    return missing(stage) + missing("step") + missing("flow time");
  }
  return 3;
}

}  // namespace

std::vector<ExtremeRow> forward_extremes(const std::filesystem::path& folder) {
  const auto options = small_bundle_options();
  write_random_bundle(folder / "model", options, 5);
  const auto bundle = ModelBundle::open(folder / "model");
  const auto single_models = models_in(bundle, torch::kFloat32);
  std::vector<ExtremeRow> rows;

  const auto pictures = random_pictures(3, 42, 70);
  const auto single = run_whole(single_models, whole_request(options, pictures));
  const auto exact =
      run_whole(models_in(bundle, torch::kFloat64), whole_request(options, pictures.to(torch::kFloat64)));
  for (const auto& [name, reference] : exact) {
    const auto error = (single.at(name).to(torch::kFloat64) - reference).abs().max() / reference.abs().max();
    rows.push_back({"whole model", name, "relative error, fp32 against double",
                    reference.scalar_type() == torch::kFloat64 ? error.item<double>()
                                                               : std::numeric_limits<double>::infinity(),
                    1e-5});
  }

  const std::vector<std::pair<const char*, torch::Tensor>> extremes{
      {"all black pictures", torch::zeros({2, 3, 42, 70})},
      {"all white pictures", torch::ones({2, 3, 42, 70})},
      {"pictures of 1:8", random_pictures(4, 14, 112)},
      {"pictures of 8:1", random_pictures(5, 112, 14)}};
  for (const ComputePrecision precision : benchmark_precisions(compute_precision_names())) {
    const auto models = bundle_models(bundle, torch::kCPU, precision);
    for (const auto& [situation, images] : extremes) {
      double non_finite = 0;
      for (const auto& [name, tensor] : run_whole(models, whole_request(options, images))) {
        non_finite += torch::isfinite(tensor).logical_not().sum().item<double>();
      }
      rows.push_back({"whole model", fmt::format("{}, in {}", situation, compute_precision_name(precision)),
                      "numbers that are not finite", non_finite, 0});
    }
  }

  auto broken = whole_request(options, pictures);
  broken.noise.back()[1][2][3] = std::numeric_limits<float>::quiet_NaN();
  const LevelGenerator& last = options.generators.back().generator;
  rows.push_back({"whole model", "a NaN in " + with_article(last),
                  "of stage, step and time not named in the message",
                  missing_in_message([&] { run_whole(single_models, broken); }, generator_stage(last)), 0});
  return rows;
}

}  // namespace gld
