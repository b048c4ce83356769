#pragma once

#include "gld/files/weight_file.h"

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// A tensor of the file that the module deliberately does not use.
struct IgnoredName {
  std::string name;  // without the prefix; a final '*' matches any ending
  std::string reason;
};

// Returns the entry that covers the name, or null.
const IgnoredName* ignored_name(const std::vector<IgnoredName>& ignored, const std::string& name);

struct WeightSelection {
  // Only tensors whose names start with it are considered, and it is removed: "ema.",
  // "model.backbone.pretrained.".
  std::string prefix;
  std::vector<IgnoredName> ignored;
  // These parts of the module stand elsewhere in the file, {beginning there, beginning in the module}: names with such
  // a beginning are considered as well.
  std::vector<std::pair<std::string, std::string>> elsewhere = {};
};

struct LoadReport {
  int64_t tensors = 0;     // parameters and buffers set
  int64_t parameters = 0;  // elements set
  int64_t shared = 0;      // tensors that use the given memory without a copy
  int64_t converted = 0;   // tensors whose dtype changed
  std::vector<std::string> ignored;
};

// Sets every parameter and buffer of the module by name. A tensor that is missing, has another shape, cannot
// be converted, or is left over and not listed as ignored is an Error naming it. Floating-point tensors take
// the module's dtype; where it is the file's already, the parameter uses the file's memory
// (gld/tensors/weight_tensors.h); of other tensors that memory is given back, and with it what a module that shares it
// has written there: open the file again for another module. The module's dtype, device and requires_grad stay as they
// are.
LoadReport load_strict(torch::nn::Module& module, const WeightFile& file,
                       const WeightSelection& selection = {});
// Does the same with tensors in memory; `where` names them in errors. Parameters share them where no conversion is
// needed.
LoadReport load_strict(torch::nn::Module& module, const std::map<std::string, torch::Tensor>& tensors,
                       const std::string& where, const WeightSelection& selection = {});

// A tensor of the module and the file's tensor for it.
struct MatchedTensor {
  std::string name;  // the module's
  torch::Tensor target;
  const TensorEntry* source = nullptr;
};

// Does the checks of load_strict without loading: returns every tensor of the module with its counterpart. The module
// may be on the meta device.
std::vector<MatchedTensor> match_strict(const torch::nn::Module& module, const WeightFile& file,
                                        const WeightSelection& selection, LoadReport& report);

// Returns parameters and buffers by full name; they share the module's memory. It is what save_safetensors takes.
std::map<std::string, torch::Tensor> named_tensors(const torch::nn::Module& module);

}  // namespace gld
