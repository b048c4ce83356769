#include "models/weight_loading.h"

#include "gld/configuration.h"
#include "gld/error.h"
#include "gld/weight_tensors.h"

#include <algorithm>
#include <functional>

#include <torch/autograd.h>

namespace gld {
namespace {

// Where the tensors come from: a file or a map.
struct TensorSource {
  std::string where;
  std::vector<std::string> names;  // sorted, with the prefix
  std::function<torch::Tensor(const std::string&)> read;
};

std::string shape_of(const torch::Tensor& tensor) { return shape_text(tensor.sizes().vec()); }

const IgnoredName* ignored_by(const std::vector<IgnoredName>& ignored, const std::string& name) {
  for (const auto& entry : ignored) {
    const bool pattern = !entry.name.empty() && entry.name.back() == '*';
    const size_t length = pattern ? entry.name.size() - 1 : entry.name.size();
    if (name.compare(0, length, entry.name, 0, length) == 0 && (pattern || name.size() == length))
      return &entry;
  }
  return nullptr;
}

void set_tensor(torch::Tensor& target, const torch::Tensor& value, const std::string& where,
                LoadReport& report) {
  if (target.is_meta()) {
    fail({where, "a module with memory", "one on the meta device", "construct the module on the CPU or GPU"});
  }
  if (value.sizes() != target.sizes()) {
    fail({where, "shape " + shape_of(target), shape_of(value),
          "check that the configuration belongs to these weights"});
  }
  const bool converts = value.scalar_type() != target.scalar_type();
  if (converts && !(value.is_floating_point() && target.is_floating_point())) {
    fail({where, dtype_name(file_dtype(target.scalar_type(), where)),
          dtype_name(file_dtype(value.scalar_type(), where)),
          "check that the configuration belongs to these weights"});
  }
  const auto placed = value.to(target.device(), target.scalar_type());
  report.tensors += 1;
  report.parameters += placed.numel();
  report.converted += converts ? 1 : 0;
  report.shared += placed.is_same(value) ? 1 : 0;
  target.set_data(placed.detach());
}

LoadReport load_from(torch::nn::Module& module, const TensorSource& source,
                     const WeightSelection& selection) {
  const torch::NoGradGuard no_grad;
  const size_t prefix = selection.prefix.size();
  std::map<std::string, torch::Tensor> targets = named_tensors(module);
  std::vector<std::string> names;
  for (const auto& full : source.names) {
    if (full.compare(0, prefix, selection.prefix) == 0) names.push_back(full.substr(prefix));
  }
  if (names.empty() && !targets.empty()) {
    fail({source.where,
          selection.prefix.empty() ? "tensors" : "tensors whose names start with " + selection.prefix, "none",
          "list the file with gld inspect"});
  }
  LoadReport report;
  // First the names, so that a wrong file is refused before any parameter changes.
  for (const auto& name : names) {
    if (targets.count(name) != 0) continue;
    if (ignored_by(selection.ignored, name) == nullptr) {
      std::vector<std::string> known;
      for (const auto& target : targets) known.push_back(target.first);
      const auto similar = nearest_name(name, known);
      fail({source.where, "no tensor beside the model's own", "the unexpected tensor " + printable_name(name),
            similar.empty() ? "check that the configuration belongs to these weights"
                            : "check that the configuration belongs to these weights (the nearest tensor of "
                              "the model is " +
                                  similar + ")"});
    }
    report.ignored.push_back(name);
  }
  for (const auto& target : targets) {
    if (!std::binary_search(names.begin(), names.end(), target.first)) {
      fail({source.where, "a tensor named " + selection.prefix + target.first, "none",
            "check that the configuration belongs to these weights"});
    }
  }
  for (auto& [name, target] : targets) {
    const auto value = source.read(selection.prefix + name);
    set_tensor(target, value, source.where + ": tensor " + selection.prefix + name, report);
  }
  return report;
}

}  // namespace

LoadReport load_strict(torch::nn::Module& module, const WeightFile& file, const WeightSelection& selection) {
  TensorSource source;
  source.where = file.path().string();
  for (const auto& entry : file.entries()) source.names.push_back(entry.name);
  source.read = [&file](const std::string& name) { return read_tensor(file, name); };
  return load_from(module, source, selection);
}

LoadReport load_strict(torch::nn::Module& module, const std::map<std::string, torch::Tensor>& tensors,
                       const std::string& where, const WeightSelection& selection) {
  TensorSource source;
  source.where = where;
  for (const auto& entry : tensors) source.names.push_back(entry.first);
  source.read = [&tensors](const std::string& name) { return tensors.at(name); };
  return load_from(module, source, selection);
}

std::map<std::string, torch::Tensor> named_tensors(const torch::nn::Module& module) {
  std::map<std::string, torch::Tensor> tensors;
  for (const auto& item : module.named_parameters(/*recurse=*/true))
    tensors.emplace(item.key(), item.value());
  for (const auto& item : module.named_buffers(/*recurse=*/true)) tensors.emplace(item.key(), item.value());
  return tensors;
}

}  // namespace gld
