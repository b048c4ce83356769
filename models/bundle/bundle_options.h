#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"
#include "models/backbones/backbone_registry.h"
#include "models/decoders/geometry_head_registry.h"
#include "models/decoders/rgb_decoder.h"
#include "models/dit/dit_options.h"
#include "models/latent_spaces/level_set.h"
#include "models/layers/pixel_unet_options.h"
#include "models/refiner/refiner_options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Reads "504x280" (width x height); throws Error naming where otherwise.
ImageSize image_size_from_text(const std::string& text, const std::string& where);

// s of t' = s t / (1 + (s - 1) t), which training draws with and sampling runs with (DESIGN.md section 4, "Flow").
// Defaults are those of the released checkpoints; 0 is the paper's rule, from the shape of each latent (time_shift_of
// in gld/flow/flow.h), for new models.
struct TimeShiftOptions : OptionsGroup {
  double training = 19.60;
  double evaluation = 31.18;

  void visit(FieldVisitor& visitor) override;
};

// A part that generates a level: which, its DiT^DH, and the time shift it was trained with.
struct GeneratorOptions {
  LevelGenerator generator;
  DitOptions dit;
  TimeShiftOptions time_shift;
};

// Everything about a model that its weights cannot tell: model.yaml of a bundle. `generated` lists the generators, and
// each has groups of its own there: its name (generator_name), and <name>_time_shift. A model.yaml without `generated`
// is the published set, [1, 1->0].
struct BundleOptions : OptionsGroup {
  std::string name = "unnamed";
  BackboneOptions backbone;
  GeometryHeadOptions geometry_head;
  RgbDecoderOptions rgb_decoder;
  PixelUnetOptions blending;
  PixelUnetOptions depth_refinement;
  RefinerOptions refiner;
  std::vector<GeneratorOptions> generators;  // in the order of sampling
  int64_t boundary_level = 1;                // level that propagation starts from
  std::vector<int64_t> decoded_levels;       // that the RGB decoder takes; all when empty
  double latent_epsilon = 1e-5;              // added to the variance of latent statistics
  std::vector<std::string> trained_sizes = {"504x504", "504x378", "504x336", "504x280"};
  // Metres that a unit of the geometry head is long when it sees one source view alone, in scenes like those that the
  // model was trained on (gld stats: exp of the mean logarithm); 0: not known. One view leaves the unit open, and this
  // is the best guess of it.
  double single_source_unit = 0;
  double single_source_unit_deviation = 0;  // of that logarithm, one standard deviation; 0: not known

  // The defaults are DA3-Base with the sizes of the paper, and the time shifts of its released checkpoints.
  BundleOptions();
  void visit(FieldVisitor& visitor) override;
  // Checks that the parts fit each other: channels, patch sizes, a set of levels that can be sampled, and sizes that
  // are whole patches.
  void check() const override;
  std::vector<ImageSize> image_sizes() const;

  LevelSet level_set() const;
  // Replaces the generators by these; those that were there keep their options.
  void set_generators(const std::vector<LevelGenerator>& wanted);
  // Throws Error naming the bundle's generators where it is none of them.
  const GeneratorOptions& generator(const LevelGenerator& generator) const;
  GeneratorOptions& generator(const LevelGenerator& generator);
  // Returns whether the model has a geometry head and it can run: it takes all levels.
  bool has_geometry() const;
  // Returns the unit by which a single source's depth is carried (source_depth_of_head()), 0 for none: ours is in
  // metres, so that of scenes in another unit nothing is known.
  double unit_of_single_source(const Views& views, bool metric) const;
  // Returns whether images come from an RGB decoder, and not from the other half of an autoencoder.
  bool has_rgb_decoder() const { return !backbone.architecture().decodes_images(); }
};

// Returns a new model of the deepest level of a backbone that propagates none, without geometry: DINOv2, or an
// autoencoder. Its time shift is the paper's.
BundleOptions single_level_options(const std::string& name, const BackboneOptions& backbone);

}  // namespace gld
