#include "infer/evaluate/attention_correspondence.h"

#include "datasets/loading/batching.h"
#include "gld/metrics/correspondence_metrics.h"
#include "gld/metrics/metric.h"
#include "infer/evaluate/latent_comparison.h"
#include "infer/request/scene_request.h"
#include "models/conditioning/level_conditioning.h"
#include "models/conditioning/source_conditioning.h"
#include "models/dit/flow_matching_loss.h"
#include "models/latent_spaces/latent_space.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// Taps hold queries and keys of all tokens: a few blocks an evaluation bound their memory.
constexpr int64_t kBlocksAtOnce = 8;

// What a generator is shown of a scene.
struct ShownScene {
  DitSceneInputs inputs;
  torch::Tensor clean;
};

// Returns normalised latents of the true pictures of all views, by generator, and of the sources encoded alone.
std::vector<ShownScene> shown_scenes(const EvaluationModels& models, const SamplingScene& scene,
                                     const torch::Tensor& images) {
  const LatentSpace space(models.models.backbone(), models.models.levels.boundary);
  const auto& generators = models.models.levels.generators;
  int64_t deepest = 0;
  for (const LevelGenerator& generator : generators) {
    deepest = std::max({deepest, generator.level, generator.deeper.value_or(0)});
  }
  SourceScene given{scene.views, images.narrow(0, 0, scene.views.num_sources).to(models.device), {}};
  given.single_source_unit = models.bundle.unit_of_single_source(scene.views, scene.metric);
  const auto needs = conditioning_needs(given, deepest, models.models.levels.warped_sources);
  const auto head = needs.head_depth ? models.models.geometry_head() : nullptr;
  const auto raw = space.encode(images.to(models.device), deepest);
  const SourceConditioning sources = condition_on_sources(space, head.get(), given, needs);
  std::vector<ShownScene> shown(generators.size());
  const LevelLatents clean = latents_of_levels(models.models, raw, sources.grid);
  for (size_t i = 0; i < generators.size(); ++i) {
    const LevelStatistics& statistics = models.models.statistics[i];
    const int64_t level = generators[i].level;
    shown[i].clean = clean.at(level);
    shown[i].inputs = condition_on_source_level(
        {level, models.bundle.generator(generators[i]).dit, statistics}, scene.views, sources);
    if (generators[i].is_cascade()) {
      condition_on_deeper_level(shown[i].inputs, clean.at(*generators[i].deeper));
    }
  }
  return shown;
}

// Makes of (1, tokens of all views, heads, head_dim) the maps (views, heads * head_dim, rows, columns) of the patch
// tokens.
torch::Tensor patch_maps(const torch::Tensor& tokens, const LatentGrid& grid) {
  const int64_t a_view = tokens.size(1) / grid.views, patches = grid.tokens_per_view();
  return tokens.reshape({grid.views, a_view, tokens.size(2) * tokens.size(3)})
      .narrow(1, a_view - patches, patches)
      .transpose(1, 2)
      .reshape({grid.views, -1, grid.height, grid.width})
      .to(torch::kCPU, torch::kFloat32);
}

// Returns the mean over the pairs of the first view with each other one; it is NaN without any.
double mean_pck(const AttentionTap& tap, const LatentGrid& grid, const Views& views,
                const std::vector<torch::Tensor>& depths) {
  const auto queries = patch_maps(tap.query, grid), keys = patch_maps(tap.key, grid);
  double sum = 0;
  int64_t pairs = 0;
  for (int64_t other = 1; other < grid.views; ++other) {
    const auto place = static_cast<size_t>(other);
    const double share = correct_keypoints(correspondence_errors(
        {queries[0], depths[0], views.cameras[0]}, {keys[other], depths[place], views.cameras[place]}));
    if (std::isnan(share)) continue;
    sum += share;
    ++pairs;
  }
  return sum / static_cast<double>(pairs);
}

}  // namespace

std::vector<AttentionCorrespondence> attention_correspondence(const EvaluationModels& models,
                                                              const SamplingScene& scene,
                                                              const std::vector<double>& times,
                                                              int64_t noise_seed) {
  const torch::NoGradGuard no_gradients;
  std::vector<AttentionCorrespondence> found;
  std::vector<torch::Tensor> depths;
  for (const auto* maps : {&scene.source_depths, &scene.true_depths}) {
    for (const DepthMap& depth : *maps) {
      if (depth.empty()) return found;
      depths.push_back(to_tensor(depth));
    }
  }
  const auto& truth = scene.true_images;
  if (static_cast<int64_t>(depths.size()) != scene.views.size() ||
      std::any_of(truth.begin(), truth.end(), [](const Image& image) { return image.empty(); })) {
    return found;
  }
  const auto images = torch::cat({stacked(scene.source_images), stacked(truth)});
  const LatentGrid grid = models.bundle.backbone.grid_of(images.size(0), images.size(2), images.size(3));
  const auto shown = shown_scenes(models, scene, images);
  const auto noise = scene_request(scene, models.bundle, noise_seed, models.device).noise;
  for (size_t i = 0; i < shown.size(); ++i) {
    const auto dit = models.models.generator(i);
    const int64_t encoder = dit->options().encoder_blocks(),
                  blocks = encoder + dit->options().decoder_blocks();
    for (const double time : times) {
      for (int64_t first = 0; first < blocks; first += kBlocksAtOnce) {
        std::vector<AttentionTap> taps;
        for (int64_t block = first; block < std::min(blocks, first + kBlocksAtOnce); ++block) {
          taps.push_back({block, {}, {}});
        }
        flow_matching_errors(
            *dit, shown[i].inputs,
            {shown[i].clean, noise[i].to(models.device), time, DitBranch::kConditional, &taps});
        for (const AttentionTap& tap : taps) {
          const double pck = mean_pck(tap, grid, scene.views, depths);
          if (std::isnan(pck)) continue;
          found.push_back({generator_stage(models.models.levels.generators[i]), tap.block,
                           tap.block < encoder, time, pck});
        }
      }
    }
  }
  return found;
}

namespace {

// Values over scenes by stage, block, part and time; stages in the order of sampling, times as they were asked for.
struct OverScenes {
  AttentionCorrespondence of;
  std::vector<double> values;

  double mean() const {
    double sum = 0;
    for (const double value : values) sum += value;
    return sum / static_cast<double>(values.size());
  }
};

std::vector<OverScenes> over_scenes(const std::vector<std::vector<AttentionCorrespondence>>& scenes) {
  std::vector<OverScenes> rows;
  for (const auto& scene : scenes) {
    for (const AttentionCorrespondence& number : scene) {
      const auto same = std::find_if(rows.begin(), rows.end(), [&](const OverScenes& row) {
        return std::tie(row.of.stage, row.of.block, row.of.time) ==
               std::tie(number.stage, number.block, number.time);
      });
      if (same == rows.end()) {
        rows.push_back({number, {number.pck}});
      } else {
        same->values.push_back(number.pck);
      }
    }
  }
  return rows;
}

}  // namespace

nlohmann::ordered_json attention_record(const std::vector<AttentionCorrespondence>& scene) {
  auto list = nlohmann::ordered_json::array();
  for (const AttentionCorrespondence& number : scene) {
    list.push_back({{"stage", number.stage},
                    {"block", number.block},
                    {"in_encoder", number.in_encoder},
                    {"time", number.time},
                    {"pck", number.pck}});
  }
  return list;
}

std::vector<AttentionCorrespondence> attention_from_record(const nlohmann::json& record) {
  std::vector<AttentionCorrespondence> scene;
  for (const auto& entry : record) {
    scene.push_back(
        {entry.at("stage"), entry.at("block"), entry.at("in_encoder"), entry.at("time"), entry.at("pck")});
  }
  return scene;
}

std::string attention_csv(const std::vector<std::vector<AttentionCorrespondence>>& scenes) {
  std::string text = "stage,block,part,time,pck,low_95,high_95,scenes\n";
  for (const OverScenes& row : over_scenes(scenes)) {
    const Interval interval = statistics_over_scenes(row.values).interval;
    const auto cell = [](double value) {
      return std::isnan(value) ? std::string() : fmt::format("{:.4f}", value);
    };
    text += fmt::format("{},{},{},{},{},{},{},{}\n", row.of.stage, row.of.block,
                        row.of.in_encoder ? "condition encoder" : "velocity decoder", row.of.time,
                        cell(row.mean()), cell(interval.low), cell(interval.high), row.values.size());
  }
  return text;
}

Figure attention_picture(const std::vector<std::vector<AttentionCorrespondence>>& scenes) {
  Figure figure;
  figure.title = "PCK of queries among keys of other views";
  for (const OverScenes& row : over_scenes(scenes)) {
    const auto same_stage = [&](const PlotPanel& panel) { return panel.title == row.of.stage; };
    auto panel = std::find_if(figure.panels.begin(), figure.panels.end(), same_stage);
    if (panel == figure.panels.end()) {
      PlotPanel added;
      added.title = row.of.stage;
      added.x.label = "block, the condition encoder's first";
      added.y.label = "PCK (%)";
      panel = figure.panels.insert(figure.panels.end(), std::move(added));
    }
    const std::string name = fmt::format("t = {}", row.of.time);
    const auto same_name = [&](const PlotSeries& series) { return series.name == name; };
    auto series = std::find_if(panel->series.begin(), panel->series.end(), same_name);
    if (series == panel->series.end()) {
      PlotSeries added;
      added.name = name;
      series = panel->series.insert(panel->series.end(), std::move(added));
    }
    series->points.emplace_back(static_cast<double>(row.of.block), row.mean());
  }
  return figure;
}

}  // namespace gld
