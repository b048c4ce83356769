#include "datasets/scenes/resize_crop.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

void check_source(int64_t width, int64_t height, const ResizeCrop& plan) {
  if (width == plan.source_width && height == plan.source_height) return;
  fail({"resize and crop",
        "a picture of " + std::to_string(plan.source_width) + "x" + std::to_string(plan.source_height),
        std::to_string(width) + "x" + std::to_string(height), "use the picture that the plan was made for"});
}

// Columns or rows of the source whose centres are nearest to those of the result.
struct SideOfPlan {
  int64_t window_start = 0;
  int64_t window = 0;
  int64_t resized = 0;
  int64_t offset = 0;
  int64_t count = 0;
};
std::vector<int64_t> nearest_sources(const SideOfPlan& side) {
  std::vector<int64_t> result(static_cast<size_t>(side.count));
  const double scale = static_cast<double>(side.window) / static_cast<double>(side.resized);
  for (int64_t i = 0; i < side.count; ++i) {
    const auto position = static_cast<int64_t>((static_cast<double>(i + side.offset) + 0.5) * scale);
    result[static_cast<size_t>(i)] = side.window_start + std::min(position, side.window - 1);
  }
  return result;
}

void check_target(int64_t width, int64_t height, const ImageSize& target) {
  if (width >= 2 && height >= 2 && target.width >= 2 && target.height >= 2) return;
  fail({"resize and crop",
        "sizes of at least 2 pixels",
        std::to_string(width) + "x" + std::to_string(height) + " to " + std::to_string(target.width) + "x" +
            std::to_string(target.height),
        {}});
}

// Plans the rest with source and window given.
void plan_window(ResizeCrop& plan, const ImageSize& target) {
  const double scale = std::max(static_cast<double>(target.width) / static_cast<double>(plan.window_width),
                                static_cast<double>(target.height) / static_cast<double>(plan.window_height));
  plan.resized_width = std::max(
      target.width, static_cast<int64_t>(std::llround(static_cast<double>(plan.window_width) * scale)));
  plan.resized_height = std::max(
      target.height, static_cast<int64_t>(std::llround(static_cast<double>(plan.window_height) * scale)));
  plan.left = (plan.resized_width - target.width) / 2;
  plan.top = (plan.resized_height - target.height) / 2;
  plan.target = target;
}

// Returns half the side of the largest window about a principal point at this coordinate.
int64_t largest_half(const char* axis, double principal_point, int64_t side) {
  const double rounded = std::round(principal_point);
  const double half = std::min(rounded, static_cast<double>(side) - rounded);
  if (half > static_cast<double>(side) / 5) return static_cast<int64_t>(half);
  fail({"crop about the principal point",
        std::string("a principal point farther than a fifth of the picture's ") + axis + " (" +
            std::to_string(side) + " pixels) from its edges",
        fmt::format("{:g}", principal_point), "crop about the image's centre (crop_centre: image)"});
}

template <class Value>
std::vector<Value> sampled(const std::vector<Value>& source, const ResizeCrop& plan) {
  const auto columns = nearest_sources(
      {plan.window_left, plan.window_width, plan.resized_width, plan.left, plan.target.width});
  const auto rows = nearest_sources(
      {plan.window_top, plan.window_height, plan.resized_height, plan.top, plan.target.height});
  std::vector<Value> result;
  result.reserve(columns.size() * rows.size());
  for (int64_t y : rows) {
    for (int64_t x : columns) result.push_back(source[static_cast<size_t>(y * plan.source_width + x)]);
  }
  return result;
}

}  // namespace

ImageSize nearest_trained_size(int64_t width, int64_t height, const std::vector<ImageSize>& sizes) {
  if (sizes.empty()) fail({"trained sizes", "at least one size", "none", "list the model's sizes"});
  if (width < 1 || height < 1) {
    fail({"trained sizes", "a picture", std::to_string(width) + "x" + std::to_string(height), {}});
  }
  const double aspect = std::log(static_cast<double>(width) / static_cast<double>(height));
  return *std::min_element(sizes.begin(), sizes.end(), [&](const ImageSize& a, const ImageSize& b) {
    const auto distance = [&](const ImageSize& size) {
      return std::abs(std::log(static_cast<double>(size.width) / static_cast<double>(size.height)) - aspect);
    };
    return distance(a) < distance(b);
  });
}

ResizeCrop plan_resize_crop(int64_t width, int64_t height, const ImageSize& target) {
  check_target(width, height, target);
  ResizeCrop plan;
  plan.source_width = plan.window_width = width;
  plan.source_height = plan.window_height = height;
  plan_window(plan, target);
  return plan;
}

ResizeCrop plan_resize_crop(const Camera& camera, const ImageSize& target, CropCentre centre) {
  if (centre == CropCentre::kImage) return plan_resize_crop(camera.width, camera.height, target);
  check_target(camera.width, camera.height, target);
  const double x = camera.intrinsics(0, 2), y = camera.intrinsics(1, 2);
  const int64_t half_width = largest_half("width", x, camera.width);
  const int64_t half_height = largest_half("height", y, camera.height);
  ResizeCrop plan;
  plan.source_width = camera.width;
  plan.source_height = camera.height;
  plan.window_left = static_cast<int64_t>(std::round(x)) - half_width;
  plan.window_top = static_cast<int64_t>(std::round(y)) - half_height;
  plan.window_width = 2 * half_width;
  plan.window_height = 2 * half_height;
  plan_window(plan, target);
  return plan;
}

ResizeCrop magnified(ResizeCrop plan, int64_t times) {
  for (int64_t* pixels : {&plan.resized_width, &plan.resized_height, &plan.left, &plan.top,
                          &plan.target.width, &plan.target.height})
    *pixels *= times;
  return plan;
}

Camera resize_crop(const Camera& camera, const ResizeCrop& plan) {
  check_source(camera.width, camera.height, plan);
  Camera result = camera;
  result.width = plan.target.width;
  result.height = plan.target.height;
  result.intrinsics(0, 2) -= static_cast<double>(plan.window_left);
  result.intrinsics(1, 2) -= static_cast<double>(plan.window_top);
  result.intrinsics.row(0) *=
      static_cast<double>(plan.resized_width) / static_cast<double>(plan.window_width);
  result.intrinsics.row(1) *=
      static_cast<double>(plan.resized_height) / static_cast<double>(plan.window_height);
  result.intrinsics(0, 2) -= static_cast<double>(plan.left);
  result.intrinsics(1, 2) -= static_cast<double>(plan.top);
  return result;
}

Image resize_crop(const Image& image, const ResizeCrop& plan) {
  check_source(image.width, image.height, plan);
  const cv::Mat whole(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                      const_cast<uint8_t*>(image.rgb.data()));
  const cv::Mat source =
      whole(cv::Rect(static_cast<int>(plan.window_left), static_cast<int>(plan.window_top),
                     static_cast<int>(plan.window_width), static_cast<int>(plan.window_height)));
  const bool shrinks = plan.resized_width < plan.window_width || plan.resized_height < plan.window_height;
  cv::Mat resized = source;
  if (plan.resized_width != plan.window_width || plan.resized_height != plan.window_height) {
    cv::resize(source, resized, {static_cast<int>(plan.resized_width), static_cast<int>(plan.resized_height)},
               0, 0, shrinks ? cv::INTER_AREA : cv::INTER_CUBIC);
  }
  Image result(plan.target.width, plan.target.height);
  cv::Mat target(static_cast<int>(result.height), static_cast<int>(result.width), CV_8UC3, result.rgb.data());
  resized(cv::Rect(static_cast<int>(plan.left), static_cast<int>(plan.top), target.cols, target.rows))
      .copyTo(target);
  return result;
}

DepthMap resize_crop(const DepthMap& depth, const ResizeCrop& plan) {
  check_source(depth.width, depth.height, plan);
  DepthMap result;
  result.width = plan.target.width;
  result.height = plan.target.height;
  result.metres = sampled(depth.metres, plan);
  return result;
}

ValidityMask resize_crop(const ValidityMask& mask, const ResizeCrop& plan) {
  check_source(mask.width, mask.height, plan);
  ValidityMask result;
  result.width = plan.target.width;
  result.height = plan.target.height;
  result.valid = sampled(mask.valid, plan);
  return result;
}

SizedFrame load_sized(const Frame& frame, const ImageSize& target, FrameParts parts, CropCentre centre) {
  const ResizeCrop plan = plan_resize_crop(frame.camera, target, centre);
  SizedFrame sized;
  sized.camera = resize_crop(frame.camera, plan);
  sized.image = resize_crop(frame.image(), plan);
  if (frame.load_validity) sized.validity = resize_crop(frame.validity(), plan);
  if (parts == FrameParts::kImageAndDepth && frame.has_depth())
    sized.depth = resize_crop(frame.depth(), plan);
  return sized;
}

SizedFrame load_magnified(const Frame& frame, const ImageSize& target, int64_t times) {
  const ResizeCrop plan = magnified(plan_resize_crop(frame.camera.width, frame.camera.height, target), times);
  SizedFrame sized;
  sized.camera = resize_crop(frame.camera, plan);
  sized.image = resize_crop(frame.image(), plan);
  return sized;
}

}  // namespace gld
