#include "datasets/formats/frame_pixels.h"

#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// Two cameras with the same bytes undistort alike.
std::string undistorter_key(const LensCamera& camera) {
  const auto append = [](std::string& key, const auto& value) {
    key.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  std::string key;
  append(key, camera.width);
  append(key, camera.height);
  for (int i = 0; i < 9; ++i) append(key, camera.intrinsics.data()[i]);
  const LensDistortion& lens = camera.lens;
  append(key, lens.model);
  for (double value :
       {lens.k1, lens.k2, lens.k3, lens.k4, lens.k5, lens.k6, lens.p1, lens.p2, lens.sx1, lens.sy1}) {
    append(key, value);
  }
  return key;
}

template <class Value>
std::vector<Value> nearest(const std::vector<Value>& source, const Undistorter::Size& from,
                           const Undistorter::Size& to) {
  std::vector<Value> result;
  result.reserve(static_cast<size_t>(to.width * to.height));
  for (int64_t y = 0; y < to.height; ++y) {
    const int64_t row = (2 * y + 1) * from.height / (2 * to.height);
    for (int64_t x = 0; x < to.width; ++x) {
      result.push_back(
          source[static_cast<size_t>(row * from.width + (2 * x + 1) * from.width / (2 * to.width))]);
    }
  }
  return result;
}

// Brings depth or a mask to the size of its picture; one of another aspect belongs to another picture, or to this one
// as it was before it was turned.
template <class Value>
void fit(std::vector<Value>& values, int64_t& width, int64_t& height, const Undistorter::Size& to,
         const std::filesystem::path& picture) {
  if (width == to.width && height == to.height) return;
  if (width < 1 || height < 1 || values.size() != static_cast<size_t>(width * height)) {
    fail({"depth or mask of " + picture.string(), "a value for every pixel",
          std::to_string(values.size()) + " values for " + size_text(width, height),
          "check what made the file"});
  }
  if (!same_aspect(static_cast<double>(to.width) / static_cast<double>(width),
                   static_cast<double>(to.height) / static_cast<double>(height))) {
    fail({"depth or mask of " + picture.string(),
          "the size of the picture " + size_text(to.width, to.height) + " or a scaled copy",
          size_text(width, height), "check that it belongs to this picture and is turned as it is"});
  }
  values = nearest(values, {width, height}, to);
  width = to.width;
  height = to.height;
}

}  // namespace

Frame FrameMaker::make(const FrameRecord& record) {
  const FittedImage fitted = fit_image(record.image_file, record.camera_width, record.camera_height);
  if (!record.lens.finite()) {
    fail({record.image_file.string(), "finite lens distortion", "a value that is not a number or infinite",
          "check the camera model"});
  }
  Frame frame;
  frame.name = record.name;
  frame.image_file = record.image_file;
  frame.camera.width = fitted.width;
  frame.camera.height = fitted.height;
  frame.camera.intrinsics = scaled_intrinsics(record.intrinsics, fitted);
  frame.camera.world_from_camera = record.world_from_camera;
  check_frame_camera(frame.camera, record.image_file.string());

  std::shared_ptr<const Undistorter> undistorter;
  if (!record.lens.ideal()) {
    constexpr int64_t kLargestSide = 32766;  // that OpenCV's remap takes
    if (std::max(fitted.width, fitted.height) > kLargestSide) {
      fail({record.image_file.string(),
            fmt::format("at most {} pixels a side where a lens has to be undone", kLargestSide),
            size_text(fitted.width, fitted.height), "undistort it before, or reduce it"});
    }
    const LensCamera source{fitted.width, fitted.height, frame.camera.intrinsics, record.lens};
    auto& shared = undistortions_[undistorter_key(source)];
    if (!shared.undistorter) {
      shared.ideal = cropped_to_source(frame.camera, source);
      shared.undistorter = make_undistorter(shared.ideal, source);
    }
    undistorter = shared.undistorter;
    frame.camera.width = shared.ideal.width;
    frame.camera.height = shared.ideal.height;
    frame.camera.intrinsics = shared.ideal.intrinsics;
    if (frame.camera.width != fitted.width || frame.camera.height != fitted.height) {
      if (cropped_frames_++ == 0) {
        first_crop_ = size_text(fitted.width, fitted.height) + " to " +
                      size_text(frame.camera.width, frame.camera.height);
      }
    }
  }

  const auto file = record.image_file;
  const auto orientation = fitted.orientation;
  frame.load_image = [file, orientation, undistorter] {
    Image image = read_image(file, orientation);
    return undistorter ? undistorter->image(image) : image;
  };
  const Undistorter::Size size{fitted.width, fitted.height};
  if (record.load_depth) {
    frame.load_depth = [load = record.load_depth, size, undistorter, file] {
      DepthMap depth = load();
      fit(depth.metres, depth.width, depth.height, size, file);
      return undistorter ? undistorter->depth(depth) : depth;
    };
  }
  if (record.load_validity) {
    frame.load_validity = [load = record.load_validity, size, undistorter, file] {
      ValidityMask mask = load();
      fit(mask.valid, mask.width, mask.height, size, file);
      return undistorter ? undistorter->validity(mask) : mask;
    };
  } else if (undistorter) {
    frame.load_validity = [undistorter] { return undistorter->validity(); };
  }
  return frame;
}

std::string FrameMaker::crop_note() const {
  if (cropped_frames_ == 0) return "";
  return "Pictures without their lens distortion have borders that the lens did not see: cropped away in " +
         std::to_string(cropped_frames_) + " of them, the first from " + first_crop_ +
         "; the intrinsics follow.";
}

}  // namespace gld
