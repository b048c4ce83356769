#include "datasets/registration/picture_features.h"

#include "gld/kernels/matrix_product.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

constexpr int64_t kDescriptor = 128;
constexpr float kLargestRatio = 0.8F;
constexpr int64_t kRowsAtOnce = 256;  // of products, so that they stay in the cache

// Least contrast of a place, and what is taken where a picture shows too little of it (a bare corridor).
constexpr double kContrasts[] = {0.02, 0.007};
constexpr int64_t kEnough = 2000;
constexpr int kLayers = 3;  // an octave

// The nearest and second nearest neighbour by the product of unit vectors, d^2 = 2 - 2 product.
struct Nearest {
  int32_t index = -1;
  float product = -2;
  float second = -2;

  void take(int32_t candidate, float its_product) {
    if (its_product > product) {
      second = product;
      product = its_product;
      index = candidate;
    } else if (its_product > second) {
      second = its_product;
    }
  }
  bool distinct() const {
    return index >= 0 && 2 - 2 * product < kLargestRatio * kLargestRatio * (2 - 2 * second);
  }
};

}  // namespace

PictureFeatures picture_features(const Image& picture, int64_t longest_side, int64_t most_features) {
  const cv::Mat colours(static_cast<int>(picture.height), static_cast<int>(picture.width), CV_8UC3,
                        const_cast<uint8_t*>(picture.rgb.data()));
  cv::Mat grey;
  cv::cvtColor(colours, grey, cv::COLOR_RGB2GRAY);
  const auto longer = static_cast<double>(std::max(picture.width, picture.height));
  if (longer > static_cast<double>(longest_side)) {
    const double scale = static_cast<double>(longest_side) / longer;
    cv::resize(grey, grey,
               {std::max(8, static_cast<int>(std::lround(grey.cols * scale))),
                std::max(8, static_cast<int>(std::lround(grey.rows * scale)))},
               0, 0, cv::INTER_AREA);
  }
  std::vector<cv::KeyPoint> places;
  cv::Mat descriptors;
  for (const double contrast : kContrasts) {
    cv::SIFT::create(static_cast<int>(most_features), kLayers, contrast)
        ->detectAndCompute(grey, cv::noArray(), places, descriptors);
    if (static_cast<int64_t>(places.size()) >= std::min(kEnough, most_features)) break;
  }

  std::vector<int> order(places.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return places[static_cast<size_t>(a)].response > places[static_cast<size_t>(b)].response;
  });
  PictureFeatures found;
  found.searched_side = std::max(grey.cols, grey.rows);
  found.descriptors.reserve(order.size() * kDescriptor);
  for (const int i : order) {
    const cv::Point2f& place = places[static_cast<size_t>(i)].pt;
    // OpenCV's first pixel has its centre at 0; each side has its own scale, that of the whole-pixel sizes.
    const double across = (place.x + 0.5) / grey.cols - 0.5, down = (place.y + 0.5) / grey.rows - 0.5;
    found.points.emplace_back(across * static_cast<double>(picture.width) / longer,
                              down * static_cast<double>(picture.height) / longer);
    const float* values = descriptors.ptr<float>(i);
    float sum = 0;
    for (int64_t d = 0; d < kDescriptor; ++d) sum += values[d];
    for (int64_t d = 0; d < kDescriptor; ++d) {
      found.descriptors.push_back(sum > 0 ? std::sqrt(values[d] / sum) : 0);
    }
  }
  return found;
}

std::vector<FeatureMatch> match_features(const PictureFeatures& first, const PictureFeatures& second,
                                         int threads) {
  std::vector<FeatureMatch> matches;
  const int64_t rows = first.size(), columns = second.size();
  if (rows < 2 || columns < 2) return matches;
  KernelSettings settings;
  settings.threads = threads;
  LinearProduct product;
  product.inputs = kDescriptor;
  product.outputs = columns;
  product.x_stride = product.weight_stride = kDescriptor;
  product.weight = second.descriptors.data();
  std::vector<float> packed(static_cast<size_t>(packed_weight_floats(columns, kDescriptor, settings)));
  pack_weight(product, settings, packed.data());
  product.packed_weight = packed.data();
  std::vector<float> products(static_cast<size_t>(std::min(rows, kRowsAtOnce) * columns));
  product.y = products.data();
  product.y_stride = columns;
  std::vector<Nearest> of_first(static_cast<size_t>(rows)), of_second(static_cast<size_t>(columns));
  for (int64_t begin = 0; begin < rows; begin += kRowsAtOnce) {
    product.rows = std::min(kRowsAtOnce, rows - begin);
    product.x = first.descriptors.data() + begin * kDescriptor;
    linear_product(product, settings);
    for (int64_t i = 0; i < product.rows; ++i) {
      const float* row = products.data() + i * columns;
      Nearest& nearest = of_first[static_cast<size_t>(begin + i)];
      for (int64_t j = 0; j < columns; ++j) {
        nearest.take(static_cast<int32_t>(j), row[j]);
        of_second[static_cast<size_t>(j)].take(static_cast<int32_t>(begin + i), row[j]);
      }
    }
  }
  for (int64_t i = 0; i < rows; ++i) {
    const Nearest& nearest = of_first[static_cast<size_t>(i)];
    if (!nearest.distinct()) continue;
    const Nearest& back = of_second[static_cast<size_t>(nearest.index)];
    if (back.index == i && back.distinct()) matches.push_back({static_cast<int32_t>(i), nearest.index});
  }
  return matches;
}

}  // namespace gld
