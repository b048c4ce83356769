#include "gld/latents/latent_statistics.h"

#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"

#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

torch::Tensor read_channels(const WeightFile& file, const std::string& name) {
  const auto tensor = read_tensor(file, name).to(torch::kFloat32).contiguous();
  const std::string where = file.path().string() + ": " + name;
  const bool one_dimension = tensor.dim() == 1 || (tensor.dim() == 4 && tensor.numel() == tensor.size(1));
  if (!one_dimension || tensor.numel() == 0) {
    fail({where, "shape (channels) or (1, channels, 1, 1)", c10::str("shape ", tensor.sizes()),
          "compute the statistics with gld stats"});
  }
  if (!torch::isfinite(tensor).all().item<bool>()) {
    fail({where, "finite numbers", "others", "compute the statistics with gld stats"});
  }
  return tensor.flatten().clone();
}

torch::Tensor deviation(const LatentStatistics& statistics) {
  return (statistics.variance.to(torch::kFloat64) + statistics.epsilon).sqrt();
}

torch::Tensor from_doubles(const std::vector<double>& values) {
  return torch::tensor(values, torch::kFloat64).to(torch::kFloat32);
}

void check_channels(const torch::Tensor& x, const LatentStatistics& statistics) {
  if (x.dim() > 0 && x.size(-1) == statistics.channels()) return;
  fail({"latent statistics", std::to_string(statistics.channels()) + " channels",
        c10::str("shape ", x.sizes()), "use the statistics of this level and backbone"});
}

}  // namespace

torch::Tensor LatentStatistics::normalise(const torch::Tensor& features) const {
  check_channels(features, *this);
  return (features - mean) * deviation(*this).reciprocal().to(features.scalar_type());
}

torch::Tensor LatentStatistics::denormalise(const torch::Tensor& latent) const {
  check_channels(latent, *this);
  return latent * deviation(*this).to(latent.scalar_type()) + mean;
}

LatentStatistics LatentStatistics::to(torch::Device device) const {
  return {mean.to(device), variance.to(device), epsilon};
}

LatentStatistics read_latent_statistics(const WeightFile& file, const std::string& prefix, double epsilon) {
  LatentStatistics statistics;
  statistics.mean = read_channels(file, prefix + "mean");
  statistics.variance = read_channels(file, prefix + "var");
  statistics.epsilon = epsilon;
  const std::string where = file.path().string() + ": " + prefix + "var";
  if (statistics.variance.size(0) != statistics.mean.size(0)) {
    fail({where, std::to_string(statistics.mean.size(0)) + " channels, as the mean has",
          std::to_string(statistics.variance.size(0)), "compute the statistics with gld stats"});
  }
  if (statistics.variance.lt(0).any().item<bool>()) {
    fail({where, "variances of at least 0", "a negative one", "compute the statistics with gld stats"});
  }
  return statistics;
}

LatentStatistics read_latent_statistics(const std::filesystem::path& file, double epsilon) {
  return read_latent_statistics(*WeightFile::open(file), "", epsilon);
}

std::map<std::string, torch::Tensor> statistics_tensors(const LatentStatistics& statistics) {
  return {{"mean", statistics.mean}, {"var", statistics.variance}};
}

LatentStatistics statistics_of(const StreamingMoments& moments, double epsilon) {
  return {from_doubles(moments.mean()), from_doubles(moments.variance()), epsilon};
}

void add_features(StreamingMoments& moments, const torch::Tensor& features) {
  if (features.dim() == 0 || features.size(-1) != moments.channels()) {
    fail({"latent statistics", std::to_string(moments.channels()) + " channels",
          c10::str("shape ", features.sizes()), "use features of one level and backbone"});
  }
  const auto rows = features.detach().to(torch::kCPU, torch::kFloat32).contiguous();
  moments.add(rows.data_ptr<float>(), rows.numel() / moments.channels());
}

}  // namespace gld
