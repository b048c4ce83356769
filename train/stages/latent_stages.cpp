#include "train/stages/latent_stages.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/distributed/shared_work.h"
#include "gld/latents/latent_divergence.h"
#include "gld/latents/latent_statistics.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "models/bundle/seen_scenes.h"
#include "models/bundle/view_unit_file.h"
#include "models/conditioning/source_conditioning.h"
#include "models/latent_spaces/latent_space.h"
#include "train/objectives/level_objective.h"

#include <cmath>
#include <iostream>
#include <numeric>
#include <optional>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

// The statistics of one level's patch tokens, or of the special tokens in front of them, on their way.
struct LevelMoments {
  int64_t level = 0;
  bool special = false;
  StreamingMoments moments;

  BundlePart part() const {
    return special ? BundlePart::special_statistics(level) : BundlePart::statistics(level);
  }
};

std::vector<LevelMoments> moments_of(const BundleOptions& model) {
  std::vector<LevelMoments> result;
  for (const auto& part : bundle_parts(model)) {
    const bool special = part.kind == BundlePart::Kind::kSpecialStatistics;
    if (!special && part.kind != BundlePart::Kind::kStatistics) continue;
    result.push_back({part.level, special, StreamingMoments(model.backbone.level_channels())});
  }
  return result;
}

// Returns the moments of each level in turn, as text that keeps every bit.
nlohmann::json moments_record(const std::vector<LevelMoments>& moments) {
  auto record = nlohmann::json::array();
  for (const auto& [level, special, values] : moments) {
    record.push_back({values.count(), values.mean(), values.squares()});
  }
  return record;
}

void merge_record(const nlohmann::json& record, std::vector<LevelMoments>& moments) {
  for (size_t i = 0; i < moments.size(); ++i) {
    const auto& level = record.at(i);
    moments[i].moments.merge({level.at(0).get<int64_t>(), level.at(1).get<std::vector<double>>(),
                              level.at(2).get<std::vector<double>>()});
  }
}

// Returns how far each scene is from all of them together, by its patch tokens.
SeenScenes seen_scenes(const std::vector<LevelMoments>& all,
                       const std::vector<std::vector<LevelMoments>>& of_scenes, double epsilon) {
  SeenScenes seen;
  seen.scenes = static_cast<int64_t>(of_scenes.size());
  for (size_t i = 0; i < all.size(); ++i) {
    if (all[i].special) continue;
    const LatentStatistics together = statistics_of(all[i].moments, epsilon);
    std::vector<double> divergences;
    divergences.reserve(of_scenes.size());
    for (const auto& scene : of_scenes)
      divergences.push_back(latent_divergence(statistics_of(scene[i].moments, epsilon), together));
    seen.levels.push_back(seen_level(all[i].level, std::move(divergences)));
  }
  return seen;
}

// The head's convolutions add in an order that depends on the number of threads: the first digits do not, and a guess
// has no more.
double four_digits(double value) { return std::stod(fmt::format("{:.4g}", value)); }

// What a geometry head says of a view that is all it sees.
struct MeasuredView {
  double log_unit = 0;           // log(metres / unit): the median over its pixels
  std::vector<double> features;  // single_view_features()
};

// Returns it of a scene's first view, and nothing where no pixel tells the unit or something is not finite.
std::optional<MeasuredView> measured_view(const LatentSpace& space, const GeometryHead& head,
                                          const TrainingScene& scene) {
  ConditioningNeeds needs;
  needs.head_depth = true;
  const auto encoded = encode_sources(space, scene.images.slice(0, 0, 1), needs);
  const auto said = source_geometry(head, encoded).depth.to(torch::kCPU, torch::kFloat64);
  const auto truth = scene.depth.slice(0, 0, 1).to(torch::kCPU, torch::kFloat64);
  const auto depth = torch::adaptive_avg_pool2d(said.unsqueeze(1), {truth.size(1), truth.size(2)}).squeeze(1);
  const auto known = torch::isfinite(truth)
                         .logical_and(truth > 0)
                         .logical_and(torch::isfinite(depth))
                         .logical_and(depth > 0);
  if (!known.any().item<bool>()) return std::nullopt;
  const auto features = single_view_features(look_of_view(encoded.for_geometry.levels.front()[0], said[0]),
                                             scene.views.cameras.front())
                            .contiguous();
  if (!torch::isfinite(features).all().item<bool>()) return std::nullopt;
  MeasuredView view;
  view.log_unit =
      (truth.masked_select(known).log() - depth.masked_select(known).log()).median().item<double>();
  view.features.assign(features.data_ptr<double>(), features.data_ptr<double>() + features.numel());
  return view;
}

// Returns the guess that these views allow, and nothing where they are too few to tell.
std::optional<SingleViewUnit> fitted_unit(const std::vector<MeasuredView>& views) {
  constexpr size_t kFewestViews = 16;
  if (views.size() < kFewestViews) return std::nullopt;
  std::vector<torch::Tensor> features;
  std::vector<double> log_units;
  for (const MeasuredView& view : views) {
    features.push_back(torch::tensor(view.features, torch::kFloat64));
    log_units.push_back(view.log_unit);
  }
  return fit_single_view_unit(torch::stack(features), log_units);
}

void tell_narrow_decoder(const GeneratorOptions& part) {
  const auto note = narrow_decoder_note(part.dit);
  if (!note.empty()) std::cerr << "note: " << generator_name(part.generator) << '.' << note << '\n';
}

}  // namespace

FrozenParts frozen_parts_of_sampling(const ModelBundle& bundle, int64_t warped_sources,
                                     const ParameterPlacement& placement, CarryingDepth carried_by) {
  FrozenParts frozen;
  frozen.space =
      std::make_shared<LatentSpace>(bundle.load_backbone(placement), bundle.options().boundary_level);
  if (warped_sources > 0) {
    frozen.geometry_head = bundle.load_geometry_head(placement);
    if (carried_by == CarryingDepth::kPhotographs && bundle.has(BundlePart::depth_refinement()))
      frozen.depth_refinement = bundle.load_depth_refinement(placement);
  }
  if (bundle.has(bundle.image_decoder_part())) frozen.rgb_decoder = bundle.load_image_decoder(placement);
  return frozen;
}

FrozenParts frozen_parts(const ModelBundle& bundle, const LevelGenerator& generator,
                         const ParameterPlacement& placement, CarryingDepth carried_by) {
  const auto& model = bundle.options();
  FrozenParts frozen =
      frozen_parts_of_sampling(bundle, model.generator(generator).dit.warped_sources, placement, carried_by);
  frozen.statistics = bundle.load_statistics(generator).to(placement.device);
  if (generator.is_cascade()) {
    for (const auto& part : model.generators) {
      if (part.generator.level != *generator.deeper) continue;
      frozen.deeper_statistics = bundle.load_statistics(part.generator).to(placement.device);
    }
  }
  return frozen;
}

namespace {

// Where latents of that generator are kept for other runs.
std::shared_ptr<const KeptFolder> kept_latent_folder(const TrainOptions& options, const ModelBundle& bundle,
                                                     const LevelGenerator& generator,
                                                     CarryingDepth carried_by, const torch::Device& device) {
  std::vector<BundlePart> frozen = {BundlePart::backbone(), BundlePart::geometry_head(),
                                    BundlePart::depth_refinement(), BundlePart::statistics(generator.level),
                                    BundlePart::special_statistics(generator.level)};
  if (generator.is_cascade()) {
    frozen.push_back(BundlePart::statistics(*generator.deeper));
    frozen.push_back(BundlePart::special_statistics(*generator.deeper));
  }
  const DitOptions& dit = bundle.options().generator(generator).dit;
  return kept_scene_folder(options, bundle, frozen, device,
                           fmt::format("latents of {}\nspecial tokens {}, warped sources {}, carried by {}",
                                       generator_name(generator), dit.num_special_tokens, dit.warped_sources,
                                       static_cast<int>(carried_by)));
}

}  // namespace

void TrainLevelOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.integer({"level", "level to generate, one that the model generates from noise"}, level, {0, 16});
  visitor.group({"objective", "flow matching"}, objective);
}

void TrainCascadeOptions::visit(FieldVisitor& visitor) {
  TrainOptions::visit(visitor);
  visitor.text({"cascade", "which cascade of the model, from the deeper level to the one it generates"},
               cascade);
  visitor.group({"objective", "flow matching and noise on the deeper level"}, objective);
}

std::string train_level(const TrainLevelOptions& options, const DrawValidation& draw) {
  const LevelGenerator generator = level_model(options.level);
  const bool with_depth = options.objective.correspondence_weight > 0;
  TrainingStage stage =
      scene_stage("train level", options, with_depth ? FrameParts::kImageAndDepth : FrameParts::kImage);
  stage.made = {BundlePart::of(generator)};
  stage.start = options.objective.start;
  stage.objective = [&options, generator](const ModelBundle& bundle, const ParameterPlacement& placement) {
    tell_narrow_decoder(bundle.options().generator(generator));
    auto objective = std::make_unique<LevelObjective>(
        bundle.options(), options.level, options.objective,
        frozen_parts(bundle, generator, placement, options.objective.carried_by), placement,
        options.loop.seed);
    objective->keep_in(
        kept_latent_folder(options, bundle, generator, options.objective.carried_by, placement.device));
    if (options.objective.start == ModelStart::kBundle) {
      objective->start_from(*bundle.load_generator(generator, placement));
    }
    return objective;
  };
  return run_training_stage(options, options, TrainLevelOptions(), stage, draw);
}

std::string train_cascade(const TrainCascadeOptions& options, const DrawValidation& draw) {
  const LevelGenerator generator = generator_from_text(options.cascade, "--cascade");
  if (!generator.is_cascade()) {
    fail({"--cascade", "a cascade such as 1->0", "'" + options.cascade + "'",
          "gld train level trains levels"});
  }
  const bool with_depth = options.objective.flow.correspondence_weight > 0;
  TrainingStage stage =
      scene_stage("train cascade", options, with_depth ? FrameParts::kImageAndDepth : FrameParts::kImage);
  stage.made = {BundlePart::of(generator)};
  stage.start = options.objective.flow.start;
  stage.objective = [&options, generator](const ModelBundle& bundle, const ParameterPlacement& placement) {
    tell_narrow_decoder(bundle.options().generator(generator));
    auto objective = std::make_unique<CascadeObjective>(
        bundle.options(), generator, options.objective,
        frozen_parts(bundle, generator, placement, options.objective.flow.carried_by), placement,
        options.loop.seed);
    objective->keep_in(
        kept_latent_folder(options, bundle, generator, options.objective.flow.carried_by, placement.device));
    if (options.objective.flow.start == ModelStart::kBundle) {
      objective->start_from(*bundle.load_generator(generator, placement));
    }
    return objective;
  };
  return run_training_stage(options, options, TrainCascadeOptions(), stage, draw);
}

StatsOptions::StatsOptions() { data.validation_scenes = 0; }

void StatsOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "bundle folder with a trained backbone"}, model);
  visit_out(visitor, out, overwrite);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visitor.integer({"scene_count", "training scenes to look at"}, scene_count, {1, 1'000'000'000});
  visitor.group(
      {"processes", "several processes that share the scenes; torchrun sets the environment that is meant"},
      processes);
  visitor.group({"data", "the training data"}, data);
}

void StatsOptions::check() const {
  if (model.empty()) {
    fail({"--model", "a bundle folder with a trained backbone", "nothing",
          "add for example --model configs/tiny"});
  }
  check_out(out, "runs/stats");
  check_input_survives("--model", model, out, overwrite);
}

std::string compute_statistics(const StatsOptions& options) {
  const torch::NoGradGuard no_grad;
  const ProcessShare share = join_others(options.processes);
  use_threads(share.threads(options.threads));
  if (share.leads()) check_run_folder(options.out, "stats", earlier_run(options.overwrite));
  const auto bundle = ModelBundle::open(options.model);
  if (!share.team->alone()) check_same_work(*share.team, options, bundle.content_hash());
  ParameterPlacement placement;
  placement.device = device_from_text(share.device(options.device));
  const BundleOptions& model = bundle.options();
  const LatentSpace space(bundle.load_backbone(placement), model.boundary_level);
  // Drawn scenes are in metres.
  const bool measures_unit =
      model.has_geometry() && model.geometry_head.predicts_rays() && options.data.scenes.empty();
  const auto head = measures_unit && bundle.has(BundlePart::geometry_head())
                        ? bundle.load_geometry_head(placement)
                        : nullptr;
  const DatasetBatches data(options.data, model.image_sizes(),
                            head ? FrameParts::kImageAndDepth : FrameParts::kImage);
  std::optional<RunFolder> folder;
  if (share.leads()) folder.emplace(options.out, "stats", options, earlier_run(options.overwrite));

  std::vector<LevelMoments> moments = moments_of(model);
  std::vector<std::vector<LevelMoments>> of_scenes;  // a few kilobytes each
  std::optional<Progress> progress;
  if (share.leads()) progress.emplace("latent statistics", options.scene_count);
  int64_t scenes = 0;
  std::vector<MeasuredView> single_views;
  PieceOfWork batches;
  // The moments of each of the batch's scenes by itself.
  batches.make = [&](int64_t index) {
    stop_if_interrupted("statistics stopped after " + std::to_string(scenes) +
                        " scenes; nothing was written");
    auto record = nlohmann::json::array();
    for (const TrainingScene& on_host : data.batch(index).scenes) {
      const TrainingScene scene = on_host.to(placement.device);
      const auto levels = space.encode(scene.images, model.level_set().deepest_generated());
      std::vector<LevelMoments> own = moments_of(model);
      for (auto& moment : own) {
        const auto& level = levels.at(static_cast<size_t>(moment.level));
        add_features(moment.moments, moment.special ? level.narrow(1, 0, space.leading_tokens())
                                                    : level.slice(1, space.leading_tokens()));
      }
      nlohmann::json of_scene{{"moments", moments_record(own)}};
      if (head) {
        if (const auto view = measured_view(space, *head, scene)) {
          of_scene["log_unit"] = view->log_unit;
          of_scene["single_view"] = view->features;
        }
      }
      record.push_back(std::move(of_scene));
    }
    return record.dump();
  };
  // In the order of scenes, so that the sums do not depend on who computed them.
  batches.take = [&](int64_t, const std::string& made) {
    for (const auto& scene : nlohmann::json::parse(made)) {
      if (scenes == options.scene_count) return;
      merge_record(scene.at("moments"), moments);
      of_scenes.push_back(moments_of(model));
      merge_record(scene.at("moments"), of_scenes.back());
      if (scene.contains("log_unit")) {
        single_views.push_back(
            {scene.at("log_unit").get<double>(), scene.at("single_view").get<std::vector<double>>()});
      }
      ++scenes;
      if (progress) progress->update(scenes);
    }
  };
  const int64_t batch_size = options.data.loading.batch_size;
  std::vector<int64_t> indices(static_cast<size_t>((options.scene_count + batch_size - 1) / batch_size));
  std::iota(indices.begin(), indices.end(), 0);
  share_pieces(share, indices, batches);
  if (!share.leads()) return {};
  progress->finish();

  const auto made = folder->path() / "model";
  BundleOptions with_unit = model;
  // One that was measured elsewhere is not of these scenes.
  with_unit.single_source_unit = with_unit.single_source_unit_deviation = 0;
  nlohmann::ordered_json unit_report;
  const std::optional<SingleViewUnit> unit = fitted_unit(single_views);
  if (!single_views.empty()) {
    std::vector<double> log_units;
    log_units.reserve(single_views.size());
    for (const MeasuredView& view : single_views) log_units.push_back(view.log_unit);
    const auto logs = torch::tensor(log_units, torch::kFloat64);
    with_unit.single_source_unit = four_digits(std::exp(logs.mean().item<double>()));
    with_unit.single_source_unit_deviation = four_digits(logs.std(/*unbiased=*/false).item<double>());
    unit_report = {{"metres", with_unit.single_source_unit},
                   {"log_deviation", with_unit.single_source_unit_deviation},
                   {"scenes", log_units.size()}};
    if (unit) unit_report["log_deviation_by_view"] = four_digits(unit->log_deviation);
  }
  save_bundle_options(made, with_unit);
  std::vector<BundlePart> parts;
  parts.reserve(moments.size());
  for (const auto& moment : moments) parts.push_back(moment.part());
  copy_other_parts(bundle, made, parts);
  nlohmann::ordered_json report = {
      {"command", "stats"}, {"scenes", scenes}, {"tokens", moments.front().moments.count()}};
  if (!unit_report.is_null()) report["single_source_unit"] = unit_report;
  for (const auto& moment : moments) {
    const auto statistics = statistics_of(moment.moments, model.latent_epsilon);
    save_bundle_part(made, moment.part(), statistics_tensors(statistics));
    const auto deviation = statistics.variance.sqrt();
    report[bundle_part_name(moment.part())] = {{"largest_mean", statistics.mean.abs().max().item<double>()},
                                               {"smallest_deviation", deviation.min().item<double>()},
                                               {"largest_deviation", deviation.max().item<double>()}};
  }
  const auto with_statistics = ModelBundle::open(made);
  note_what_was_trained_on(with_statistics, parts);
  // An earlier one is not of these scenes.
  std::filesystem::remove(made / kSingleViewUnitFile);
  if (unit) write_single_view_unit(with_statistics, *unit);
  SeenScenes seen = seen_scenes(moments, of_scenes, model.latent_epsilon);
  seen.drawn = options.data.scenes.empty();
  write_seen_scenes(with_statistics, seen);
  folder->write_report(report);
  folder->note("model", "model");
  folder->note("report", "report.json");
  return folder->closing_box();
}

}  // namespace gld
