// Models whose layers compute in another precision, beside the same weights in float32 and in double.
#include "models/layers/layer_precision.h"

#include "gld/tensors/transposed_product.h"
#include "gld/tensors/weight_tensors.h"
#include "models/dit/dit_field.h"
#include "models/dit/flow_matching_loss.h"
#include "models/layers/layers.h"
#include "models/weights/weight_loading.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

namespace gld {
namespace {

using test::random_dit;
using test::random_dit_scene;

torch::Tensor guided(const DitDh& model, const test::DitTestScene& scene) {
  const torch::NoGradGuard no_grad;
  DitField field(model, model.prepare_scene(scene.inputs));
  return field.guided(scene.noisy, 0.4, 1.5);
}

double relative_rms(const torch::Tensor& x, const torch::Tensor& exact) {
  const auto reference = exact.to(torch::kFloat64);
  return ((x.to(torch::kFloat64) - reference).norm() / reference.norm()).item<double>();
}

void pack(DitDh& model, ComputePrecision precision) {
  LayerPrecision layers = layer_precision(precision, ModelKind::kGenerator);
  layers.originals = PackedOriginals::kRelease;
  use_precision(model, layers);
}

// 4 views of 20 tokens, more rows than LibTorch gets.
const test::RandomCameras::SceneSizes kSizes{4, 2, 70, 56};

// Returns the bytes of files that are in this process's memory.
int64_t resident_file_bytes() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    int64_t kilobytes = 0;
    if (word == "RssFile:" && status >> kilobytes) return 1024 * kilobytes;
  }
  return -1;
}

// Weights are read in place, from pages of their file; packed ones stand beside them, so the pages must go.
TEST(LayerPrecision, PackedWeightsDoNotKeepThePagesOfTheirFile) {
  // It lies beside what was built: a folder for temporary files may lie in memory, which has no pages of files.
  const test::TemporaryFolder folder(std::filesystem::current_path());
  constexpr int64_t kWidth = 2048;
  constexpr int64_t kBytes = kWidth * kWidth * 4;
  Linear layer({kWidth, kWidth}, ParameterPlacement{});
  {
    const torch::NoGradGuard no_grad;
    for (auto& parameter : layer.parameters()) parameter.fill_(1);
  }
  save_safetensors(folder.path() / "layer.safetensors", named_tensors(layer));
  ::sync();  // the kernel drops only what is on the disk
  const int64_t before = resident_file_bytes();
  ASSERT_GE(before, 0);
  load_strict(layer, *WeightFile::open(folder.path() / "layer.safetensors"));
  EXPECT_TRUE(layer.weight.isfinite().all().item<bool>());  // which reads every page
  ASSERT_GE(resident_file_bytes() - before, kBytes * 3 / 4)
      << "run this test in a folder on a disk, not in memory";
  LayerPrecision layers = layer_precision(ComputePrecision::kFloat32, ModelKind::kGenerator);
  layers.originals = PackedOriginals::kRelease;
  use_precision(layer, layers);
  // Pages of libraries count too, which are read when their code runs for the first time.
  EXPECT_LT(resident_file_bytes() - before, kBytes / 2);
}

TEST(LayerPrecision, GeometryStaysInFloat32) {
  for (const auto asked : {ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    const LayerPrecision geometry = layer_precision(asked, ModelKind::kLeanedOn);
    EXPECT_EQ(geometry.linear, ComputePrecision::kFloat32);
    EXPECT_EQ(geometry.attention, ComputePrecision::kFloat32);
    EXPECT_EQ(layer_precision(asked, ModelKind::kGenerator).linear, asked);
  }
}

TEST(LayerPrecision, PackedFloat32IsTheUnpackedModelBitForBit) {
  for (const auto& options : {test::small_dit_options(), test::small_cascade_options()}) {
    const auto model = random_dit(options);
    const auto scene = random_dit_scene(options, kSizes);
    const auto expected = guided(*model, scene);
    pack(*model, ComputePrecision::kFloat32);
    EXPECT_TRUE(torch::equal(guided(*model, scene), expected));
  }
}

// The released widths and head sizes (768 with 48, 2048 with 128), one block a part, random weights. What a precision
// rounds adds up over 20 products like a random walk: 2^-9 rms of an operand in bfloat16, a hundredth in int8.
TEST(LayerPrecision, ErrorsAtFullWidthAgainstDouble) {
  DitOptions options;
  options.in_channels = 256;
  options.depth = {1, 1};
  const auto model = random_dit(options);
  const auto scene = random_dit_scene(options, {3, 1, 70, 56});
  const auto exact = guided(*test::in_double(*model), test::in_double(scene));
  struct Expected {
    ComputePrecision precision;
    double most;
  };
  for (const auto& [precision, most] :
       {Expected{ComputePrecision::kFloat32, 2e-6}, Expected{ComputePrecision::kBFloat16, 2e-2},
        Expected{ComputePrecision::kInt8, 4e-2}}) {
    const auto copy = random_dit(options);
    pack(*copy, precision);
    const double error = relative_rms(guided(*copy, scene), exact);
    EXPECT_LE(error, most) << compute_precision_name(precision);
    RecordProperty(compute_precision_name(precision), std::to_string(error));
    std::cout << compute_precision_name(precision) << ": relative RMS error " << error << "\n";
  }
}

TEST(LayerPrecision, FewRowsOfPackedFloat32AreLibTorchs) {
  torch::manual_seed(3);
  const auto layer = std::make_shared<Linear>(LinearSizes{96, 70}, ParameterPlacement{});
  const torch::NoGradGuard no_grad;
  layer->weight.normal_();
  layer->bias.normal_();
  const auto x = torch::randn({5, 96});
  const auto expected = layer->forward(x);
  LayerPrecision precision;
  precision.originals = PackedOriginals::kRelease;
  use_precision(*layer, precision);
  EXPECT_TRUE(torch::equal(layer->forward(x), expected));
}

TEST(LayerPrecision, ReachesTheLayersOfAModelOnTheStack) {
  Linear layer(LinearSizes{64, 70}, ParameterPlacement{});
  const torch::NoGradGuard no_grad;
  layer.weight.normal_();
  LayerPrecision precision;
  precision.originals = PackedOriginals::kRelease;
  use_precision(layer, precision);
  EXPECT_TRUE(layer.weight.isnan().all().item<bool>());
}

TEST(LayerPrecision, PartsAreSharesOfTheWhole) {
  for (const auto asked :
       {ComputePrecision::kFloat32, ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    torch::manual_seed(3);
    LinearSizes sizes{64, 150};
    sizes.parts = 3;
    const auto layer = std::make_shared<Linear>(sizes, ParameterPlacement{});
    const torch::NoGradGuard no_grad;
    layer->weight.normal_();
    layer->bias.normal_();
    use_precision(*layer, layer_precision(asked, ModelKind::kGenerator));
    const auto x = torch::randn({60, 64});
    const auto whole = layer->forward(x);
    EXPECT_TRUE(torch::equal(layer->forward_parts(x, 1, 2), whole.narrow(1, 50, 100)));
  }
}

// What a layer does that is not on the CPU, by LibTorch's products, which the CPU has too.
TEST(LayerPrecision, ElsewhereWeightsInBfloat16AreMultipliedByLibTorch) {
  torch::manual_seed(4);
  const torch::NoGradGuard no_grad;
  const auto x = torch::randn({3, 20, 96}), weight = torch::randn({70, 96});
  const auto bias = torch::full({70}, 1e4);  // bfloat16 would leave of a sum with it a multiple of 64
  const auto y = times_rounded(x, weight.to(torch::kBFloat16), bias);
  EXPECT_EQ(y.scalar_type(), torch::kFloat32);
  const auto in_double = [](const torch::Tensor& t) { return t.to(torch::kBFloat16).to(torch::kFloat64); };
  const auto product = torch::matmul(in_double(x), in_double(weight).t());
  EXPECT_LT(relative_rms(y - 1e4, product), 0x1p-8);
  EXPECT_EQ(times_rounded(x, weight.to(torch::kBFloat16)).sizes(), product.sizes());
}

TEST(LayerPrecision, ElsewhereOnlyBfloat16ChangesALayer) {
  const torch::NoGradGuard no_grad;
  ParameterPlacement placement;
  placement.device = torch::kMeta;
  for (const auto asked :
       {ComputePrecision::kFloat32, ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    SCOPED_TRACE(compute_precision_name(asked));
    const auto weight = torch::empty({70, 96}, torch::kMeta);
    EXPECT_EQ(rounded_product_applies(weight, asked), asked == ComputePrecision::kBFloat16);
    EXPECT_FALSE(rounded_product_applies(torch::empty({70, 96}), asked));
    Linear layer(LinearSizes{96, 70}, placement);
    LayerPrecision precision = layer_precision(asked, ModelKind::kGenerator);
    precision.originals = PackedOriginals::kRelease;
    use_precision(layer, precision);
    const auto y = layer.forward(torch::empty({2, 5, 96}, torch::kMeta));
    EXPECT_EQ(y.scalar_type(), torch::kFloat32);
    EXPECT_EQ(y.sizes(), (std::vector<int64_t>{2, 5, 70}));
    // The weight's own memory is given back where it was rounded.
    EXPECT_EQ(layer.weight.storage().nbytes() == 4U, asked == ComputePrecision::kBFloat16);
  }
}

TEST(LayerPrecision, ReleasedWeightsAreShapesWithoutNumbers) {
  const auto layer = std::make_shared<Linear>(LinearSizes{64, 70}, ParameterPlacement{});
  {
    const torch::NoGradGuard no_grad;
    layer->weight.normal_();
    layer->bias.zero_();
  }
  LayerPrecision precision;
  precision.linear = ComputePrecision::kBFloat16;
  precision.originals = PackedOriginals::kRelease;
  use_precision(*layer, precision);
  EXPECT_EQ(layer->weight.sizes(), (std::vector<int64_t>{70, 64}));
  EXPECT_EQ(layer->weight.storage().nbytes(), 4U);
  EXPECT_TRUE(layer->weight.isnan().all().item<bool>());
  EXPECT_EQ(
      test::error_of([&] {
        layer->forward(torch::randn({2, 64}).requires_grad_(true));
      }),
      "linear layer: expected no gradients through packed weights, found an input that wants them; train without "
      "use_precision.");
}

// Returns the gradients of a step by a model that learns in a precision, one after the other.
torch::Tensor gradients(DitDh& model, const test::DitTestScene& scene, ComputePrecision precision,
                        ActivationStorage storage) {
  learn_in(model, precision);
  model.set_activation_storage(storage);
  FlowMatchingDraw draw;
  draw.clean = torch::zeros_like(scene.noisy);
  draw.noise = scene.noisy;
  draw.time = 0.4;
  model.zero_grad();
  flow_matching_errors(model, scene.inputs, draw).all.backward();
  std::vector<torch::Tensor> flat;
  for (const auto& parameter : model.parameters()) {
    if (parameter.grad().defined()) flat.push_back(parameter.grad().flatten());
  }
  return torch::cat(flat);
}

TEST(LayerPrecision, AModelLearnsInAPrecisionWithItsErrors) {
  const auto options = test::small_dit_options();
  const auto model = random_dit(options);
  const auto scene = random_dit_scene(options, kSizes);
  const auto exact = gradients(*model, scene, ComputePrecision::kFloat32, ActivationStorage::kKeep);
  const auto reduced = gradients(*model, scene, ComputePrecision::kBFloat16, ActivationStorage::kKeep);
  EXPECT_GT(relative_rms(reduced, exact), 1e-3);
  EXPECT_LT(relative_rms(reduced, exact), 2e-2);
  // When they are computed again to save memory, only the order of some sums is another.
  EXPECT_LT(relative_rms(gradients(*model, scene, ComputePrecision::kBFloat16, ActivationStorage::kRecompute),
                         reduced),
            1e-3);
  EXPECT_TRUE(
      torch::equal(gradients(*model, scene, ComputePrecision::kFloat32, ActivationStorage::kKeep), exact));
}

TEST(LayerPrecision, SaysWhichLayersRunInWhat) {
  const auto generator = layer_precision(ComputePrecision::kInt8, ModelKind::kGenerator);
  EXPECT_EQ(generator.linear, ComputePrecision::kInt8);
  EXPECT_EQ(layer_precision(ComputePrecision::kInt8, ModelKind::kRunOnce).linear,
            has_matrix_unit(ComputePrecision::kBFloat16) ? ComputePrecision::kBFloat16
                                                         : ComputePrecision::kFloat32);
  EXPECT_EQ(layer_precision(ComputePrecision::kBFloat16, ModelKind::kGenerator).attention,
            ComputePrecision::kBFloat16);
}

}  // namespace
}  // namespace gld
