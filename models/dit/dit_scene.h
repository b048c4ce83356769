#pragma once

#include "gld/attention/attention.h"
#include "gld/camera_encoding/prope.h"
#include "gld/cameras/camera.h"
#include "gld/cameras/relative_cameras.h"
#include "models/dit/dit_options.h"
#include "models/dit/exact_savings.h"

#include <array>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// A DiT^DH is asked about these: the cameras, and normalised latents as tokens, special tokens (if the model has them)
// in front of each view's patch tokens.
struct DitSceneInputs {
  Views views;                    // checked with check_cameras; one size, in whole patches
  torch::Tensor source_features;  // (source views, tokens, channels)
  // Cascade only: (views, tokens, channels), with or without special tokens (they are not used).
  torch::Tensor deeper_level;
  // For DitOptions::warped_sources this says, of the photographs that were carried into target views
  // (models/scene_geometry/source_warp.h), how far each agrees with all of them, pixel by pixel, (target views,
  // warped_sources, height, width) from 0, not seen, to 1.
  torch::Tensor warp_agreement;
  // And normalised features of all of them as one picture, encoded beside the source views; they stand where a source
  // view has its source features. (target views, patch tokens, channels). Both zero where nothing is known.
  torch::Tensor warped_features;
};

// Sets that nothing is known of what is carried into target views: zeros; nothing at all for a model that takes none.
void set_no_warp(DitSceneInputs& inputs, const DitOptions& options);

enum class DitBranch { kConditional, kUnconditional };

// The cameras as one branch of guidance sees them. What is not there yet is computed at every evaluation.
struct DitBranchCameras {
  // What is added to the tokens of each part: the camera embedding where that part takes it, and what was carried into
  // target views (the unconditional branch sees none of it: it tells the cameras). Undefined where that is nothing;
  // broadcasts to (views, special + patch tokens, width); zero for special tokens.
  torch::Tensor encoder_embedding;
  torch::Tensor decoder_embedding;
  bool embedded = false;  // whether both are there
  PropeTables encoder_prope;
  PropeTables decoder_prope;
};

// Everything about a scene that does not change from one evaluation to the next. Made by DitDh::prepare_scene;
// with gradients it belongs to one training step.
struct DitScene {
  RelativeCameras cameras;
  LatentGrid grid;
  ExactSavings savings;
  torch::Tensor source_features;  // (source views, tokens, channels)
  torch::Tensor deeper_patches;   // (views, patch tokens, channels); undefined for level models
  torch::Tensor warp_agreement;   // (target views, photographs, height, width); undefined for models without
  torch::Tensor warped_features;  // (target views, patch tokens, channels); likewise
  // With carried_error these are the same for all tokens of all views, zero where nothing is carried, and how far they
  // are to be trusted, (views, tokens, 1) from 0 to 1.
  torch::Tensor guess_features;
  torch::Tensor guess_trust;
  std::array<DitBranchCameras, 2> branches;  // by DitBranch
  // Parts of the embedders' sums, (views, tokens, width); undefined where a switched-off saving leaves them to
  // every evaluation.
  torch::Tensor encoder_source;  // with the deeper level in a cascade
  torch::Tensor decoder_source;
  // In training with ActivationStorage::kKeep this is what is wanted of blocks' attention, the condition encoder's
  // blocks counted first; it is filled by every evaluation. It belongs to whoever prepared the scene.
  std::vector<AttentionTap>* taps = nullptr;

  int64_t num_sources() const { return cameras.views.num_sources; }
  const std::vector<std::string>& warnings() const { return cameras.warnings; }
};

// The noisy latent after the embedders, without cameras: the same for both branches.
struct DitNoisyTokens {
  torch::Tensor encoder;  // (views, tokens, encoder width)
  torch::Tensor decoder;  // (views, tokens, decoder width)
};

// This depends on the flow time alone.
struct DitTimeRow {
  double time = 0;
  torch::Tensor embedding;  // (1 or views, encoder width)
  std::vector<torch::Tensor>
      encoder_modulation;  // one a block of the condition encoder, (1 or views, 6 width)
};

// One of the passes that an evaluation computes together: a scene, in one branch of guidance, at its flow time. Scenes
// of a training batch are passes, and so are the two branches of a sample.
struct DitPass {
  const DitScene* scene = nullptr;
  const DitTimeRow* time = nullptr;
  DitBranch branch = DitBranch::kConditional;
};
// Tensors of an evaluation hold the views of one pass after those of the other: (passes * views, tokens, channels).
// Every pass has as many views, of as many tokens; sources, cameras, masks and times are its own. There is at least
// one.
using DitPasses = std::vector<DitPass>;

}  // namespace gld
