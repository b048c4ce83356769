#pragma once

#include "gld/tensors/weight_tensors.h"
#include "models/backbones/da3_backbone.h"
#include "models/bundle/bundle_options.h"
#include "models/decoders/dpt_head.h"
#include "train/data/kept_folder.h"
#include "train/data/training_data.h"
#include "train/loop/training_loop.h"

#include <filesystem>
#include <string>

namespace gld::test {

// Returns a model of the same structure as the published one, small enough for a step in milliseconds.
inline BundleOptions small_model() {
  BundleOptions model;
  model.name = "small";
  Da3BackboneOptions backbone;
  backbone.embed_dim = 32;
  backbone.depth = 8;
  backbone.num_heads = 2;
  backbone.pos_embed_grid = 4;
  backbone.out_layers = {1, 3, 5, 7};
  backbone.alternating_start = 2;
  backbone.qk_norm_start = 2;
  backbone.rope_start = 2;
  model.backbone = backbone;
  auto& head = model.geometry_head.as<DptHeadOptions>();
  head.dim_in = 64;
  head.features = 16;
  head.out_channels = {8, 8, 16, 16};
  head.aux_out1_conv_num = 1;
  model.rgb_decoder.in_channels = 256;
  model.rgb_decoder.hidden_size = 32;
  model.rgb_decoder.num_layers = 2;
  model.rgb_decoder.num_heads = 2;
  model.rgb_decoder.intermediate_size = 64;
  model.rgb_decoder.base_image_size = 56;
  for (auto& part : model.generators) {
    part.dit.in_channels = 64;
    part.dit.hidden_size = {32, 64};
    part.dit.depth = {2, 1};
    part.dit.num_heads = {2, 4};
    part.time_shift.training = part.time_shift.evaluation = 3.0;
  }
  model.trained_sizes = {"56x56", "56x42"};
  return model;
}

inline TrainingDataOptions small_data() {
  TrainingDataOptions data;
  data.synthetic.frames = 8;
  data.synthetic.width = data.synthetic.height = 56;
  data.views.views = 3;
  data.views.longest_interval = 2;
  data.views.fewest_sources = 1;
  data.views.most_sources = 2;
  data.loading.batch_size = 1;
  data.validation_scenes = 2;
  return data;
}

inline TrainingDataOptions scenes_of_two_sources() {
  TrainingDataOptions data = small_data();
  data.views.fewest_sources = data.views.most_sources = 2;
  return data;
}

inline TrainingLoopOptions two_steps() {
  TrainingLoopOptions options;
  options.steps = 2;
  options.micro_batches = 2;
  options.log_every = 1;
  options.checkpoint_every = 1;
  options.validate_every = 1;
  options.learning_rate.peak = 1e-3;
  return options;
}

// Makes another thing of every file of a KeptFolder: that part times two.
inline void double_kept(const std::filesystem::path& folder, const std::string& part) {
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    KeptTensors tensors;
    for (const auto& [name, tensor] : read_all(entry.path())) tensors[name] = tensor.clone();
    if (tensors.count(part) > 0) tensors[part] = tensors[part] * 2;
    save_safetensors(entry.path(), tensors);
  }
}

// Two steps of any kind of training.
template <class Options>
Options training_options(const std::filesystem::path& model, const std::filesystem::path& out) {
  Options options;
  options.model = model.string();
  options.out = out.string();
  options.threads = 1;
  options.data = small_data();
  options.loop = two_steps();
  return options;
}

}  // namespace gld::test
