#include "gld/photogrammetry/stereo_picture.h"

#include "gld/cameras/resized_camera.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

struct Brightness {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;  // not finite where one of the colours is not
};

Brightness brightness_of(const PicturedView& view) {
  Brightness result{view.width, view.height,
                    std::vector<float>(static_cast<size_t>(view.width * view.height))};
  for (size_t i = 0; i < result.values.size(); ++i) {
    result.values[i] = 0.299F * view.rgb[3 * i] + 0.587F * view.rgb[3 * i + 1] + 0.114F * view.rgb[3 * i + 2];
  }
  return result;
}

// The part of a cell of the reduced side that each pixel of the full side has.
struct AreaShares {
  std::vector<int64_t> first;        // (cells)
  std::vector<int64_t> count;        // (cells)
  std::vector<float> weights;        // of all, one cell after another; 1 together for each
  std::vector<size_t> first_weight;  // (cells)

  AreaShares(int64_t pixels, int64_t cells) {
    const double side = static_cast<double>(pixels) / static_cast<double>(cells);
    for (int64_t cell = 0; cell < cells; ++cell) {
      const double begin = static_cast<double>(cell) * side, end = static_cast<double>(cell + 1) * side;
      const auto low = static_cast<int64_t>(begin);
      const int64_t high = std::min(pixels, static_cast<int64_t>(std::ceil(end - 1e-9)));
      first.push_back(low);
      count.push_back(high - low);
      first_weight.push_back(weights.size());
      for (int64_t i = low; i < high; ++i) {
        const double share =
            std::min(end, static_cast<double>(i + 1)) - std::max(begin, static_cast<double>(i));
        weights.push_back(static_cast<float>(share / side));
      }
    }
  }
};

Brightness reduced(const Brightness& full, int64_t width, int64_t height) {
  if (width == full.width && height == full.height) return full;
  const AreaShares columns(full.width, width), rows(full.height, height);
  std::vector<float> narrow(static_cast<size_t>(width * full.height), 0.0F);
  for (int64_t y = 0; y < full.height; ++y) {
    for (size_t x = 0; x < static_cast<size_t>(width); ++x) {
      float sum = 0;
      for (int64_t i = 0; i < columns.count[x]; ++i) {
        sum += columns.weights[columns.first_weight[x] + static_cast<size_t>(i)] *
               full.values[static_cast<size_t>(y * full.width + columns.first[x] + i)];
      }
      narrow[static_cast<size_t>(y * width) + x] = sum;
    }
  }
  Brightness result{width, height, std::vector<float>(static_cast<size_t>(width * height), 0.0F)};
  for (size_t y = 0; y < static_cast<size_t>(height); ++y) {
    float* row = result.values.data() + y * static_cast<size_t>(width);
    for (int64_t i = 0; i < rows.count[y]; ++i) {
      const float weight = rows.weights[rows.first_weight[y] + static_cast<size_t>(i)];
      const float* from = narrow.data() + (rows.first[y] + i) * width;
      for (int64_t x = 0; x < width; ++x) row[x] += weight * from[x];
    }
  }
  return result;
}

// Takes off the mean and scales to [-1, 1].
void normalise(std::vector<float>& values, float& deviation) {
  double sum = 0, count = 0;
  for (const float value : values) {
    if (!std::isfinite(value)) continue;
    sum += value;
    count += 1;
  }
  const auto mean = static_cast<float>(count > 0 ? sum / count : 0);
  float largest = 0;
  for (float& value : values) {
    if (!std::isfinite(value)) continue;
    value -= mean;
    largest = std::max(largest, std::abs(value));
  }
  // Of a picture in one colour only rounding is left.
  const float scale = largest > 1e-6F * std::max(1.0F, std::abs(mean)) ? 1 / largest : 0;
  double squares = 0;
  for (float& value : values) {
    if (!std::isfinite(value)) continue;
    value *= scale;
    squares += static_cast<double>(value) * value;
  }
  deviation = static_cast<float>(std::sqrt(squares / std::max(count, 1.0)));
}

// Marks every pixel within radius of one that has no value.
void mark_invalid(StereoPicture& picture, int64_t radius) {
  picture.valid.assign(picture.brightness.size(), 1);
  for (int64_t y = 0; y < picture.height; ++y) {
    for (int64_t x = 0; x < picture.width; ++x) {
      float& value = picture.brightness[static_cast<size_t>(y * picture.width + x)];
      if (std::isfinite(value)) continue;
      value = 0;
      const int64_t left = std::max<int64_t>(x - radius, 0), right = std::min(x + radius, picture.width - 1);
      for (int64_t row = std::max<int64_t>(y - radius, 0); row <= std::min(y + radius, picture.height - 1);
           ++row) {
        const auto first = picture.valid.begin() + row * picture.width;
        std::fill(first + left, first + right + 1, uint8_t{0});
      }
    }
  }
}

void make_texels(StereoPicture& picture) {
  const int64_t width = picture.width, height = picture.height;
  picture.texels.assign(static_cast<size_t>((width + 2) * (height + 2)), 1);
  const auto corner = [&](int64_t x, int64_t y) {
    const float value =
        picture.brightness[static_cast<size_t>(std::min(y, height - 1) * width + std::min(x, width - 1))];
    return static_cast<int16_t>(std::lround(value * static_cast<float>(kTexelOne)));
  };
  const auto bits = [](int16_t value, int place) {
    return static_cast<uint64_t>(static_cast<uint16_t>(value)) << (16 * place);
  };
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const auto pixel = static_cast<size_t>(y * width + x);
      const auto first = static_cast<uint64_t>(static_cast<uint16_t>(corner(x, y)) & 0xFFFEU);
      picture.texels[static_cast<size_t>((y + 1) * (width + 2) + x + 1)] =
          first | (picture.valid[pixel] != 0 ? 0U : 1U) | bits(corner(x + 1, y), 1) |
          bits(corner(x, y + 1), 2) | bits(corner(x + 1, y + 1), 3);
    }
  }
}

}  // namespace

StereoPicture stereo_picture(const PicturedView& view, int64_t largest_side, int64_t window_radius) {
  const double scale = std::min(
      1.0, static_cast<double>(largest_side) / static_cast<double>(std::max(view.width, view.height)));
  StereoPicture picture;
  picture.width = std::max<int64_t>(1, std::lround(static_cast<double>(view.width) * scale));
  picture.height = std::max<int64_t>(1, std::lround(static_cast<double>(view.height) * scale));
  picture.camera = resized_camera(view.camera, picture.width, picture.height);
  picture.brightness = reduced(brightness_of(view), picture.width, picture.height).values;
  normalise(picture.brightness, picture.deviation);
  // The radius is one more than the window's, because a place in the picture lies between pixels.
  mark_invalid(picture, window_radius + 1);
  make_texels(picture);
  return picture;
}

}  // namespace gld
