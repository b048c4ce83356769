#pragma once

#include "gld/latents/latent_statistics.h"
#include "models/backbones/autoencoder_kl.h"
#include "models/bundle/random_bundle.h"
#include "models/splats/splatted_scene.h"

#include <filesystem>
#include <map>
#include <string>

#include <ATen/CPUGeneratorImpl.h>

namespace gld::test {

// Returns an autoencoder of latents of an eighth of a picture's sides, and a refiner of them.
inline BundleOptions small_autoencoder_model() {
  AutoencoderKlOptions autoencoder;
  autoencoder.block_out_channels = {4, 8, 8, 8};
  autoencoder.layers_per_block = 1;
  autoencoder.norm_groups = 4;
  autoencoder.scaling_factor = 1;
  autoencoder.latent_patch = 2;
  BackboneOptions backbone;
  backbone = autoencoder;
  BundleOptions model = single_level_options("small autoencoder", backbone);
  for (auto& part : model.generators) {
    part.dit.hidden_size = {32, 64};
    part.dit.depth = {1, 1};
    part.dit.num_heads = {2, 4};
  }
  model.trained_sizes = {"32x32"};
  model.refiner.channels = {8, 16};
  model.refiner.heads = {2, 2};
  model.refiner.norm_groups = 4;
  model.refiner.prompt_channels = 8;
  return model;
}

// With random weights, and without a refiner's where `with_refiner` is false.
inline ModelBundle write_small_autoencoder(const std::filesystem::path& folder, bool with_refiner) {
  write_random_bundle(folder, small_autoencoder_model(), 5);
  ModelBundle bundle = ModelBundle::open(folder);
  if (!with_refiner) std::filesystem::remove(bundle.file(BundlePart::refiner()));
  return bundle;
}

// Makes the bundle's refiner one of colours that are encoded; who opens the folder again sees it.
inline void repair_colours(const ModelBundle& bundle) {
  BundleOptions model = bundle.options();
  model.refiner.degraded = DegradedLatents::kColours;
  std::filesystem::remove(bundle.folder() / "model.yaml");
  save_bundle_options(bundle.folder(), model);
}

// Returns six views of 32x32 beside each other, two of them held out, whose splatted latents are half of the encoded
// ones and whose colours three quarters.
inline SplattedScene half_splatted_scene(const ModelBundle& bundle, uint64_t seed) {
  SplattedScene scene;
  scene.name = "scene_" + std::to_string(seed);
  auto generator = at::detail::createCPUGenerator(seed);
  const auto images = torch::rand({6, 3, 32, 32}, generator, torch::kFloat32);
  const auto levels = LatentEncoding(bundle)(images, {0});
  scene.tag = levels.front().tag;
  std::vector<torch::Tensor> encoded;
  for (int64_t view = 0; view < 6; ++view) {
    Camera camera;
    camera.width = camera.height = 32;
    camera.intrinsics << 30, 0, 16, 0, 30, 16, 0, 0, 1;
    camera.world_from_camera.translation() = Eigen::Vector3d(0.2 * static_cast<double>(view), 0, 0);
    scene.cameras.push_back(camera);
    encoded.push_back(tensor_of(levels.front().pictures[static_cast<size_t>(view)]));
  }
  scene.fitted = 4;
  scene.pictures = (images * 255).round().to(torch::kUInt8);
  scene.encoded = torch::stack(encoded);
  scene.splatted = scene.encoded.slice(0, 4) / 2;
  scene.colours = scene.encoded.slice(0, 4) * 0.75;
  return scene;
}

}  // namespace gld::test
