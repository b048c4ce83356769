#include "gld/camera_encoding/camera_conditioning.h"
#include "verify/reference_dit.h"
#include "verify/reference_runners.h"

namespace gld {
namespace {

struct CameraCaseOptions : OptionsGroup {
  int64_t height = 0;  // pixels
  int64_t width = 0;   // pixels
  int64_t num_sources = 0;
  int64_t reference_view = -1;
  std::vector<double> pixel_offset = {-0.5, 0.5};  // the published code's

  void visit(FieldVisitor& visitor) override {
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
    visitor.integer({"num_sources", "source views, which come first"}, num_sources, {1, 1 << 16});
    visitor.integer({"reference_view", "view that poses are relative to; -1 is the last"}, reference_view);
    visitor.reals({"pixel_offset", "where in a pixel its ray starts, [x, y]"}, pixel_offset, {-10, 10});
  }
};

}  // namespace

NamedTensors run_camera_case(const ReferenceCase& reference) {
  CameraCaseOptions options;
  reference.read_config(options);
  const int64_t views = reference.input("camera_to_world", {-1, 4, 4}).size(0);
  const auto cameras = relative_cameras(
      reference_views(reference, {views, options.num_sources, options.width, options.height}),
      options.reference_view);
  PixelOffset offset;
  offset.x = options.pixel_offset.at(0);
  offset.y = options.pixel_offset.at(1);
  return {{"plucker_with_mask", camera_conditioning(cameras, offset)},
          {"translation_scale", torch::full({1}, cameras.translation_scale, torch::kFloat64)},
          {"world_to_camera_scaled", scaled_camera_from_world(cameras)}};
}

}  // namespace gld
