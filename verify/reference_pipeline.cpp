#include "infer/pipeline/sampling_pipeline.h"
#include "models/backbones/backbone_registry.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_dit.h"
#include "verify/reference_runners.h"

#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

struct PipelineCaseOptions : OptionsGroup {
  int64_t height = 0;  // pixels
  int64_t width = 0;   // pixels
  int64_t num_views = 0;
  int64_t num_sources = 0;
  BackboneOptions backbone;
  DptHeadOptions dpt_head;
  RgbDecoderOptions rgb_decoder;
  DitCaseOptions level1;
  DitCaseOptions cascade;
  CaseSamplerOptions sampler;
  double stats_eps = 1e-5;

  void visit(FieldVisitor& visitor) override {
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
    visitor.integer({"num_views", "source and target views"}, num_views, {1, 1 << 16});
    visitor.integer({"num_sources", "source views, which come first"}, num_sources, {1, 1 << 16});
    visitor.group({"backbone", "frozen backbone"}, backbone);
    visitor.group({"dpt_head", "frozen geometry head"}, dpt_head);
    visitor.group({"rgb_decoder", "RGB decoder"}, rgb_decoder);
    visitor.group({"level1", "diffusion model of level 1"}, level1);
    visitor.group({"cascade", "diffusion model of level 0"}, cascade);
    sampler.visit(visitor);
    visitor.real({"stats_eps", "added to the variance of latent statistics"}, stats_eps, {0, 1});
  }
};

template <class Module>
std::shared_ptr<Module> loaded(std::shared_ptr<Module> module, const std::string& prefix,
                               const ReferenceCase& reference) {
  WeightSelection selection;
  selection.prefix = prefix;
  load_strict(*module, reference.weight_file(), selection);
  reference.apply_precision(*module, ModelKind::kRunOnce);
  return module;
}

PipelineModels case_models(const ReferenceCase& reference, const PipelineCaseOptions& options) {
  const ParameterPlacement placement = reference.placement();
  PipelineModels models;
  models.backbone = [=, &reference] {
    return loaded(options.backbone.make(placement), options.backbone.architecture().published_prefix(),
                  reference);
  };
  models.rgb_decoder = [=, &reference] {
    return loaded(std::make_shared<RgbDecoder>(options.rgb_decoder, placement), RgbDecoder::kPrefix,
                  reference);
  };
  models.geometry_head = [=, &reference] {
    return loaded(std::make_shared<DptHead>(options.dpt_head, placement), DptHead::kPrefix, reference);
  };
  models.levels.generators = {level_model(1), cascade(1, 0)};
  models.levels.levels = options.backbone.levels();
  models.generator = [=, &reference](size_t number) {
    return number == 0 ? reference_dit(reference, options.level1.model, "diffusion.level1.")
                       : reference_dit(reference, options.cascade.model, "diffusion.cascade.");
  };
  for (const auto& generator : models.levels.generators) {
    LevelStatistics statistics;
    statistics.patches = read_latent_statistics(
        reference.weight_file(), fmt::format("stats.level{}.", generator.level), options.stats_eps);
    models.statistics.push_back(statistics.to(reference.compute.device));
  }
  return models;
}

}  // namespace

NamedTensors run_pipeline_case(const ReferenceCase& reference) {
  PipelineCaseOptions options;
  reference.read_config(options);
  for (DitCaseOptions* dit : {&options.level1, &options.cascade}) {
    dit->height = options.height;
    dit->width = options.width;
    dit->num_views = options.num_views;
    dit->num_sources = options.num_sources;
  }
  PipelineRequest request;
  request.device = reference.compute.device;
  request.views =
      reference_views(reference, {options.num_views, options.num_sources, options.width, options.height});
  request.source_images = reference.input("images", {options.num_views, 3, options.height, options.width})
                              .slice(0, 0, options.num_sources);
  request.noise = {reference_latent(reference, "noise_level1", options.level1),
                   reference_latent(reference, "noise_level0", options.cascade)};
  request.flow.solvers = {options.sampler.solver_options(), options.sampler.solver_options()};
  request.flow.guidance = options.sampler.guidance_options();
  request.image_views = request.geometry_views = DecodedViews::kAll;

  StageRecords stages;
  const auto result = run_pipeline(case_models(reference, options), request, stages);
  NamedTensors outputs = {{"latent_level1", latent_in_case_layout(result.latents.at(1), options.level1)},
                          {"latent_level0", latent_in_case_layout(result.latents.at(0), options.cascade)},
                          {"image", result.images},
                          {"depth", result.geometry.depth},
                          {"depth_conf", result.geometry.depth_confidence},
                          {"ray", result.geometry.rays},
                          {"ray_conf", result.geometry.ray_confidence}};
  for (size_t level = 0; level < result.levels.size(); ++level) {
    outputs["decoder_level" + std::to_string(level)] = result.levels[level];
  }
  return outputs;
}

}  // namespace gld
