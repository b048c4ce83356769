// Every module, built at the published size on the meta device (names and shapes, no memory), has exactly the tensors
// of the published checkpoint.

#include "gld/base/atomic_file.h"
#include "models/bundle/bundle.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include <torch/nn/module.h>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using Shapes = std::map<std::string, std::vector<int64_t>>;

Shapes manifest(const std::string& file) {
  const auto all = nlohmann::json::parse(read_file(test::test_data() / "checkpoint_manifests.json"));
  return all.at(file).get<Shapes>();
}

void add(Shapes& shapes, const torch::nn::Module& module, const std::string& prefix) {
  for (const auto& [name, tensor] : named_tensors(module)) {
    EXPECT_TRUE(tensor.is_meta()) << name;
    EXPECT_TRUE(shapes.emplace(prefix + name, tensor.sizes().vec()).second) << name;
  }
}

std::shared_ptr<torch::nn::Module> at_full_size(BundlePart part, const BundleOptions& options) {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  return make_bundle_module(part, options, meta);
}

void expect_equal(const Shapes& module, const Shapes& published) {
  for (const auto& [name, shape] : published) {
    const auto found = module.find(name);
    if (found == module.end()) {
      ADD_FAILURE() << "the module has no " << name;
    } else {
      EXPECT_EQ(found->second, shape) << name;
    }
  }
  for (const auto& entry : module)
    EXPECT_EQ(published.count(entry.first), 1U) << "not published: " << entry.first;
  EXPECT_GT(published.size(), 300U);
}

TEST(CheckpointManifest, Da3BackboneAndHead) {
  auto published = manifest("da3_base.safetensors");
  size_t pose_tensors = 0;
  for (auto entry = published.begin(); entry != published.end();) {
    // The pose encoder and decoder of DA3 have no part in GLD.
    const bool unused =
        entry->first.rfind("model.cam_dec.", 0) == 0 || entry->first.rfind("model.cam_enc.", 0) == 0;
    pose_tensors += unused ? 1 : 0;
    entry = unused ? published.erase(entry) : std::next(entry);
  }
  EXPECT_EQ(pose_tensors, 74U);
  const auto options = released_da3_options();
  Shapes module;
  add(module, *at_full_size(BundlePart::backbone(), options),
      options.backbone.architecture().published_prefix());
  add(module, *at_full_size(BundlePart::dpt_head(), options), DptHead::kPrefix);
  expect_equal(module, published);
}

TEST(CheckpointManifest, RgbDecoder) {
  Shapes module;
  add(module, *at_full_size(BundlePart::rgb_decoder(), released_da3_options()), RgbDecoder::kPrefix);
  expect_equal(module, manifest("gld_da3_rgb_decoder.pt:ema"));
}

TEST(CheckpointManifest, Da3Dits) {
  const auto options = released_da3_options();
  Shapes level1, released_cascade;
  add(level1, *at_full_size(BundlePart::of(level_model(1)), options), "");
  expect_equal(level1, manifest("gld_da3_level1.pt:ema"));
  add(released_cascade, *at_full_size(BundlePart::of(cascade(1, 0)), options), "");
  expect_equal(released_cascade, manifest("gld_da3_cascade.pt:ema"));
}

TEST(CheckpointManifest, VggtDits) {
  BundleOptions options;
  for (auto& part : options.generators) {
    part.dit.in_channels = 2048;
    part.dit.num_special_tokens = 5;
  }
  Shapes level1, released_cascade;
  add(level1, *at_full_size(BundlePart::of(level_model(1)), options), "");
  expect_equal(level1, manifest("gld_vggt_level1.pt:ema"));
  add(released_cascade, *at_full_size(BundlePart::of(cascade(1, 0)), options), "");
  expect_equal(released_cascade, manifest("gld_vggt_cascade.pt:ema"));
}

}  // namespace
}  // namespace gld
