// What DitDh computes once a scene.
#include "models/dit/dit_scene.h"

#include "gld/base/error.h"
#include "models/dit/dit_dh.h"

#include <utility>
#include <vector>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

LatentGrid grid_of(const Views& views, int64_t patch_size) {
  if (views.cameras.empty() || views.num_sources < 1 || views.num_sources > views.size()) {
    fail({"scene", "views of which at least the first is a source view",
          fmt::format("{} views, {} of them sources", views.size(), views.num_sources), "give source views"});
  }
  const Camera& first = views.cameras.front();
  for (const Camera& camera : views.cameras) {
    if (camera.width == first.width && camera.height == first.height && camera.width % patch_size == 0 &&
        camera.height % patch_size == 0 && camera.width > 0 && camera.height > 0) {
      continue;
    }
    fail({"scene", fmt::format("views of one size with sides that are multiples of {} pixels", patch_size),
          fmt::format("{} x {}", camera.width, camera.height), "resize and crop the views"});
  }
  return {views.size(), first.height / patch_size, first.width / patch_size};
}

}  // namespace

void set_no_warp(DitSceneInputs& inputs, const DitOptions& options) {
  if (options.warped_sources == 0) return;
  const Camera& camera = inputs.views.cameras.front();
  const int64_t targets = inputs.views.num_targets();
  const int64_t patches =
      camera.height / options.camera_patch_size * (camera.width / options.camera_patch_size);
  inputs.warp_agreement = torch::zeros({targets, options.warped_sources, camera.height, camera.width});
  inputs.warped_features = torch::zeros({targets, patches, options.in_channels});
}

void DitDh::check_latent(const DitScene& scene, const torch::Tensor& latent, const std::string& name,
                         int64_t views) const {
  const int64_t tokens = tokens_per_view(scene.grid);
  if (latent.defined() && latent.dim() == 3 && latent.size(0) == views && latent.size(1) == tokens &&
      latent.size(2) == options_.in_channels) {
    return;
  }
  fail({name, fmt::format("shape ({} views, {} tokens, {} channels)", views, tokens, options_.in_channels),
        latent.defined() ? c10::str("shape ", latent.sizes()) : std::string("nothing"),
        "check the model's configuration and the size of the images"});
}

torch::TensorOptions DitDh::tensor_options() const { return camera_embedder_->weight.options(); }

torch::Tensor DitDh::camera_embedding(const DitScene& scene, DitBranch branch) const {
  const Views& views = scene.cameras.views;
  torch::Tensor patches;
  if (branch == DitBranch::kConditional) {
    patches =
        camera_embedder_->forward_image(camera_conditioning(scene.cameras, options_.camera_pixel_offset(),
                                                            tensor_options().dtype().toScalarType())
                                            .to(tensor_options()));
  } else if (scene.savings.unconditional_constants) {
    // Of the seven channels only the mask is left, which is 0 or 1 in a whole view: a source view's tokens are the
    // bias, a target view's the bias and the sum of the mask's weights.
    const auto mask_sum = camera_embedder_->weight.select(1, 0).flatten(1).sum(1);
    auto mask = torch::zeros({views.size(), 1, 1}, tensor_options().requires_grad(false));
    mask.narrow(0, views.num_sources, views.num_targets()).fill_(1.0);
    patches = (camera_embedder_->bias + mask * mask_sum)
                  .expand({views.size(), scene.grid.tokens_per_view(), options_.camera_width()});
  } else {
    patches = camera_embedder_->forward_image(camera_conditioning_without_rays(views).to(tensor_options()));
  }
  if (options_.num_special_tokens == 0) return patches;
  const auto none = torch::zeros({views.size(), options_.num_special_tokens, options_.camera_width()},
                                 patches.options().requires_grad(false));
  return torch::cat({none, patches}, 1);
}

torch::Tensor DitDh::for_all_views(const DitScene& scene, const torch::Tensor& target_patches) const {
  const auto zeros = [&](int64_t views, int64_t tokens) {
    return torch::zeros({views, tokens, target_patches.size(2)},
                        target_patches.options().requires_grad(false));
  };
  auto patches = torch::cat({zeros(scene.num_sources(), target_patches.size(1)), target_patches}, 0);
  if (options_.num_special_tokens == 0) return patches;
  return torch::cat({zeros(patches.size(0), options_.num_special_tokens), patches}, 1);
}

void DitDh::fill_embeddings(const DitScene& scene, DitBranch branch, DitBranchCameras& cameras) const {
  const auto embedding = camera_embedding(scene, branch);
  cameras.encoder_embedding = cameras.decoder_embedding = torch::Tensor();
  auto& part = options_.camera_embedding_input == CameraEmbeddingInput::kConditionEncoder
                   ? cameras.encoder_embedding
                   : cameras.decoder_embedding;
  part = embedding;
  cameras.embedded = true;
  // Where something was carried to tells the cameras, which the unconditional branch must not know.
  const bool warps = options_.warped_sources > 0 && scene.cameras.views.num_targets() > 0;
  if (!warps || branch == DitBranch::kUnconditional) return;
  const auto add = [&](torch::Tensor& sum, const torch::Tensor& target_patches) {
    const auto all = for_all_views(scene, target_patches);
    sum = sum.defined() ? sum + all : all;
  };
  const auto features = scene.warped_features.to(tensor_options());
  add(cameras.encoder_embedding,
      encoder_embedder_->target_features(features) +
          warp_embedder_->forward_image(scene.warp_agreement.to(tensor_options())));
  add(cameras.decoder_embedding, decoder_embedder_->target_features(features));
}

void DitDh::fill_first_guess(DitScene& scene) const {
  if (!guess_gate_ || scene.cameras.views.num_targets() == 0) return;
  const auto agreement = scene.warp_agreement.to(tensor_options());
  const auto by_token = [&](const torch::Tensor& of_pixels) {
    return torch::avg_pool2d(of_pixels, options_.camera_patch_size).flatten(2).transpose(1, 2);
  };
  const auto trust = by_token(agreement.amax(1, /*keepdim=*/true)) *
                     torch::sigmoid(guess_gate_->forward(by_token(agreement).contiguous()));
  scene.guess_trust = for_all_views(scene, trust);
  scene.guess_features = for_all_views(scene, scene.warped_features.to(tensor_options()));
}

void DitDh::check_warp(const DitScene& scene, const DitSceneInputs& inputs) const {
  const Camera& camera = scene.cameras.views.cameras.front();
  const int64_t targets = scene.cameras.views.num_targets();
  const auto check = [&](const std::string& name, const torch::Tensor& given,
                         const std::vector<int64_t>& shape) {
    const bool wanted = options_.warped_sources > 0;
    if (wanted ? given.defined() && given.sizes() == shape : !given.defined()) return;
    fail({name,
          wanted ? c10::str("shape ", at::IntArrayRef(shape))
                 : std::string("none, for a model with warped_sources: 0"),
          given.defined() ? c10::str("shape ", given.sizes()) : std::string("nothing"),
          "check the model's configuration and the size of the images"});
  };
  check("warp agreement", inputs.warp_agreement,
        {targets, options_.warped_sources, camera.height, camera.width});
  check("warped features", inputs.warped_features,
        {targets, scene.grid.tokens_per_view(), options_.in_channels});
}

PropeTables DitDh::prope_tables(const DitScene& scene, DitBranch branch, int64_t head_dim) const {
  PropeLayout layout;
  layout.grid = scene.grid;
  layout.prefix_tokens = options_.num_special_tokens;
  layout.head_dim = head_dim;
  layout.image_size = options_.prope_pixels();
  layout.inverse = options_.prope_inverse;
  layout.frame = options_.prope_frame;
  const bool conditional = branch == DitBranch::kConditional;
  // On the CPU, where whether all views share a camera is seen without waiting for a device.
  const auto options = tensor_options().requires_grad(false);
  auto tables = make_prope_tables(scene.cameras, layout,
                                  conditional ? PropeCameras::kScene : options_.unconditional_cameras(),
                                  options.device(torch::kCPU));
  if (!conditional && scene.savings.unconditional_constants) tables = fold_shared_camera(tables);
  return prope_tables_on(tables, options.device());
}

void DitDh::fill_prope(const DitScene& scene, DitBranch branch, DitBranchCameras& cameras) const {
  cameras.encoder_prope = prope_tables(scene, branch, options_.hidden_size[0] / options_.num_heads[0]);
  cameras.decoder_prope = prope_tables(scene, branch, options_.hidden_size[1] / options_.num_heads[1]);
}

std::vector<DitBranchCameras> DitDh::evaluation_cameras(const DitPasses& passes) const {
  std::vector<DitBranchCameras> list;
  for (const DitPass& pass : passes) {
    DitBranchCameras cameras = pass.scene->branches[static_cast<size_t>(pass.branch)];
    if (!cameras.embedded) fill_embeddings(*pass.scene, pass.branch, cameras);
    if (!cameras.encoder_prope.query_matrix.defined()) fill_prope(*pass.scene, pass.branch, cameras);
    list.push_back(std::move(cameras));
  }
  return list;
}

DitScene DitDh::prepare_scene(const DitSceneInputs& inputs, const ExactSavings& savings) const {
  DitScene scene;
  scene.savings = savings;
  scene.grid = grid_of(inputs.views, options_.camera_patch_size);
  constexpr int64_t kLastView = -1;
  scene.cameras = relative_cameras(inputs.views, kLastView, options_.translation_unit);
  check_warp(scene, inputs);
  scene.warp_agreement = inputs.warp_agreement;
  scene.warped_features = inputs.warped_features;
  check_latent(scene, inputs.source_features, "source features", scene.num_sources());
  scene.source_features = inputs.source_features;
  if (options_.conditioning == DitConditioning::kDeeperLevel) {
    const int64_t patches = scene.grid.tokens_per_view();
    const auto& deeper = inputs.deeper_level;
    if (deeper.defined() && deeper.dim() == 3 && deeper.size(1) == patches) {
      scene.deeper_patches = deeper;
    } else {
      check_latent(scene, deeper, "deeper level", scene.grid.views);
      scene.deeper_patches = deeper.narrow(1, options_.num_special_tokens, patches);
    }
  } else if (inputs.deeper_level.defined()) {
    fail({"deeper level", "none, for a model with conditioning: none", "one", "use a cascade model"});
  }
  fill_first_guess(scene);
  for (const DitBranch branch : {DitBranch::kConditional, DitBranch::kUnconditional}) {
    auto& cameras = scene.branches[static_cast<size_t>(branch)];
    if (savings.camera_embedding_once) fill_embeddings(scene, branch, cameras);
    if (savings.prope_tables_once) fill_prope(scene, branch, cameras);
  }
  const bool cascade = scene.deeper_patches.defined();
  if (cascade ? savings.cascade_input_once : savings.source_embedding_once) {
    auto tokens = source_part(*encoder_embedder_, scene);
    if (cascade) {
      const auto deeper = encoder_embedder_->latent_patches(scene.deeper_patches, scene.num_sources());
      tokens = torch::cat({tokens.narrow(1, 0, options_.num_special_tokens),
                           tokens.narrow(1, options_.num_special_tokens, deeper.size(1)) + deeper},
                          1);
    }
    scene.encoder_source = with_positions(tokens, scene);
  }
  if (savings.source_embedding_once) {
    scene.decoder_source = with_positions(source_part(*decoder_embedder_, scene), scene);
  }
  return scene;
}

}  // namespace gld
