#pragma once

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// The energy score of a prediction that is drawn (Gneiting and Raftery 2007, eq. 21), of samples x, x' of it and the
// truth y:
//
//   E|x - y| - E|x - x'| / 2        less is better
//
// It is strictly proper: nothing has a lower expected score than the distribution that the truth was drawn from. The
// mean of that distribution, a blur, loses because of the first term, and one invention for all samples as well;
// samples that differ more than the truth does lose more in the first term than they gain in the second. A prediction
// without chance has its distance from the truth as its score, so that it can stand beside one that is drawn.
//
// E|x - x'| is the mean over pairs of different samples, so the estimate is unbiased for any number of them from 2 on,
// and scores of different numbers of samples can be compared. Of one sample there is no pair: its score is its
// distance, as if it had no chance, which a blur wins. Each sample is paired with the kMostPartners before it, of
// independent samples all the same in the mean.
//
// The distance |.| is Euclidean in what pictures are compared by, because a score of another function of it need not be
// proper: the root mean square over pixels and colours, 10^(-PSNR / 20), or over random features
// (gld/metrics/random_features.h), the square root of their distance.
//
// truth: (views, 3, height, width); samples: (samples, views, 3, height, width), at least one; clamped to [0, 1].
// pixels: (views, height, width), bool, what counts; undefined for all. It must not depend on the samples. Features
// count by the share of such pixels that their place in the map covers, and see a few pixels beyond. Returns (views),
// float64, each view a score of its own (what views of a sample have to do with each other is not seen); NaN for a view
// without such a pixel. Equal to the bit whatever the number of threads. Throws Error for other shapes, and for
// features of images below 8 pixels.
torch::Tensor energy_score(const torch::Tensor& truth, const torch::Tensor& samples,
                           const torch::Tensor& pixels = {});
torch::Tensor energy_score_of_features(const torch::Tensor& truth, const torch::Tensor& samples,
                                       const torch::Tensor& pixels = {});

constexpr int64_t kMostPartners = 63;

}  // namespace gld
