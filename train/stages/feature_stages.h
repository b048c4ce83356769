#pragma once

#include "train/objectives/autoencoder_objective.h"
#include "train/objectives/backbone_objective.h"
#include "train/objectives/blending_objective.h"
#include "train/objectives/decoder_objective.h"
#include "train/objectives/depth_refinement_objective.h"
#include "train/stages/training_stage.h"

#include <string>

namespace gld {

struct TrainBackboneOptions : TrainOptions {
  BackboneObjectiveOptions objective;
  AutoencoderObjectiveOptions autoencoder;  // of a backbone that decodes images itself
  void visit(FieldVisitor& visitor) override;
};

struct TrainDecoderOptions : TrainOptions {
  DecoderObjectiveOptions objective;
  // Published decoder training uses Adam 2e-4 to 2e-5 along a cosine, no clipping, EMA 0.9978.
  TrainDecoderOptions();
  void visit(FieldVisitor& visitor) override;
};

// Of small networks over the pixels of photographs, for scenes of two sources or more.
struct TrainPhotographOptions : TrainOptions {
  TrainPhotographOptions();
};

struct TrainDepthOptions : TrainPhotographOptions {
  DepthRefinementObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

struct TrainBlendingOptions : TrainPhotographOptions {
  BlendingObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

// gld train backbone, decoder, depth and blending; see run_training_stage.
std::string train_backbone(const TrainBackboneOptions& options, const DrawValidation& draw);
std::string train_decoder(const TrainDecoderOptions& options, const DrawValidation& draw);
std::string train_depth(const TrainDepthOptions& options, const DrawValidation& draw);
std::string train_blending(const TrainBlendingOptions& options, const DrawValidation& draw);

}  // namespace gld
