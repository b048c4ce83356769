#include "models/weights/weight_loading.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/tensors/device.h"
#include "gld/tensors/weight_tensors.h"

#include <optional>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// What a file or a map says about one of its tensors.
struct Offered {
  DType dtype = DType::kFloat32;
  std::vector<int64_t> shape;
};

using Offers = std::map<std::string, Offered>;  // by name, without the prefix

const std::string kCheckConfiguration = "check that the configuration belongs to these weights";

bool starts_with(const std::string& name, const std::string& beginning) {
  return name.compare(0, beginning.size(), beginning) == 0;
}

// Returns what the module calls a tensor of the file; nothing where the selection leaves it out.
std::optional<std::string> module_name(const std::string& name, const WeightSelection& selection) {
  for (const auto& [there, here] : selection.elsewhere) {
    if (starts_with(name, there)) return here + name.substr(there.size());
  }
  if (!starts_with(name, selection.prefix)) return std::nullopt;
  return name.substr(selection.prefix.size());
}

// Returns the name that it has in the file: the way back.
std::string file_name(const std::string& name, const WeightSelection& selection) {
  for (const auto& [there, here] : selection.elsewhere) {
    if (starts_with(name, here)) return there + name.substr(here.size());
  }
  return selection.prefix + name;
}

void check_offer(const torch::Tensor& target, const Offered& offered, const std::string& where) {
  const auto shape = target.sizes().vec();
  if (offered.shape != shape) {
    fail({where, "shape " + shape_text(shape), shape_text(offered.shape), kCheckConfiguration});
  }
  const DType dtype = file_dtype(target.scalar_type(), where);
  if (offered.dtype != dtype && !(is_floating(offered.dtype) && is_floating(dtype))) {
    fail({where, dtype_name(dtype), dtype_name(offered.dtype), kCheckConfiguration});
  }
}

// Checks names, shapes and dtypes, before anything is loaded: a wrong file leaves the module as it was.
void check_offers(const std::map<std::string, torch::Tensor>& targets, const Offers& offers,
                  const std::string& where, const WeightSelection& selection, LoadReport& report) {
  if (offers.empty() && !targets.empty()) {
    fail({where, selection.prefix.empty() ? "tensors" : "tensors whose names start with " + selection.prefix,
          "none", "list the file with gld inspect"});
  }
  for (const auto& offer : offers) {
    if (targets.count(offer.first) != 0) continue;
    if (ignored_name(selection.ignored, offer.first) != nullptr) {
      report.ignored.push_back(offer.first);
      continue;
    }
    std::vector<std::string> known;
    known.reserve(targets.size());
    for (const auto& target : targets) known.push_back(target.first);
    const auto similar = nearest_name(offer.first, known);
    fail({where, "no tensor beside the model's own",
          "the unexpected tensor " + printable_name(file_name(offer.first, selection)),
          similar.empty()
              ? kCheckConfiguration
              : fmt::format("{} (the model's nearest tensor is {})", kCheckConfiguration, similar)});
  }
  for (const auto& [name, target] : targets) {
    const auto offer = offers.find(name);
    const std::string full = file_name(name, selection);
    if (offer == offers.end()) fail({where, "a tensor named " + full, "none", kCheckConfiguration});
    check_offer(target, offer->second, fmt::format("{}: tensor {}", where, full));
  }
}

// full is its name in the file. Two names of a file may stand for one of the module (WeightSelection::elsewhere).
void add_offer(const std::string& name, const Offered& offered, const std::string& full,
               const std::string& where, Offers& offers) {
  if (offers.emplace(name, offered).second) return;
  fail({where, "one tensor for " + printable_name(name), "a second one, " + printable_name(full),
        kCheckConfiguration});
}

void set_tensor(const torch::Tensor& target, const torch::Tensor& value, const std::string& where,
                LoadReport& report) {
  if (target.is_meta() && !reads_meta_device()) {
    fail({where, "a module with memory", "one on the meta device", "construct the module on the CPU or GPU"});
  }
  const auto placed = value.to(target.device(), target.scalar_type());
  report.tensors += 1;
  report.parameters += placed.numel();
  report.converted += value.scalar_type() != target.scalar_type() ? 1 : 0;
  report.shared += placed.is_same(value) ? 1 : 0;
  target.set_data(placed.detach());
}

}  // namespace

const IgnoredName* ignored_name(const std::vector<IgnoredName>& ignored, const std::string& name) {
  for (const auto& entry : ignored) {
    const bool pattern = !entry.name.empty() && entry.name.back() == '*';
    const size_t length = pattern ? entry.name.size() - 1 : entry.name.size();
    if (name.compare(0, length, entry.name, 0, length) == 0 && (pattern || name.size() == length))
      return &entry;
  }
  return nullptr;
}

std::vector<MatchedTensor> match_strict(const torch::nn::Module& module, const WeightFile& file,
                                        const WeightSelection& selection, LoadReport& report) {
  Offers offers;
  for (const auto& entry : file.entries()) {
    const auto name = module_name(entry.name, selection);
    if (name) add_offer(*name, {entry.dtype, entry.shape}, entry.name, file.path().string(), offers);
  }
  const auto targets = named_tensors(module);
  check_offers(targets, offers, file.path().string(), selection, report);
  std::vector<MatchedTensor> matched;
  matched.reserve(targets.size());
  for (const auto& [name, target] : targets) {
    matched.push_back({name, target, &file.entry(file_name(name, selection))});
  }
  return matched;
}

LoadReport load_strict(torch::nn::Module& module, const WeightFile& file, const WeightSelection& selection) {
  const torch::NoGradGuard no_grad;
  LoadReport report;
  for (const auto& matched : match_strict(module, file, selection, report)) {
    set_tensor(matched.target, read_tensor(file, *matched.source),
               file.path().string() + ": tensor " + matched.source->name, report);
    const bool shares_the_file = matched.target.is_cpu() && matched.target.data_ptr() == matched.source->data;
    if (!shares_the_file) file.drop_pages(*matched.source);
  }
  return report;
}

LoadReport load_strict(torch::nn::Module& module, const std::map<std::string, torch::Tensor>& tensors,
                       const std::string& where, const WeightSelection& selection) {
  const torch::NoGradGuard no_grad;
  Offers offers;
  for (const auto& [full, tensor] : tensors) {
    const auto name = module_name(full, selection);
    if (!name) continue;
    add_offer(
        *name,
        {file_dtype(tensor.scalar_type(), fmt::format("{}: tensor {}", where, full)), tensor.sizes().vec()},
        full, where, offers);
  }
  const auto targets = named_tensors(module);
  LoadReport report;
  check_offers(targets, offers, where, selection, report);
  for (const auto& [name, target] : targets) {
    const std::string full = file_name(name, selection);
    set_tensor(target, tensors.at(full), fmt::format("{}: tensor {}", where, full), report);
  }
  return report;
}

std::map<std::string, torch::Tensor> named_tensors(const torch::nn::Module& module) {
  std::map<std::string, torch::Tensor> tensors;
  for (const auto& item : module.named_parameters(/*recurse=*/true))
    tensors.emplace(item.key(), item.value());
  for (const auto& item : module.named_buffers(/*recurse=*/true)) tensors.emplace(item.key(), item.value());
  return tensors;
}

}  // namespace gld
