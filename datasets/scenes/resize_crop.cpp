#include "datasets/scenes/resize_crop.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

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
std::vector<int64_t> nearest_sources(int64_t source, int64_t resized, int64_t offset, int64_t count) {
  std::vector<int64_t> result(static_cast<size_t>(count));
  const double scale = static_cast<double>(source) / static_cast<double>(resized);
  for (int64_t i = 0; i < count; ++i) {
    const auto position = static_cast<int64_t>((static_cast<double>(i + offset) + 0.5) * scale);
    result[static_cast<size_t>(i)] = std::min(position, source - 1);
  }
  return result;
}

template <class Value>
std::vector<Value> sampled(const std::vector<Value>& source, const ResizeCrop& plan) {
  const auto columns = nearest_sources(plan.source_width, plan.resized_width, plan.left, plan.target.width);
  const auto rows = nearest_sources(plan.source_height, plan.resized_height, plan.top, plan.target.height);
  std::vector<Value> result;
  result.reserve(columns.size() * rows.size());
  for (int64_t y : rows) {
    for (int64_t x : columns) result.push_back(source[static_cast<size_t>(y * plan.source_width + x)]);
  }
  return result;
}

}  // namespace

std::vector<ImageSize> published_sizes() { return {{504, 504}, {504, 378}, {504, 336}, {504, 280}}; }

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
  if (width < 2 || height < 2 || target.width < 2 || target.height < 2) {
    fail({"resize and crop",
          "sizes of at least 2 pixels",
          std::to_string(width) + "x" + std::to_string(height) + " to " + std::to_string(target.width) + "x" +
              std::to_string(target.height),
          {}});
  }
  const double scale = std::max(static_cast<double>(target.width) / static_cast<double>(width),
                                static_cast<double>(target.height) / static_cast<double>(height));
  ResizeCrop plan;
  plan.source_width = width;
  plan.source_height = height;
  plan.resized_width = std::max(target.width, static_cast<int64_t>(std::llround(width * scale)));
  plan.resized_height = std::max(target.height, static_cast<int64_t>(std::llround(height * scale)));
  plan.left = (plan.resized_width - target.width) / 2;
  plan.top = (plan.resized_height - target.height) / 2;
  plan.target = target;
  return plan;
}

Camera resize_crop(const Camera& camera, const ResizeCrop& plan) {
  check_source(camera.width, camera.height, plan);
  Camera result = camera;
  result.width = plan.target.width;
  result.height = plan.target.height;
  result.intrinsics.row(0) *=
      static_cast<double>(plan.resized_width) / static_cast<double>(plan.source_width);
  result.intrinsics.row(1) *=
      static_cast<double>(plan.resized_height) / static_cast<double>(plan.source_height);
  result.intrinsics(0, 2) -= static_cast<double>(plan.left);
  result.intrinsics(1, 2) -= static_cast<double>(plan.top);
  return result;
}

Image resize_crop(const Image& image, const ResizeCrop& plan) {
  check_source(image.width, image.height, plan);
  const cv::Mat source(static_cast<int>(image.height), static_cast<int>(image.width), CV_8UC3,
                       const_cast<uint8_t*>(image.rgb.data()));
  const bool shrinks = plan.resized_width < plan.source_width || plan.resized_height < plan.source_height;
  cv::Mat resized = source;
  if (plan.resized_width != plan.source_width || plan.resized_height != plan.source_height) {
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

SizedFrame load_sized(const Frame& frame, const ImageSize& target, FrameParts parts) {
  const ResizeCrop plan = plan_resize_crop(frame.camera.width, frame.camera.height, target);
  SizedFrame sized;
  sized.camera = resize_crop(frame.camera, plan);
  sized.image = resize_crop(frame.image(), plan);
  if (frame.load_validity) sized.validity = resize_crop(frame.validity(), plan);
  if (parts == FrameParts::kImageAndDepth && frame.has_depth())
    sized.depth = resize_crop(frame.depth(), plan);
  return sized;
}

}  // namespace gld
