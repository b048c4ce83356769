#pragma once

#include "gld/base/options.h"
#include "gld/camera_encoding/camera_conditioning.h"
#include "gld/camera_encoding/prope.h"
#include "gld/cameras/relative_cameras.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// What the condition encoder sees beside the source features: the noisy latent itself (level models), or the
// generated deeper level (cascade).
enum class DitConditioning { kNone, kDeeperLevel };

enum class UnconditionalIntrinsics { kIdentity, kKeep };
enum class CameraEmbeddingInput { kConditionEncoder, kVelocityDecoder };
enum class PositionEmbedding { kNone, kSinCos };
// What the last layer gives: the velocity, as the published models, or the data, from which the velocity follows as
// (x_t - data) min(1/t, largest_inverse_time). Below t = 1 / largest_inverse_time the layer's target is then x_t minus
// that share of the velocity, which is still exact: the bound only keeps its errors from growing without limit.
enum class FlowPrediction { kVelocity, kData };
// How what was carried and what the network predicts make the data (DitDh, "First guess").
enum class CarriedGuess {
  kMixed,     // a mixture: where the one counts, the other does not
  kCorrected  // the best guess without the network, which predicts its error in units of that error's deviation
};

// A DiT^DH (DESIGN.md section 4). Pairs are [condition encoder, velocity decoder]. Defaults are a new level model
// on DA3-Base features; apply_published_conventions() sets what the released checkpoints were trained with.
struct DitOptions : OptionsGroup {
  int64_t in_channels = 1536;  // C of the level
  std::vector<int64_t> hidden_size = {768, 2048};
  std::vector<int64_t> depth = {28, 2};
  std::vector<int64_t> num_heads = {16, 16};
  double mlp_ratio = 4.0;
  int64_t patch_size = 1;
  bool qk_norm = false;
  int64_t camera_patch_size = 14;
  int64_t num_special_tokens = 0;
  bool split_embedders = true;
  DitConditioning conditioning = DitConditioning::kNone;
  TranslationUnit translation_unit = TranslationUnit::kLargestComponent;
  std::string prope_image_size = "image";  // or a number of pixels
  PropeInverse prope_inverse = PropeInverse::kTrue;
  PropeFrame prope_frame = PropeFrame::kReferenceView;
  UnconditionalIntrinsics unconditional_intrinsics = UnconditionalIntrinsics::kIdentity;
  CameraEmbeddingInput camera_embedding_input = CameraEmbeddingInput::kConditionEncoder;
  PositionEmbedding position_embedding = PositionEmbedding::kNone;
  std::vector<double> pixel_offset = {0.5, 0.5};
  FlowPrediction prediction = FlowPrediction::kVelocity;
  double largest_inverse_time = 5;  // prediction of data only
  // Photographs of source views that are carried into target views by their depth: how far so many of them agree is
  // embedded, beside features of all together (docs/DESIGN.md section 4, "Carried photographs"); 0: nothing of it, as
  // published.
  int64_t warped_sources = 0;
  // Mean squared error of those features where the photographs agree, in units of the latent's variance: the
  // prediction of the data then begins at them (DitDh, "First guess"); 0: they are embedded and no more.
  double carried_error = 0;
  CarriedGuess carried_guess = CarriedGuess::kMixed;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  int64_t encoder_width() const { return hidden_size[0]; }
  int64_t decoder_width() const { return hidden_size[1]; }
  int64_t encoder_blocks() const { return depth[0]; }
  int64_t decoder_blocks() const { return depth[1]; }
  int64_t camera_width() const {
    return camera_embedding_input == CameraEmbeddingInput::kConditionEncoder ? hidden_size[0]
                                                                             : hidden_size[1];
  }
  // Returns int(2/3 int(width mlp_ratio)), the rounding of the published code: 2048 for 768, 5461 for 2048.
  int64_t swiglu_width(int64_t width) const;
  // Returns the pixels by which PRoPE normalises intrinsics; 0 for each view's own size.
  int64_t prope_pixels() const;
  PixelOffset camera_pixel_offset() const { return {pixel_offset[0], pixel_offset[1]}; }
  PropeCameras unconditional_cameras() const {
    return unconditional_intrinsics == UnconditionalIntrinsics::kIdentity ? PropeCameras::kIdentity
                                                                          : PropeCameras::kIdentityPose;
  }
  // Returns whether the condition encoder's input changes with the noisy latent. It does not in a cascade without
  // special tokens; its output is then a function of the flow time alone.
  bool encoder_sees_noisy() const { return conditioning == DitConditioning::kNone || num_special_tokens > 0; }
};

// Returns what to tell whoever trains a velocity decoder that is narrower than the latent; empty where it is not. The
// velocity holds the noise of every channel (Zheng et al. 2025, RAE, section 4), but the last linear layer only reaches
// hidden_size[1] directions: whatever is learnt, the loss stays above 1 - hidden_size[1] / in_channels (the noise has
// variance 1), and a sample keeps the noise that was not predicted.
std::string narrow_decoder_note(const DitOptions& options);

// Sets the conventions of the released checkpoints that their weights cannot tell: the published inverse in PRoPE, its
// frame, and pixel coordinates (column - 0.5, row + 0.5).
void apply_published_conventions(DitOptions& options);

}  // namespace gld
