#include "tests/support/meta_device.h"

#include <atomic>
#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <ATen/core/dispatch/Dispatcher.h>
#include <ATen/core/stack.h>
#include <torch/library.h>
#include <torch/types.h>

namespace gld::test {
namespace {

std::atomic<int64_t> reads{0};

// The CPU's tensors in the place of an operator's arguments, and of which each stands.
class OnHost {
 public:
  c10::IValue value(const c10::IValue& argument) {
    if (argument.isTensor()) return ones(argument.toTensor());
    if (argument.isDevice()) return c10::IValue(c10::Device(c10::kCPU));
    if (!argument.isList() || argument.isIntList() || argument.isDoubleList() || argument.isBoolList()) {
      return argument;
    }
    auto list = argument.toList().copy();
    for (size_t i = 0; i < list.size(); ++i) list.set(i, value(list.get(i)));
    return list;
  }

  // Returns what the device has instead of a result: the argument that was written to, or a new shape.
  c10::IValue on_device(const c10::IValue& result) const {
    if (result.isTensorList()) {
      auto list = result.toTensorList().copy();
      for (size_t i = 0; i < list.size(); ++i) list.set(i, shape_of(list.get(i)));
      return list;
    }
    return result.isTensor() ? c10::IValue(shape_of(result.toTensor())) : result;
  }

 private:
  torch::Tensor ones(const torch::Tensor& tensor) {
    if (!tensor.defined() || (!tensor.is_meta() && tensor.dim() == 0))
      return tensor;  // a number is taken everywhere
    TORCH_CHECK(tensor.is_meta(), "a tensor of shape ", tensor.sizes(), " was left on ", tensor.device());
    auto made = torch::ones(tensor.sizes(), torch::dtype(tensor.scalar_type()));
    stand_for_.emplace_back(made, tensor);
    return made;
  }

  torch::Tensor shape_of(const torch::Tensor& result) const {
    if (!result.defined()) return result;
    for (const auto& [made, tensor] : stand_for_) {
      if (!made.is_same(result)) continue;
      if (tensor.sizes() != result.sizes()) tensor.resize_(result.sizes());
      return tensor;
    }
    return torch::empty(result.sizes(), torch::dtype(result.scalar_type()).device(torch::kMeta));
  }

  std::vector<std::pair<torch::Tensor, torch::Tensor>> stand_for_;
};

// Returns whether the host has to wait for what the operator finds: a shape that depends on numbers, or a number.
bool waits(const c10::OperatorHandle& operation) {
  static const std::set<std::string> kNames = {"aten::nonzero", "aten::masked_select", "aten::_unique2",
                                               "aten::equal"};
  return kNames.count(operation.schema().name()) > 0;
}

// Makes the shapes that the CPU's operator of that name makes of ones.
void shapes_of_cpu(const c10::OperatorHandle& like, torch::jit::Stack* stack) {
  OnHost host;
  if (waits(like)) ++reads;
  const size_t arguments = like.schema().arguments().size(), results = like.schema().returns().size();
  for (size_t i = stack->size() - arguments; i < stack->size(); ++i) (*stack)[i] = host.value((*stack)[i]);
  like.callBoxed(stack);
  for (size_t i = stack->size() - results; i < stack->size(); ++i) (*stack)[i] = host.on_device((*stack)[i]);
}

// Convolutions of a device that LibTorch does not know go by names of their own, with the arguments in the same order.
void convolution_shapes(const c10::OperatorHandle& /*of*/, torch::jit::Stack* stack) {
  shapes_of_cpu(c10::Dispatcher::singleton().findSchemaOrThrow("aten::convolution", ""), stack);
}

void convolution_backward_shapes(const c10::OperatorHandle& /*of*/, torch::jit::Stack* stack) {
  // convolution_backward takes the sizes of a bias, or nothing, behind the weight.
  const size_t first = stack->size() - 10;
  const bool bias = (*stack)[first + 9].toBoolList().get(2);
  const auto channels = (*stack)[first].toTensor().size(1);
  stack->insert(stack->begin() + static_cast<std::ptrdiff_t>(first) + 3,
                bias ? c10::IValue(std::vector<int64_t>{channels}) : c10::IValue());
  shapes_of_cpu(c10::Dispatcher::singleton().findSchemaOrThrow("aten::convolution_backward", ""), stack);
}

// A read of the host: what the numbers would be is not known, so all of them are 1.
void copied(const c10::OperatorHandle& /*of*/, torch::jit::Stack* stack) {
  const auto to = (*stack)[stack->size() - 3].toTensor(), from = (*stack)[stack->size() - 2].toTensor();
  torch::jit::drop(*stack, 3);
  from.expand(to.sizes());  // an error where the shapes do not fit
  if (!to.is_meta()) {
    to.fill_(1);
    ++reads;
  }
  stack->emplace_back(to);
}

void number_read(const c10::OperatorHandle& /*of*/, torch::jit::Stack* stack) {
  const auto type = torch::jit::pop(*stack).toTensor().scalar_type();
  ++reads;
  if (type == torch::kBool) {
    stack->emplace_back(at::Scalar(true));
  } else if (c10::isIntegralType(type, /*includeBool=*/false)) {
    stack->emplace_back(at::Scalar(int64_t{1}));
  } else {
    stack->emplace_back(at::Scalar(1.0));
  }
}

// Their kernels for the device take tensors of the CPU without a word, which those of a GPU refuse. LibTorch
// warns that they are replaced.
bool takes_any_device(const std::string& name) {
  static const std::set<std::string> kNames = {"aten::cat", "aten::mm", "aten::addmm", "aten::bmm",
                                               "aten::baddbmm"};
  return kNames.count(name) > 0;
}

bool has_kernel(const c10::OperatorHandle& of) {
  for (const auto key : {c10::DispatchKey::Meta, c10::DispatchKey::CompositeExplicitAutograd,
                         c10::DispatchKey::CompositeExplicitAutogradNonFunctional,
                         c10::DispatchKey::CompositeImplicitAutograd}) {
    if (of.hasKernelForDispatchKey(key)) return true;
  }
  return !of.hasKernelForDispatchKey(c10::DispatchKey::CPU);
}

TORCH_LIBRARY_IMPL(aten, Meta, library) {
  library.impl("copy_", torch::CppFunction::makeFromBoxedFunction<&copied>());
  library.impl("_local_scalar_dense", torch::CppFunction::makeFromBoxedFunction<&number_read>());
  library.impl("convolution_overrideable", torch::CppFunction::makeFromBoxedFunction<&convolution_shapes>());
  library.impl("convolution_backward_overrideable",
               torch::CppFunction::makeFromBoxedFunction<&convolution_backward_shapes>());
  for (const auto& name : c10::Dispatcher::singleton().getAllOpNames()) {
    if (name.name.rfind("aten::", 0) != 0) continue;
    const auto found = c10::Dispatcher::singleton().findSchema(name);
    if (!found || (has_kernel(*found) && !takes_any_device(name.name))) continue;
    const std::string full = name.overload_name.empty() ? name.name : name.name + "." + name.overload_name;
    library.impl(full.c_str(), torch::CppFunction::makeFromBoxedFunction<&shapes_of_cpu>());
  }
}

}  // namespace

int64_t meta_reads() { return reads; }

}  // namespace gld::test
