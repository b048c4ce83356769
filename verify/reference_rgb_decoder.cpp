#include "models/decoders/rgb_decoder.h"
#include "models/layers/imagenet.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

namespace gld {
namespace {

// The module's configuration and the size of the case's images.
struct RgbDecoderCaseOptions : RgbDecoderOptions {
  int64_t height = 504;
  int64_t width = 504;

  void visit(FieldVisitor& visitor) override {
    RgbDecoderOptions::visit(visitor);
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
};

}  // namespace

NamedTensors run_rgb_decoder_case(const ReferenceCase& reference) {
  RgbDecoderCaseOptions options;
  reference.read_config(options);
  RgbDecoder decoder(options, reference.placement());
  WeightSelection selection;
  selection.prefix = RgbDecoder::kPrefix;
  load_strict(decoder, reference.weight_file(), selection);
  reference.apply_precision(decoder, ModelKind::kRunOnce);

  LatentGrid grid;
  grid.height = options.height / options.patch_size;
  grid.width = options.width / options.patch_size;
  const auto features = reference.module_input("features", {-1, grid.tokens_per_view(), options.in_channels});
  grid.views = features.size(0);
  const auto logits = decoder.logits(features, grid);
  const auto image = decoder.unpatchify(logits, grid);
  return {{"logits", logits}, {"image_imagenet_normalized", image}, {"image", imagenet_denormalise(image)}};
}

}  // namespace gld
