#include "cli/verify_command.h"

#include "gld/base/command_options.h"
#include "gld/base/json_text.h"
#include "gld/machine/precision_option.h"
#include "gld/tensors/device.h"
#include "verify/reference_runners.h"
#include "verify/verification.h"

#include <algorithm>
#include <iostream>
#include <memory>

namespace gld {
namespace {

struct VerifyOptions : OptionsGroup {
  bool json = false;
  std::string device = "cpu";
  ComputePrecision precision = ComputePrecision::kFloat32;
  void visit(FieldVisitor& visitor) override {
    visit_json(visitor, json);
    visit_device(visitor, device);
    visit_choice(
        visitor,
        {"precision",
         "what models multiply in: the deviation from the reference in it. bfloat16 passes at 0.05 and int8 at "
         "0.1 of the largest value"},
        precision, compute_precision_names());
  }
};

int verify(const std::vector<std::string>& folders, const VerifyOptions& options) {
  check_precision_on(options.device, options.precision);
  const CaseCompute compute{options.precision, device_from_text(options.device)};
  const auto runners = reference_runners();
  std::vector<CaseVerification> results;
  for (const auto& folder : folders) {
    results.push_back(verify_case(folder, runners, compute));
    if (!options.json) std::cout << case_text(results.back()) << std::flush;
  }
  std::cout << (options.json ? json_text(verification_json(results, compute), 2) + "\n"
                             : summary_text(results, compute));
  const bool passed =
      std::all_of(results.begin(), results.end(), [](const auto& result) { return result.passed(); });
  return passed ? 0 : 1;
}

}  // namespace

Command make_verify_command() {
  auto options = std::make_shared<VerifyOptions>();
  Command command;
  command.name = "verify";
  command.summary = "Compare this program with reference tensors";
  command.description =
      "Each DIR holds case.json, inputs.safetensors, outputs.safetensors and, where the case has weights, "
      "weights.safetensors. The module is built from case.json's configuration, "
      "and every output tensor passes where max|a - b| <= relative_tolerance * max(1, max|b|). "
      "The exit status is 0 only when all cases pass.";
  command.arguments = {"DIR...", 1, 1000000};
  command.options = options;
  command.run = [options](const std::vector<std::string>& folders) { return verify(folders, *options); };
  return command;
}

}  // namespace gld
