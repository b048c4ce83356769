#include "train/objectives/depth_refinement_objective.h"

#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "gld/photogrammetry/shared_sight.h"
#include "gld/tensors/tensor_pictures.h"
#include "models/layers/layer_precision.h"
#include "models/scene_geometry/composed_views.h"
#include "models/weights/weight_loading.h"
#include "train/objectives/geometry_targets.h"
#include "train/objectives/scene_pixels.h"
#include "train/objectives/source_view_depth.h"

#include <cmath>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

namespace gld {
namespace {

torch::Tensor known_depth(const torch::Tensor& depth) {
  return torch::isfinite(depth).logical_and(depth > 0);
}

// Returns (sources, 1, height, width), of the photographs' size.
torch::Tensor stacked(const std::vector<PlanarDepth>& maps) {
  std::vector<torch::Tensor> planes;
  planes.reserve(maps.size());
  for (const PlanarDepth& map : maps) planes.push_back(planes_of(map.values, 1, map.width, map.height));
  return torch::stack(planes);
}

// Returns (views, 1, height, width) at another size: the pixels under the middles of its own. A mean would lie between
// surfaces.
torch::Tensor picked(const torch::Tensor& maps, int64_t height, int64_t width) {
  return maps.index_select(2, pixel_under_cell(height, maps.size(2)))
      .index_select(3, pixel_under_cell(width, maps.size(3)));
}

// Returns the true depth of source views at that size: (sources, 1, height, width).
torch::Tensor true_source_depth(const TrainingScene& scene, int64_t height, int64_t width) {
  if (!scene.depth.defined()) {
    fail({"scene " + scene.name, "depth to train its mending with", "none",
          "use scenes with depth, such as those of gld synth"});
  }
  return picked(scene.depth.slice(0, 0, scene.views.num_sources).unsqueeze(1), height, width);
}

// Returns which pixels of the source views another of them shows, by their true depth: (sources, 1, height, width),
// bool, of that depth's size.
torch::Tensor in_sight_of_other_sources(const TrainingScene& scene, const torch::Tensor& true_depth) {
  std::vector<PicturedView> views;
  for (int64_t view = 0; view < true_depth.size(0); ++view) {
    PicturedView told;
    told.camera = scene.views.cameras[static_cast<size_t>(view)];
    told.depth.width = true_depth.size(3);
    told.depth.height = true_depth.size(2);
    const auto values = true_depth[view].contiguous();
    told.depth.values.assign(values.data_ptr<float>(), values.data_ptr<float>() + values.numel());
    views.push_back(std::move(told));
  }
  std::vector<torch::Tensor> masks;
  for (auto& mask : in_sight_of_others(views))
    masks.push_back(
        torch::from_blob(mask.data(), {1, true_depth.size(2), true_depth.size(3)}, torch::kUInt8).clone());
  return torch::stack(masks).to(torch::kBool);
}

torch::Tensor mean_where(const torch::Tensor& values, const torch::Tensor& known) {
  return (values * known).sum() / known.sum().clamp_min(1);
}

// What is kept of a scene takes little more than half of what 16 bits would; steps of 1/127 are below colours' noise.
constexpr double kDifferenceSteps = 127, kShownSteps = 255;

void pack(DepthEvidence& evidence) {
  evidence.differences = (kDifferenceSteps * evidence.differences.clamp(-1, 1)).round().to(torch::kInt8);
  evidence.shown = (kShownSteps * evidence.shown).round().to(torch::kUInt8);
  for (torch::Tensor* part : {&evidence.colours, &evidence.log_depth, &evidence.confidence, &evidence.head})
    *part = part->to(torch::kFloat16);
}

void unpack(DepthEvidence& evidence) {
  for (torch::Tensor* part : evidence.parts()) *part = part->to(torch::kFloat32);
  evidence.differences = evidence.differences / kDifferenceSteps;
  evidence.shown = evidence.shown / kShownSteps;
}

}  // namespace

void DepthRefinementObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visitor.real({"logarithmic_weight", "weight of the logarithm of a pixel's error"}, logarithmic_weight,
               {0.0, 1e6});
  visitor.real({"edge_weight", "weight of errors of the steps between neighbouring pixels"}, edge_weight,
               {0.0, 1e6});
  visitor.real({"kept_gib", "memory, in GiB, for what the network is shown of scenes that were seen before"},
               kept_gib, {0.0, 1e6});
}

DepthRefinementObjective::DepthRefinementObjective(const BundleOptions& model,
                                                   const DepthRefinementObjectiveOptions& options,
                                                   std::shared_ptr<const Backbone> backbone,
                                                   std::shared_ptr<const GeometryHead> head, int64_t seed)
    : model_(model),
      options_(options),
      space_(std::move(backbone), model.boundary_level),
      head_(std::move(head)),
      kept_(options.kept_gib) {
  model_.check();
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  refinement_ = std::make_shared<DepthRefinement>(model_.depth_refinement, ParameterPlacement{});
  refinement_->initialise(generator);
}

int64_t DepthRefinementObjective::learn_in(ComputePrecision precision) {
  return gld::learn_in(*refinement_, precision);
}

std::vector<NamedParameter> DepthRefinementObjective::parameters() const {
  return named_parameters(*refinement_);
}

std::vector<NamedParameter> DepthRefinementObjective::untrained() const {
  return named_untrained(*refinement_);
}

std::optional<DepthRefinementObjective::Lesson> DepthRefinementObjective::lesson_of(
    const TrainingScene& scene) const {
  const torch::NoGradGuard no_grad;
  const auto photographs =
      photographs_of_images(scene.views, scene.images.slice(0, 0, scene.views.num_sources));
  const auto told = told_depth(photographs, source_view_depth(space_, *head_, scene, photographs),
                               model_.depth_refinement.side);
  if (!told) return std::nullopt;
  Lesson lesson;
  lesson.evidence = depth_evidence(*told, model_.depth_refinement.side);
  const int64_t height = lesson.evidence.colours.size(2), width = lesson.evidence.colours.size(3);
  std::vector<PlanarDepth> maps;
  for (const PicturedView& view : told->photographs) maps.push_back(view.depth);
  const auto depth = picked(stacked(maps), height, width);
  const auto truth = true_source_depth(scene, height, width);
  lesson.known = known_depth(depth).logical_and(known_depth(truth));
  const auto one = torch::ones({});
  lesson.off = (torch::where(lesson.known, depth, one) / torch::where(lesson.known, truth, one)).log();
  return lesson;
}

std::array<std::pair<const char*, torch::Tensor*>, 8> DepthRefinementObjective::named_parts(Lesson& lesson) {
  DepthEvidence& evidence = lesson.evidence;
  return {{{"colours", &evidence.colours},
           {"log_depth", &evidence.log_depth},
           {"confidence", &evidence.confidence},
           {"head", &evidence.head},
           {"differences", &evidence.differences},
           {"shown", &evidence.shown},
           {"off", &lesson.off},
           {"known", &lesson.known}}};
}

std::optional<DepthRefinementObjective::Lesson> DepthRefinementObjective::kept_lesson_of(
    const TrainingScene& scene) {
  const KeptTensors kept = kept_.get(scene, "depth", [&] {
    KeptTensors tensors;
    auto lesson = lesson_of(scene);
    if (!lesson) return tensors;
    pack(lesson->evidence);
    for (const auto& [name, part] : named_parts(*lesson)) tensors[name] = *part;
    return tensors;
  });
  if (kept.empty()) return std::nullopt;
  Lesson lesson;
  for (const auto& [name, part] : named_parts(lesson)) *part = kept.at(name);
  unpack(lesson.evidence);
  return lesson;
}

Losses DepthRefinementObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  Losses losses;
  PartMeans parts;
  // Where no scene says anything the gradient is 0, not missing.
  losses.total = 0 * parameters().front().parameter.sum();
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  for (const TrainingScene& scene : batch.scenes) {
    const bool mirrored = torch::rand({1}, generator, torch::kFloat64).item<double>() < 0.5;
    auto lesson = kept_lesson_of(scene);
    if (!lesson) continue;
    if (mirrored) {
      for (torch::Tensor* part : lesson->evidence.parts()) *part = part->flip(-1);
      lesson->off = lesson->off.flip(-1);
      lesson->known = lesson->known.flip(-1);
    }
    const auto network = refinement_->forward(lesson->evidence);
    const auto off = lesson->off + depth_correction(lesson->evidence.confidence, network);
    const auto absolute = mean_where(off.abs(), lesson->known);
    const auto logarithm = mean_where((off.abs() + 0.01).log(), lesson->known);
    torch::Tensor edges = torch::zeros({});
    for (const int64_t along : {2, 3}) {
      const int64_t last = off.size(along) - 1;
      const auto both =
          lesson->known.narrow(along, 0, last).logical_and(lesson->known.narrow(along, 1, last));
      edges = edges + mean_where((off.narrow(along, 1, last) - off.narrow(along, 0, last)).abs(), both) / 2;
    }
    losses.total = losses.total + share * (absolute + options_.logarithmic_weight * logarithm +
                                           options_.edge_weight * edges);
    parts.add("absolute", absolute.detach());
    parts.add("edges", edges.detach());
    parts.add("absolute_before", mean_where(lesson->off.abs(), lesson->known));
  }
  losses.parts = parts.take();
  return losses;
}

Validation DepthRefinementObjective::validate(const std::vector<TrainingScene>& scenes) {
  const torch::NoGradGuard no_grad;
  Validation validation;
  double error = 0, error_before = 0, psnr = 0, psnr_before = 0, count = 0;
  // Over pixels: a scene may have hardly any of a kind.
  struct ErrorOfPixels {
    double sum = 0, pixels = 0;
    void add(const torch::Tensor& errors) {
      sum += errors.sum().item<double>();
      pixels += static_cast<double>(errors.numel());
    }
  } shared, shared_before, alone, alone_before;
  for (const TrainingScene& scene : scenes) {
    const auto pictures = scene.images.slice(0, 0, scene.views.num_sources);
    const auto photographs = photographs_of_images(scene.views, pictures);
    const PhotographDepth before = source_view_depth(space_, *head_, scene, photographs);
    if (!before.depth.known()) continue;
    PhotographDepth after = before;
    refine(*refinement_, photographs, after);
    const auto depth = stacked(after.depth.views), depth_before = stacked(before.depth.views);
    const auto true_depth = true_source_depth(scene, depth.size(2), depth.size(3));
    const auto known = known_depth(depth).logical_and(known_depth(true_depth));
    if (!known.any().item<bool>()) continue;
    const auto off = (depth - true_depth).abs() / true_depth,
               off_before = (depth_before - true_depth).abs() / true_depth;
    error += off.masked_select(known).mean().item<double>();
    error_before += off_before.masked_select(known).mean().item<double>();
    const auto sight = in_sight_of_other_sources(scene, true_depth);
    const auto seen_twice = known.logical_and(sight), seen_once = known.logical_and(sight.logical_not());
    shared.add(off.masked_select(seen_twice));
    shared_before.add(off_before.masked_select(seen_twice));
    alone.add(off.masked_select(seen_once));
    alone_before.add(off_before.masked_select(seen_once));
    const auto truth = scene.images.slice(0, scene.views.num_sources);
    const auto carried = [&](const SourceDepth& depth) {
      return filled_views(scene.views, photographs, depth).images;
    };
    const auto picture = carried(after.depth), picture_before = carried(before.depth);
    psnr += measure_images(metric_named("psnr"), truth, picture).mean();
    psnr_before += measure_images(metric_named("psnr"), truth, picture_before).mean();
    count += 1;
    if (validation.rows.size() < 4) {
      const auto range = scene.depth[0];
      const auto drawn = [&](const PhotographDepth& found) {
        const PlanarDepth& map = found.depth.views.front();
        return depth_picture(planes_of(map.values, 1, map.width, map.height)[0], range);
      };
      PictureRow row;
      row.name = scene.name;
      row.pictures = {{"source", pictures[0]},  {"true depth", depth_picture(range, range)},
                      {"told", drawn(before)},  {"mended", drawn(after)},
                      {"target", truth[0]},     {"carried by told", picture_before[0]},
                      {"by mended", picture[0]}};
      validation.rows.push_back(std::move(row));
    }
  }
  // Without a scene that tells its depth no number is one.
  validation.values = {{"abs_rel", error / count},
                       {"abs_rel_before", error_before / count},
                       {"abs_rel_shared", shared.sum / shared.pixels},
                       {"abs_rel_shared_before", shared_before.sum / shared_before.pixels},
                       {"abs_rel_alone", alone.sum / alone.pixels},
                       {"abs_rel_alone_before", alone_before.sum / alone_before.pixels},
                       {"carried_psnr", psnr / count},
                       {"carried_psnr_before", psnr_before / count}};
  return validation;
}

void DepthRefinementObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::depth_refinement(), named_tensors(*refinement_), dtype);
}

}  // namespace gld
