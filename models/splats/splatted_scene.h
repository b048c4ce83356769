#pragma once

#include "gld/cameras/camera.h"
#include "models/bundle/bundle.h"
#include "models/refiner/refiner_options.h"
#include "models/splats/latent_pictures.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// The views of a scene as its autoencoder sees them, and some of them as Gaussians that were fitted to the others show
// them, by features and by colours: what a refiner is trained on and what it is given. Latents are normalised by the
// model's statistics.
struct SplattedScene {
  std::string name;
  LatentTag tag;
  std::vector<Camera> cameras;  // of the pictures, those that were fitted first
  int64_t fitted = 0;           // of these
  torch::Tensor pictures;       // (views, 3, height, width), 8-bit RGB
  torch::Tensor encoded;        // (views, channels, height', width')
  // Of the other views, (views - fitted, channels, height', width'): what the Gaussians' features show of latents, and
  // what their colours show, encoded.
  torch::Tensor splatted, colours;

  int64_t views() const { return static_cast<int64_t>(cameras.size()); }
  int64_t held_out() const { return views() - fitted; }
  // Returns those that a refiner is given.
  const torch::Tensor& degraded(DegradedLatents which) const {
    return which == DegradedLatents::kColours ? colours : splatted;
  }
  std::vector<Camera> fitted_cameras() const { return {cameras.begin(), cameras.begin() + fitted}; }
};

// Writes one safetensors file: "pictures", "encoded", "splatted" and "colours" in float16, "intrinsics"
// (views, 3, 3) and "world_from_camera" (views, 4, 4) in float64; metadata "gld:scene", "gld:fitted" and
// "gld:latent_space". It is written whole or not at all.
void save_splatted_scene(const std::filesystem::path& file, const SplattedScene& scene);
// The result shares the file's memory as far as types allow. Throws Error naming the file and what is wrong with it.
SplattedScene read_splatted_scene(const std::filesystem::path& file);

// Returns those of a folder, by name. Throws Error where it has none.
std::vector<std::filesystem::path> splatted_scene_files(const std::filesystem::path& folder);

// Throws Error where latents are not those of this bundle's backbone; where says whose they are.
void require_same_latent_space(const LatentTag& tag, const ModelBundle& bundle, const std::string& where);
// Throws the same, and where they are not normalised by this bundle's statistics, under which a refiner learns.
void require_same_normalisation(const LatentTag& tag, const ModelBundle& bundle, const std::string& where);

}  // namespace gld
