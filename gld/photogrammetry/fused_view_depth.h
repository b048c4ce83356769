#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/view_maps.h"

#include <optional>
#include <vector>

namespace gld {

// A source view whose depth is known, in the unit of the cameras, and how far photographs confirm it: confidence from 0
// to 1, of the depth's size, or empty where nothing does.
struct ConfirmedDepth {
  PicturedView view;
  ConfidenceMap confidence;
};

struct FusedViewDepth {
  PlanarDepth
      depth;  // of the predicted map's size, in the unit of the cameras; empty where no source tells the unit
  std::vector<float> confirmed;  // (height, width): how far photographs confirm it, from 0 to 1
  double unit = 1;               // the length of the prediction's unit: the median of depth / predicted
};

// A prediction of every pixel's depth, in a unit of its own.
struct PredictedDepth {
  PlanarDepth depth;
  // From 0 to 1: how far its shape is believed (belief_in_prior()). A head that saw nothing like the scene says less
  // than what is around a gap.
  double believed = 1;
};

// Returns how far the shape of a prediction is believed of which photographs say that much: half where the logarithm of
// its ratio to theirs spreads by a quarter. All of it is believed where they say nothing.
double belief_in_prior(const std::optional<PriorAgreement>& prior);

// Returns the depth of a target view from two that know it: what the sources show from there, in the unit of the
// cameras and only where they see it, and the prediction. What photographs confirm stands. Where a source says a depth
// that none confirms, it and a prediction that is believed count alike (the mean of the logarithms). What no source
// sees is the prediction moved by the logarithm of the ratio that confirmed pixels around it have
// (gld/photogrammetry/membrane.h), or where there are hardly any, by the median ratio of all pixels that sources see;
// and as far as the prediction is not believed, the smooth surface through what sources show around. So there is no
// step where the sources end. reach is how far depths may be off that sources say, a natural logarithm
// (SourceDepth::reach).
FusedViewDepth fused_target_depth(const std::vector<ConfirmedDepth>& sources, double reach,
                                  const Camera& target, const PredictedDepth& predicted);

// Returns the same of a source view, which says its own depth.
FusedViewDepth fused_source_depth(const ConfirmedDepth& source, const PredictedDepth& predicted);

}  // namespace gld
