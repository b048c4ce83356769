#include "datasets/loading/mixing.h"

#include "datasets/scenes/seeded_random.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gld {
namespace {

// Returns the index of the interval of cumulative weights that holds a random number.
size_t draw(const std::vector<double>& cumulative, SeededRandom& random) {
  const double position = random.uniform() * cumulative.back();
  const auto found = std::upper_bound(cumulative.begin(), cumulative.end(), position);
  return std::min(static_cast<size_t>(found - cumulative.begin()), cumulative.size() - 1);
}

void append_weight(std::vector<double>& cumulative, double weight, const std::string& where) {
  if (!(weight > 0) || !std::isfinite(weight)) {
    fail({where, "a positive weight", std::to_string(weight), "correct it or leave the entry out"});
  }
  cumulative.push_back((cumulative.empty() ? 0 : cumulative.back()) + weight);
}

}  // namespace

Mixture::Mixture(std::vector<MixturePart> parts) : parts_(std::move(parts)) {
  if (parts_.empty()) fail({"dataset mixture", "at least one dataset", "none", "name one"});
  for (const MixturePart& part : parts_) {
    append_weight(cumulative_, part.weight, "dataset " + part.name);
    part.views.check();
    if (part.views.views != parts_.front().views.views) {
      fail({"dataset " + part.name,
            std::to_string(parts_.front().views.views) + " views as in the first dataset",
            std::to_string(part.views.views), "use the same number of views for all datasets"});
    }
    if (part.dataset == nullptr || part.dataset->size() < 1) {
      fail({"dataset " + part.name, "at least one scene", "none", "check the folder"});
    }
  }
}

SampleChoice Mixture::choose(const SampleKey& key) const {
  SeededRandom random({key.seed, key.epoch, key.index, key.attempt, 4});
  SampleChoice choice;
  choice.part = draw(cumulative_, random);
  choice.scene = random.integer(0, parts_[choice.part].dataset->size() - 1);
  return choice;
}

ImageSize choose_size(const std::vector<WeightedSize>& sizes, uint64_t seed, uint64_t batch) {
  if (sizes.empty()) fail({"sizes", "at least one size", "none", "list the sizes to train at"});
  std::vector<double> cumulative;
  for (const WeightedSize& size : sizes) {
    append_weight(cumulative, size.weight,
                  "size " + std::to_string(size.size.width) + "x" + std::to_string(size.size.height));
  }
  SeededRandom random({seed, batch, 5});
  return sizes[draw(cumulative, random)].size;
}

}  // namespace gld
