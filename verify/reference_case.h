#pragma once

#include "gld/base/options.h"
#include "gld/files/weight_file.h"
#include "models/layers/layer_precision.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

using NamedTensors = std::map<std::string, torch::Tensor>;

// What modules of a case compute in, and where.
struct CaseCompute {
  ComputePrecision precision = ComputePrecision::kFloat32;
  torch::Device device = torch::kCPU;
};

// A reference case is a folder with case.json (kind, config, relative_tolerance, note), inputs.safetensors,
// outputs.safetensors and, where the case has weights, weights.safetensors. What the published implementation computed
// from the inputs with those weights stands in the outputs.
// Moving the JSON value is noexcept, but its destructor's checks look like throwing code.
// NOLINTNEXTLINE(bugprone-exception-escape)
struct ReferenceCase {
  std::filesystem::path folder;
  std::string kind;
  nlohmann::json config;  // the "config" object; see read_config
  double relative_tolerance = 0;
  std::string note;
  NamedTensors inputs;
  NamedTensors expected;
  std::shared_ptr<const WeightFile> weights;  // null when the case has none
  CaseCompute compute;                        // of the modules that runners build
  // Set by apply_precision where it found layers; what has none runs in float32 and is held to its tolerance.
  std::shared_ptr<bool> precision_applied = std::make_shared<bool>(false);

  std::string name() const { return folder.filename().string(); }
  // For the where of a message about case.json's configuration.
  std::string config_place() const { return (folder / "case.json").string() + ": config"; }
  // Reads the configuration into options and checks them. A key that options do not have is an Error.
  void read_config(OptionsGroup& options) const;

  // Returns the input of that name; floating-point numbers as float32, integers as they are. Throws Error when the case
  // has none, or when its shape does not match: -1 accepts any size.
  torch::Tensor input(const std::string& input_name, const std::vector<int64_t>& shape) const;
  // Returns the same on the case's device, for a module; cameras stay where they are read.
  torch::Tensor module_input(const std::string& input_name, const std::vector<int64_t>& shape) const;
  // Returns where runners build modules.
  ParameterPlacement placement() const;
  // Returns an input that holds one integer.
  int64_t integer_input(const std::string& input_name) const;
  // Returns the weights. Throws Error when the case has none.
  const WeightFile& weight_file() const;
  // Returns whether the case has an expected output of that name, or one that starts with prefix: a runner computes
  // only what is compared.
  bool expects(const std::string& output_name) const { return expected.count(output_name) > 0; }
  bool expects_prefix(const std::string& prefix) const;
  // Lets a loaded module compute in the case's precision; in float32 it stays as it was.
  void apply_precision(torch::nn::Module& module, ModelKind kind) const;
};

// Reads a case; throws one sentence for each way in which the folder can be wrong.
ReferenceCase read_reference_case(const std::filesystem::path& folder);

// Builds the modules of one kind of case from its configuration, loads its weights, and computes its outputs
// under the names and in the layouts of outputs.safetensors. Outputs beyond the expected ones are not
// compared.
using ReferenceRunner = std::function<NamedTensors(const ReferenceCase&)>;

// Kinds of cases and what computes them. The caller puts the table together, so that kinds whose code lies in
// another layer (training) can be added.
using ReferenceRunners = std::map<std::string, ReferenceRunner>;

}  // namespace gld
