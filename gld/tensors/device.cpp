#include "gld/tensors/device.h"

#include "gld/base/error.h"
#include "gld/tensors/torch_version.h"

#include <cstdint>

#include <ATen/Context.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/cuda.h>

namespace gld {

bool reads_meta_device() {
  const auto read = c10::Dispatcher::singleton().findSchema({"aten::_local_scalar_dense", ""});
  return read && read->hasKernelForDispatchKey(c10::DispatchKey::Meta);
}

torch::Device device_from_text(const std::string& text) {
  if (text == "meta" && reads_meta_device()) return torch::kMeta;
  const bool cuda = text == "cuda" || text.rfind("cuda:", 0) == 0;
  const std::string number = text.rfind("cuda:", 0) == 0 ? text.substr(5) : "0";
  const bool plain_number =
      !number.empty() && number.size() < 4 && number.find_first_not_of("0123456789") == std::string::npos;
  if (text != "cpu" && !(cuda && plain_number)) {
    fail({"--device", "cpu, cuda or cuda:N", "'" + text + "'", "write for example --device cpu"});
  }
  if (!cuda) return torch::kCPU;
  const auto available = static_cast<int64_t>(torch::cuda::device_count());
  if (std::stoll(number) >= available) {
    fail({"--device", "one of the " + std::to_string(available) + " CUDA devices that this LibTorch sees",
          "'" + text + "'", available == 0 ? "use --device cpu" : "choose a smaller number"});
  }
  sum_gpu_products_in_float32();
  return {torch::kCUDA, static_cast<c10::DeviceIndex>(std::stoi(number))};
}

}  // namespace gld
