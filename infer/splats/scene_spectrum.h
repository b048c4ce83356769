#pragma once

#include "datasets/splats/scene_fit.h"
#include "gld/splatting/feature_solve.h"
#include "models/splats/latent_fit.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// What is splatted of a scene.
struct SpectrumSettings {
  int64_t latent_side = 32;  // latent pixels a side
  int64_t side = 256;        // pixels of the square pictures that geometry is fitted to
  int64_t held_out = 5;
  int64_t seed = 0;
  SplatFitOptions fit;
  FeatureSolveOptions solve;
  std::vector<ModelBundle> models;
  std::vector<std::string> levels{"all"};
  KernelSettings kernels;
};

// Rings of the views of one kind of a scene, mean over views (gld/metrics/latent_spectrum.h), float64: under Hann's
// window, and without one, as Splatent has it, where the pictures' edges leak into all rings.
struct ViewSpectrum {
  torch::Tensor encoded, rendered;
  torch::Tensor plain_encoded, plain_rendered;
};

// A latent space in a scene.
struct SpaceSpectrum {
  std::string space;  // "RGB", "noise", "GLD tiny, level 0"
  LatentTag tag;
  ViewSpectrum held_out, fitted;
  double held_out_error = 0;       // latent_error
  torch::Tensor encoded_picture;   // (3, side, side): the first held-out view by its principal directions
  torch::Tensor rendered_picture;  // in the same colours
};
struct SceneSpectrum {
  std::string scene;
  int64_t gaussians = 0;
  double held_out_psnr = 0;  // dB, of the colours that geometry comes from
  torch::Tensor picture;     // (3, side, side): the first held-out view
  std::vector<SpaceSpectrum> spaces;
};

// Names of the spaces in the order of SceneSpectrum::spaces.
constexpr const char* kColourSpace = "RGB";
constexpr const char* kNoiseSpace = "noise";

// Geometry is fitted to colours and stands still. Then features are solved for from the fitted views, in every space
// alike, and seen by the held-out ones: colours averaged to the latent's grid, a texture fixed in the world (the
// control), each level of each model. All views of a model are encoded together.
SceneSpectrum scene_spectrum(const Scene& scene, const SpectrumSettings& settings);

}  // namespace gld
