#pragma once

#include <cstdint>

#include <torch/types.h>

namespace gld {

// How much of each frequency latents hold, as Splatent (arXiv 2512.09923, figure 3) has it: |FFT2| of raw latents, mean
// over channels, over the frequencies of each ring round(sqrt(kx^2 + ky^2)), and over views. Ring r of a grid of n
// pixels a side has r periods over the grid. Not normalised: compare what has one size.
//
// Under Hann's window each channel's mean is taken away and what is left multiplied by a window of mean square 1: the
// picture's edges, which FFT2 takes to meet, then do not leak into the high rings. |DC| is that of the picture
// without it.
enum class SpectrumWindow { kNone, kHann };

// latents is (views, channels, n, n), of any floating type. Returns rings 0 (|DC|) to last_ring, float64 on the CPU.
// Throws Error for other shapes, and for a last ring beyond n / 2.
torch::Tensor ring_amplitudes(const torch::Tensor& latents, int64_t last_ring,
                              SpectrumWindow window = SpectrumWindow::kNone);

// Returns the last ring that a grid of n pixels a side has whole, n / 2 - 1.
int64_t last_whole_ring(int64_t side);

// Returns the mean over rings `first` to `last` of rendered over encoded.
double band_ratio(const torch::Tensor& rendered, const torch::Tensor& encoded, int64_t first, int64_t last);

// Returns the three directions in which the pixels of latents (views, channels, h, w) vary most, as pictures: latents
// projected on them about the mean, 2.5 deviations of each to either side being 0 and 1. Directions, mean and
// deviations are of `like`, so that two pictures of one space have the same colours. The result is (views, 3, h, w),
// float32; fewer than 3 channels leave the others at 1/2.
torch::Tensor principal_pictures(const torch::Tensor& latents, const torch::Tensor& like);

}  // namespace gld
