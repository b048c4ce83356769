#pragma once

#include "datasets/loading/dataset.h"
#include "datasets/scenes/resize_crop.h"
#include "datasets/scenes/view_sampling.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// One dataset of a mixture.
struct MixturePart {
  std::string name;
  std::shared_ptr<const Dataset> dataset;
  double weight = 1;   // share of the samples, relative to the other parts
  ViewSampling views;  // intervals differ between datasets; the number of views does not
};

// One size of a mixture of resolutions; all samples of a batch have the same size.
struct WeightedSize {
  ImageSize size;
  double weight = 1;
};

// Which scene and views a sample uses, before anything is loaded.
struct SampleChoice {
  size_t part = 0;
  int64_t scene = 0;
};

// Chooses datasets by their weights and scenes evenly; it is a pure function of the key.
class Mixture {
 public:
  // Throws Error when there are no parts, a weight is not positive, or view counts differ.
  explicit Mixture(std::vector<MixturePart> parts);
  const std::vector<MixturePart>& parts() const { return parts_; }
  SampleChoice choose(const SampleKey& key) const;

 private:
  std::vector<MixturePart> parts_;
  std::vector<double> cumulative_;
};

// Returns the size of batch number `batch`; it is a pure function of its arguments.
ImageSize choose_size(const std::vector<WeightedSize>& sizes, uint64_t seed, uint64_t batch);

}  // namespace gld
