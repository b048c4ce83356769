#include "verify/reference_case.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"
#include "gld/tensors/weight_tensors.h"

#include <cmath>
#include <fstream>
#include <sstream>

namespace gld {
namespace {

nlohmann::json read_description(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) {
    fail({file.string(), "a reference case's description", "no readable file",
          "give a folder with case.json, inputs.safetensors and outputs.safetensors"});
  }
  std::stringstream text;
  text << stream.rdbuf();
  return parse_json(text.str(), file.string());
}

NamedTensors read_tensors(const std::filesystem::path& file) {
  auto tensors = read_all(file);
  if (tensors.empty()) fail({file.string(), "at least one tensor", "none", "write the case again"});
  return tensors;
}

bool shape_matches(const torch::Tensor& tensor, const std::vector<int64_t>& shape) {
  if (tensor.dim() != static_cast<int64_t>(shape.size())) return false;
  for (size_t i = 0; i < shape.size(); ++i) {
    if (shape[i] >= 0 && shape[i] != tensor.size(static_cast<int64_t>(i))) return false;
  }
  return true;
}

std::string shape_pattern(const std::vector<int64_t>& shape) {
  std::string text = "[";
  for (size_t i = 0; i < shape.size(); ++i) {
    text += (i == 0 ? "" : ", ") + (shape[i] < 0 ? std::string("any") : std::to_string(shape[i]));
  }
  return text + "]";
}

}  // namespace

void ReferenceCase::read_config(OptionsGroup& options) const {
  load_json(options, config, config_place());
  check_options(options, config_place());
}

torch::Tensor ReferenceCase::input(const std::string& input_name, const std::vector<int64_t>& shape) const {
  const auto file = (folder / "inputs.safetensors").string();
  const auto found = inputs.find(input_name);
  if (found == inputs.end()) {
    fail({file, "the input " + input_name, "no tensor of that name",
          "write the inputs that kind " + kind + " needs"});
  }
  if (!shape_matches(found->second, shape)) {
    fail({file + ": " + input_name, "shape " + shape_pattern(shape), c10::str(found->second.sizes()),
          "make the inputs agree with case.json's configuration"});
  }
  return found->second.is_floating_point() ? found->second.to(torch::kFloat32) : found->second;
}

torch::Tensor ReferenceCase::module_input(const std::string& input_name,
                                          const std::vector<int64_t>& shape) const {
  return input(input_name, shape).to(compute.device);
}

ParameterPlacement ReferenceCase::placement() const {
  ParameterPlacement placement;
  placement.device = compute.device;
  return placement;
}

int64_t ReferenceCase::integer_input(const std::string& input_name) const {
  return input(input_name, {1}).to(torch::kInt64).item<int64_t>();
}

const WeightFile& ReferenceCase::weight_file() const {
  if (!weights) {
    fail({folder.string(), "weights.safetensors", "no such file", "kind " + kind + " needs weights"});
  }
  return *weights;
}

bool ReferenceCase::expects_prefix(const std::string& prefix) const {
  const auto next = expected.lower_bound(prefix);
  return next != expected.end() && next->first.compare(0, prefix.size(), prefix) == 0;
}

void ReferenceCase::apply_precision(torch::nn::Module& module, ModelKind kind) const {
  if (compute.precision == ComputePrecision::kFloat32) return;
  use_precision(module, layer_precision(compute.precision, kind));
  for (const auto& part : module.modules(/*include_self=*/false)) {
    if (dynamic_cast<const PrecisionLayer*>(part.get()) != nullptr) *precision_applied = true;
  }
}

ReferenceCase read_reference_case(const std::filesystem::path& folder) {
  if (!std::filesystem::is_directory(folder)) {
    fail({folder.string(), "a folder with a reference case",
          std::filesystem::exists(folder) ? "a file" : "no such folder",
          "give the folder that holds case.json"});
  }
  ReferenceCase reference;
  // "goldens/camera/" names the case "camera".
  reference.folder = folder.has_filename() ? folder : folder.parent_path();
  const auto file = folder / "case.json";
  const auto description = read_description(file);
  const auto require = [&](const char* key, const char* what, bool (*holds)(const nlohmann::json&)) {
    const bool present = description.is_object() && description.contains(key);
    if (!present || !holds(description.at(key))) {
      fail({file.string() + ": " + key, what,
            present ? printable_text(json_text(description.at(key)), 60) : std::string("nothing"),
            "repair the case's description"});
    }
    return description.at(key);
  };
  reference.kind = require("kind", "the name of a kind of case", [](const nlohmann::json& value) {
                     return value.is_string();
                   }).get<std::string>();
  reference.config = require("config", "an object with the configuration",
                             [](const nlohmann::json& value) { return value.is_object(); });
  reference.relative_tolerance =
      require("relative_tolerance", "a positive number", [](const nlohmann::json& value) {
        return value.is_number() && value.get<double>() > 0 && std::isfinite(value.get<double>());
      }).get<double>();
  if (description.contains("note") && description.at("note").is_string()) {
    reference.note = description.at("note").get<std::string>();
  }
  reference.inputs = read_tensors(folder / "inputs.safetensors");
  reference.expected = read_tensors(folder / "outputs.safetensors");
  const auto weights = folder / "weights.safetensors";
  if (std::filesystem::exists(weights)) reference.weights = WeightFile::open(weights);
  return reference;
}

}  // namespace gld
