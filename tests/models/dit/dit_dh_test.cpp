#include "models/dit/dit_dh.h"

#include "gld/base/configuration.h"
#include "tests/models/dit/naive_dit.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <functional>
#include <ostream>
#include <utility>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;
using test::relative_difference;
using test::small_cascade_options;
using test::small_dit_options;

struct Configuration {
  std::string name;
  std::function<void(DitOptions&)> change;
  test::RandomCameras::SceneSizes sizes{3, 2, 42, 28};
};

std::ostream& operator<<(std::ostream& stream, const Configuration& configuration) {
  return stream << configuration.name;
}

std::vector<Configuration> configurations() {
  return {
      {"level", [](DitOptions&) {}},
      {"published", [](DitOptions& o) { apply_published_conventions(o); }},
      {"qk_norm", [](DitOptions& o) { o.qk_norm = true; }},
      {"one_source_portrait", [](DitOptions&) {}, {4, 1, 14, 56}},
      {"two_views_other_heads",
       [](DitOptions& o) {
         o.num_heads = {4, 1};
       },
       {2, 1, 28, 28}},
      {"equal_widths",
       [](DitOptions& o) {
         o.hidden_size = {32, 32};
         o.num_heads = {1, 2};
       }},
      {"single_embedders", [](DitOptions& o) { o.split_embedders = false; }},
      {"cascade",
       [](DitOptions& o) {
         o.conditioning = DitConditioning::kDeeperLevel;
         o.mlp_ratio = 3.3;
       }},
      {"keep_intrinsics",
       [](DitOptions& o) {
         o.unconditional_intrinsics = UnconditionalIntrinsics::kKeep;
         o.prope_image_size = "504";
       }},
      {"predicts_data", [](DitOptions& o) { o.prediction = FlowPrediction::kData; }},
      {"predicts_data_bounded",
       [](DitOptions& o) {
         o.prediction = FlowPrediction::kData;
         o.largest_inverse_time = 2;  // 1/t is 2.7 here
       }},
      {"special",
       [](DitOptions& o) {
         o.num_special_tokens = 3;
         o.in_channels = 48;
         apply_published_conventions(o);
       }},
      {"special_cascade_sincos",
       [](DitOptions& o) {
         apply_published_conventions(o);
         o.num_special_tokens = 2;
         o.in_channels = 48;
         o.conditioning = DitConditioning::kDeeperLevel;
         o.position_embedding = PositionEmbedding::kSinCos;
       }},
      {"warped_sources", [](DitOptions& o) { o.warped_sources = 2; }},
      {"warped_sources_special",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.num_special_tokens = 3;
         o.in_channels = 48;
         apply_published_conventions(o);
       }},
      {"warped_sources_single_embedders_camera_in_decoder",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.split_embedders = false;
         o.camera_embedding_input = CameraEmbeddingInput::kVelocityDecoder;
       }},
      {"warped_sources_cascade",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.conditioning = DitConditioning::kDeeperLevel;
       }},
      {"carried_velocity",
       [](DitOptions& o) {
         o.warped_sources = 2;
         o.carried_error = 0.2;
       }},
      {"carried_data",
       [](DitOptions& o) {
         o.warped_sources = 2;
         o.carried_error = 0.1;
         o.prediction = FlowPrediction::kData;
       }},
      {"carried_data_cascade",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.carried_error = 0.3;
         o.prediction = FlowPrediction::kData;
         o.conditioning = DitConditioning::kDeeperLevel;
       }},
      {"carried_corrected",
       [](DitOptions& o) {
         o.warped_sources = 2;
         o.carried_error = 0.1;
         o.prediction = FlowPrediction::kData;
         o.carried_guess = CarriedGuess::kCorrected;
       }},
      {"carried_corrected_cascade",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.carried_error = 0.3;
         o.prediction = FlowPrediction::kData;
         o.carried_guess = CarriedGuess::kCorrected;
         o.conditioning = DitConditioning::kDeeperLevel;
       }},
      {"carried_special",
       [](DitOptions& o) {
         o.warped_sources = 1;
         o.carried_error = 0.3;
         o.num_special_tokens = 3;
         o.in_channels = 48;
         apply_published_conventions(o);
       }},
      {"camera_in_decoder",
       [](DitOptions& o) {
         o.camera_embedding_input = CameraEmbeddingInput::kVelocityDecoder;
         o.position_embedding = PositionEmbedding::kSinCos;
         o.camera_patch_size = 7;
       }},
  };
}

class DitConfigurations : public testing::TestWithParam<Configuration> {
 protected:
  DitConfigurations() : options_(small_dit_options()) {
    GetParam().change(options_);
    model_ = random_dit(options_);
    scene_ = random_dit_scene(options_, GetParam().sizes);
  }
  torch::Tensor velocity(const DitDh& model, const test::DitTestScene& scene, DitBranch branch,
                         const ExactSavings& savings = {}) const {
    const torch::NoGradGuard no_grad;
    return model.velocity(model.prepare_scene(scene.inputs, savings), scene.noisy,
                          model.time_rows({kTime}).front(), branch);
  }

  static constexpr double kTime = 0.37;
  DitOptions options_;
  std::shared_ptr<DitDh> model_;
  test::DitTestScene scene_;
};

TEST_P(DitConfigurations, AgreesWithTheFormulasInDouble) {
  const auto model = test::in_double(*model_);
  const auto scene = test::in_double(scene_);
  test::NaiveDitInputs inputs;
  inputs.views = scene.inputs.views;
  inputs.source_features = torch::zeros_like(scene.noisy);
  inputs.source_features.narrow(0, 0, inputs.views.num_sources).copy_(scene.inputs.source_features);
  inputs.deeper_level = scene.inputs.deeper_level;
  inputs.warp_agreement = scene.inputs.warp_agreement;
  inputs.warped_features = scene.inputs.warped_features;
  inputs.noisy = scene.noisy;
  inputs.time = kTime;
  const auto weights = named_tensors(*model);
  for (const auto branch : {DitBranch::kConditional, DitBranch::kUnconditional}) {
    inputs.conditional = branch == DitBranch::kConditional;
    const auto expected = test::naive_dit_velocity(options_, weights, inputs);
    EXPECT_GT(expected.abs().max().item<double>(), 0.1);
    EXPECT_LT(relative_difference(velocity(*model, scene, branch), expected), 1e-11);
    EXPECT_LT(relative_difference(velocity(*model_, scene_, branch), expected), 1e-5);
  }
}

// Savings are exact in double, where the order of a sum is 1e-15 and hides nothing; and in float32, which goes through
// other code, they are as near to the double result as its roundings allow.
TEST_P(DitConfigurations, EverySavingIsExact) {
  const auto model = test::in_double(*model_);
  const auto scene = test::in_double(scene_);
  std::vector<std::pair<std::string, ExactSavings>> variants(1, {"all", {}});
  ExactSavings none;
  for (const auto& name : exact_saving_names()) {
    variants.push_back({"all but " + name, {}});
    disable_exact_saving(variants.back().second, name);
    disable_exact_saving(none, name);
  }
  variants.push_back({"none", none});
  for (const auto branch : {DitBranch::kConditional, DitBranch::kUnconditional}) {
    const auto exact = velocity(*model, scene, branch);
    const double units = test::moved_by_units({exact}, [&]() -> std::vector<torch::Tensor> {
      auto moved = scene;
      moved.inputs = test::moved_by_a_unit(scene.inputs);
      moved.noisy = test::moved_by_a_unit(scene.noisy);
      return {velocity(*test::moved_by_a_unit(*model), moved, branch)};
    })[0];
    for (const auto& [name, savings] : variants) {
      EXPECT_LT(relative_difference(velocity(*model, scene, branch, savings), exact), 1e-11) << name;
      EXPECT_LT(test::largest_difference(velocity(*model_, scene_, branch, savings), exact),
                test::rounding_bound(units))
          << name;
    }
  }
}

TEST_P(DitConfigurations, GradientsAreThoseOfFiniteDifferences) {
  const auto model = test::in_double(*model_);
  const auto scene = test::in_double(scene_);
  torch::manual_seed(9);
  const auto weights = torch::randn_like(scene.noisy);
  const auto loss = [&] {
    const auto prepared = model->prepare_scene(scene.inputs);
    return (model->velocity(prepared, scene.noisy, model->time_rows({kTime}).front()) * weights).sum();
  };
  loss().backward();
  std::vector<torch::Tensor> directions;
  double expected = 0;
  for (auto& parameter : model->parameters()) {
    directions.push_back(torch::randn_like(parameter) * 0.1);
    if (!parameter.requires_grad()) continue;
    ASSERT_TRUE(parameter.grad().defined());
    expected += (parameter.grad() * directions.back()).sum().item<double>();
  }
  const torch::NoGradGuard no_grad;
  const auto moved = [&](double step) {
    auto parameters = model->parameters();
    for (size_t i = 0; i < parameters.size(); ++i) {
      if (parameters[i].requires_grad()) parameters[i].add_(directions[i], step);
    }
    return loss().item<double>();
  };
  constexpr double kStep = 1e-5;
  const double above = moved(kStep);
  const double below = moved(-2 * kStep);
  EXPECT_NEAR((above - below) / (2 * kStep), expected, 1e-6 * std::max(1.0, std::abs(expected)));
}

INSTANTIATE_TEST_SUITE_P(Dit, DitConfigurations, testing::ValuesIn(configurations()),
                         [](const auto& info) { return info.param.name; });

TEST(DitDh, GroupsOfViewsChangeNothing) {
  // 1200 tokens a view: without gradients the views go one by one, with gradients all at once.
  auto options = small_dit_options();
  options.depth = {1, 1};
  options.camera_patch_size = 1;
  const auto model = random_dit(options);
  const auto scene = random_dit_scene(options, {2, 1, 40, 30});
  const auto time = model->time_rows({0.5}).front();
  const auto whole = model->velocity(model->prepare_scene(scene.inputs), scene.noisy, time).detach();
  const torch::NoGradGuard no_grad;
  const auto groups = model->velocity(model->prepare_scene(scene.inputs), scene.noisy, time);
  const auto exact_model = test::in_double(*model);
  const auto exact_velocity = [](const DitDh& dit, const test::DitTestScene& of) {
    return dit.velocity(dit.prepare_scene(of.inputs), of.noisy, dit.time_rows({0.5}).front());
  };
  const auto exact_scene = test::in_double(scene);
  const auto exact = exact_velocity(*exact_model, exact_scene);
  const double units = test::moved_by_units({exact}, [&]() -> std::vector<torch::Tensor> {
    auto moved = exact_scene;
    moved.inputs = test::moved_by_a_unit(exact_scene.inputs);
    moved.noisy = test::moved_by_a_unit(exact_scene.noisy);
    return {exact_velocity(*test::moved_by_a_unit(*exact_model), moved)};
  })[0];
  EXPECT_LT(test::largest_difference(whole, exact), test::rounding_bound(units));
  EXPECT_LT(test::largest_difference(groups, exact), test::rounding_bound(units));
}

TEST(DitDh, TapsGiveWhatAttentionMultiplies) {
  const auto model = random_dit(small_dit_options());
  const auto scene = random_dit_scene(model->options(), {3, 1, 28, 42});
  auto prepared = model->prepare_scene(scene.inputs);
  std::vector<AttentionTap> taps = {{1, {}, {}}, {2, {}, {}}, {7, {}, {}}};
  prepared.taps = &taps;
  const auto time = model->time_rows({0.5}).front();
  const auto tapped = model->velocity(prepared, scene.noisy, time);
  prepared.taps = nullptr;
  EXPECT_TRUE(torch::equal(tapped, model->velocity(prepared, scene.noisy, time)));
  // Block 1 is the condition encoder's last, block 2 the velocity decoder's first; there is no block 7.
  EXPECT_EQ(taps[0].query.sizes(), (std::vector<int64_t>{1, 18, 2, 16}));
  EXPECT_EQ(taps[1].key.sizes(), (std::vector<int64_t>{1, 18, 3, 16}));
  EXPECT_FALSE(taps[2].query.defined());
  EXPECT_TRUE(taps[1].query.requires_grad());
}

TEST(DitDh, TimeRowsOfSeveralTimesAreThoseOfEach) {
  const auto model = random_dit(small_dit_options());
  const torch::NoGradGuard no_grad;
  const auto together = model->time_rows({1.0, 0.25, 0.0});
  ASSERT_EQ(together.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    const auto alone = model->time_rows({together[i].time}, 4).front();
    EXPECT_EQ(alone.embedding.size(0), 4);
    EXPECT_LT(relative_difference(together[i].embedding, alone.embedding.narrow(0, 2, 1)), 1e-6);
    EXPECT_LT(
        relative_difference(together[i].encoder_modulation[1], alone.encoder_modulation[1].narrow(0, 3, 1)),
        1e-6);
  }
}

TEST(DitDh, StartsTrainingAsPublished) {
  auto options = small_dit_options();
  options.in_channels = 48;
  options.num_special_tokens = 2;
  DitDh model(options, {});
  model.initialise(at::detail::createCPUGenerator(3));
  std::map<std::string, torch::Tensor> weights = named_tensors(model);
  for (const char* name :
       {"blocks.0.adaLN_modulation.1.weight", "blocks.3.adaLN_modulation.1.bias", "final_layer.linear.weight",
        "final_layer.adaLN_modulation.1.weight", "special_output_proj.weight", "s_embedder_ref.proj.bias",
        "camera_embedder.proj.bias"}) {
    EXPECT_EQ(weights.at(name).abs().max().item<double>(), 0) << name;
  }
  for (const char* name : {"blocks.0.norm1.weight", "final_layer.norm_final.weight"}) {
    EXPECT_TRUE(weights.at(name).eq(1).all().item<bool>()) << name;
  }
  // Xavier over 96 inputs and 32 outputs; a uniform variable of bound b has deviation b / sqrt(3).
  const double xavier = std::sqrt(6.0 / (96 + 32));
  EXPECT_NEAR(weights.at("s_embedder_tgt.proj.weight").abs().max().item<double>(), xavier, 0.01 * xavier);
  EXPECT_NEAR(weights.at("special_s_embedder.weight").std().item<double>(), xavier / std::sqrt(3.0),
              0.05 * xavier);
  EXPECT_NEAR(weights.at("blocks.0.attn.qkv.weight").abs().max().item<double>(), 1 / std::sqrt(32.0), 2e-3);
  EXPECT_NEAR(weights.at("t_embedder.mlp.0.weight").std().item<double>(), 0.02, 1e-3);
  EXPECT_NEAR(weights.at("special_pos_embed_x").std().item<double>(), 0.02, 6e-3);
  EXPECT_NEAR(weights.at("t_embedder.W").std().item<double>(), 1, 0.15);

  DitDh again(options, {});
  again.initialise(at::detail::createCPUGenerator(3));
  for (const auto& [name, value] : named_tensors(again))
    EXPECT_TRUE(torch::equal(value, weights.at(name))) << name;
  const auto scene = random_dit_scene(options, {3, 2, 28, 28});
  const auto velocity =
      model.velocity(model.prepare_scene(scene.inputs), scene.noisy, model.time_rows({0.5}).front());
  EXPECT_EQ(velocity.abs().max().item<double>(), 0);
}

TEST(DitDh, DegenerateBaselineIsWarnedAboutAndFinite) {
  const auto model = random_dit(small_dit_options());
  auto scene = random_dit_scene(model->options(), {3, 2, 28, 28});
  for (Camera& camera : scene.inputs.views.cameras) {
    camera.world_from_camera.translation() = Eigen::Vector3d(1000.1, -3, 7);
  }
  const auto prepared = model->prepare_scene(scene.inputs);
  ASSERT_EQ(prepared.warnings().size(), 1U);
  EXPECT_TRUE(torch::isfinite(model->velocity(prepared, scene.noisy, model->time_rows({1.0}).front()))
                  .all()
                  .item<bool>());
}

TEST(DitDh, RefusesScenesThatDoNotFit) {
  const auto model = random_dit(small_dit_options());
  const auto scene = random_dit_scene(model->options(), {3, 2, 28, 28});
  const auto refusal = [&](const std::function<void(DitSceneInputs&)>& change) {
    auto inputs = scene.inputs;
    change(inputs);
    return test::error_of([&] { model->prepare_scene(inputs); });
  };
  EXPECT_EQ(refusal([](DitSceneInputs& i) { i.views.cameras[1].width = 30; }),
            "scene: expected views of one size with sides that are multiples of 14 pixels, found 30 x 28; "
            "resize and crop the views.");
  EXPECT_EQ(
      refusal([](DitSceneInputs& i) { i.views.num_sources = 0; }),
      "scene: expected views of which at least the first is a source view, found 3 views, 0 of them sources; "
      "give source views.");
  EXPECT_EQ(refusal([](DitSceneInputs& i) { i.source_features = i.source_features.narrow(1, 0, 3); }),
            "source features: expected shape (2 views, 4 tokens, 24 channels), found shape [2, 3, 24]; "
            "check the model's configuration and the size of the images.");
  EXPECT_EQ(
      refusal([](DitSceneInputs& i) {
        i.deeper_level = torch::zeros({3, 4, 24});
      }),
      "deeper level: expected none, for a model with conditioning: none, found one; use a cascade model.");
  EXPECT_EQ(test::error_of([&] {
              model->velocity(model->prepare_scene(scene.inputs), scene.noisy.narrow(0, 0, 2),
                              model->time_rows({0.5}).front());
            }),
            "noisy latent: expected shape (3 views, 4 tokens, 24 channels), found shape [2, 4, 24]; "
            "check the model's configuration and the size of the images.");
  EXPECT_EQ(test::error_of([&] { random_dit(small_cascade_options())->prepare_scene(scene.inputs); }),
            "deeper level: expected shape (3 views, 4 tokens, 24 channels), found nothing; "
            "check the model's configuration and the size of the images.");
}

}  // namespace
}  // namespace gld
