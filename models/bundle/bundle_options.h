#pragma once

#include "gld/base/options.h"
#include "gld/cameras/image_size.h"
#include "models/backbones/da3_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/dit/dit_options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Reads "504x280" (width x height); Error naming where otherwise.
ImageSize image_size_from_text(const std::string& text, const std::string& where);

// s of t' = s t / (1 + (s - 1) t), which training draws with and sampling runs with (DESIGN.md section 4, "Flow").
// Defaults are those of the released checkpoints.
struct TimeShiftOptions : OptionsGroup {
  double training = 19.60;
  double evaluation = 31.18;

  void visit(FieldVisitor& visitor) override;
};

// Everything about a model that its weights cannot tell: model.yaml of a bundle.
struct BundleOptions : OptionsGroup {
  std::string name = "unnamed";
  Da3BackboneOptions backbone;
  DptHeadOptions dpt_head;
  RgbDecoderOptions rgb_decoder;
  DitOptions level1;
  DitOptions cascade;
  TimeShiftOptions level1_time_shift;
  TimeShiftOptions cascade_time_shift;
  int64_t boundary_level = 1;    // level that M1 generates and propagation starts from
  double latent_epsilon = 1e-5;  // added to the variance of latent statistics
  std::vector<std::string> trained_sizes = {"504x504", "504x378", "504x336", "504x280"};

  // A new DA3-Base model as in the paper.
  BundleOptions();
  void visit(FieldVisitor& visitor) override;
  // The parts fit each other: channels, patch sizes, levels, and sizes that are whole patches.
  void check() const override;
  std::vector<ImageSize> image_sizes() const;
};

// What the released DA3-Base checkpoints need: 28-layer RGB decoder, cascade with single embedders, published
// conventions of cameras.
BundleOptions released_da3_options();

}  // namespace gld
