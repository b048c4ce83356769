#include "gld/machine/precision_option.h"

#include "gld/base/error.h"

namespace gld {

void visit_precision(FieldVisitor& visitor, PrecisionChoice& choice) {
  auto names = compute_precision_names();
  names.emplace_back("automatic");
  visit_choice(
      visitor,
      {"precision",
       "what models multiply in; automatic: the fastest whose measured error is small enough; on a GPU float32 or "
       "bfloat16"},
      choice, names);
}

ComputePrecision precision_of(PrecisionChoice choice) {
  switch (choice) {
    case PrecisionChoice::kFloat32:
      return ComputePrecision::kFloat32;
    case PrecisionChoice::kBFloat16:
      return ComputePrecision::kBFloat16;
    case PrecisionChoice::kInt8:
      return ComputePrecision::kInt8;
    case PrecisionChoice::kAutomatic:
      break;
  }
  fail({"--precision", "a precision here", "'automatic'", "name one"});
}

void check_precision_on(const std::string& device, ComputePrecision precision) {
  if (device == "cpu" || precision == ComputePrecision::kFloat32 || precision == ComputePrecision::kBFloat16)
    return;
  fail({"--precision", "float32 or bfloat16 on the device " + device, compute_precision_name(precision),
        "use --device cpu, which has kernels for it"});
}

std::string precision_text(ComputePrecision precision, const std::string& device) {
  if (precision == ComputePrecision::kFloat32) return compute_precision_name(precision);
  if (device != "cpu") return compute_precision_name(precision) + " on " + device;
  return compute_precision_name(precision) + " on " +
         matrix_unit_name(best_matrix_unit(precision), precision);
}

}  // namespace gld
