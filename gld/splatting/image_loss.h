#pragma once

#include "gld/splatting/compositing.h"

#include <cstdint>
#include <vector>

namespace gld {

// What a picture is compared with, and what of it the loss needs in every step.
struct LossTarget {
  SplatImage image;
  std::vector<uint8_t> valid;  // (height, width): 0 where a pixel says nothing; empty: all count
  SplatImage mean, square;     // of image and image^2 under SSIM's window
};
LossTarget loss_target(SplatImage image, std::vector<uint8_t> valid, const KernelSettings& settings);

// (1 - s) |x - y| + s (1 - SSIM(x, y)), means over all pixels and channels, as 3DGS has it with s = .2: SSIM (Wang
// et al. 2004) under a Gaussian window of 11 pixels and deviation 1.5, zeros beyond the picture, data range 1,
// population covariance. (gld/metrics has the measure of papers, over windows inside the picture.) Where a pixel
// says nothing, x is taken to be y.
struct ImageLoss {
  double loss = 0;
  double absolute = 0;    // mean |x - y|
  double similarity = 0;  // mean SSIM
  SplatImage gradient;    // d loss / d x
};
ImageLoss image_loss(const SplatImage& image, const LossTarget& target, double dissimilarity,
                     const KernelSettings& settings);

// These return the mean squared difference of valid pixels, x clamped to [0, 1], and that as peak signal-to-noise ratio
// in dB.
double mean_squared_error(const SplatImage& image, const LossTarget& target);
double decibels(double mean_squared);

}  // namespace gld
