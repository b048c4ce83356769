#pragma once

#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/stereo_picture.h"
#include "gld/photogrammetry/swept_views.h"

#include <optional>
#include <vector>

namespace gld {

// Of a plane-sweep stereo (plane_sweep_stereo.h): a model's depth as a prior of what photographs are matched for.

// Returns the prior at every pixel of the view's picture, and 0 where not known.
std::vector<float> prior_at(const PicturedView& view, const StereoPicture& picture);

// Returns what the confident pixels of a pass say of the priors, one a view as prior_at() gives them, and nothing where
// there is none.
std::optional<PriorAgreement> prior_agreement(const std::vector<StereoDepth>& found,
                                              const std::vector<std::vector<float>>& priors);

// Returns a prior as costs take it, as far as that agreement lets it be believed.
ScaledPrior scaled_prior(const std::vector<float>& prior, const PriorAgreement& agreement);

// Returns whether a prior of that agreement is near enough to the truth for its depths to be looked at.
bool widens_range(const PriorAgreement& agreement);

// Makes each pixel's logarithm of depth the mean of photographs and prior, by how far both are sure; what is seen to be
// far stays so.
void put_prior_in(StereoDepth& found, const SweptView& swept, const PriorAgreement& agreement);

// Takes the prior, times that scale, for a view of which photographs tell nothing.
void take_prior(StereoDepth& result, const std::vector<float>& prior, double scale);

}  // namespace gld
