#include "gld/tensors/device.h"

#include "gld/base/error.h"
#include "gld/machine/processor_name.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <array>
#include <cstdint>

#include <ATen/Context.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/cuda.h>

#include <dlfcn.h>

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

std::string device_name(const torch::Device& device) {
  if (device.is_cpu()) return processor_name();
  // The driver's own function, which needs neither CUDA's headers nor its runtime; a LibTorch with CUDA has loaded it.
  using GetDevice = int (*)(int*, int);
  using GetName = int (*)(char*, int, int);
  std::array<char, 256> name{};
  int handle = 0;
  void* driver = ::dlopen("libcuda.so.1", RTLD_LAZY);
  if (driver == nullptr) return device.str();
  const auto get_device = reinterpret_cast<GetDevice>(::dlsym(driver, "cuDeviceGet"));
  const auto get_name = reinterpret_cast<GetName>(::dlsym(driver, "cuDeviceGetName"));
  const bool known = get_device != nullptr && get_name != nullptr &&
                     get_device(&handle, std::max<int>(0, device.index())) == 0 &&
                     get_name(name.data(), static_cast<int>(name.size()) - 1, handle) == 0;
  return known ? name.data() : device.str();
}

void finish_queued_work(const torch::Device& device) {
  if (device.is_cuda()) torch::cuda::synchronize(device.index());
}

void record_device(StageRecords& stages, const torch::Device& device) {
  if (!device.is_cuda()) return;
  stages.set_device({[device] { reset_most_used_device_bytes(device); },
                     [device] {
                       finish_queued_work(device);
                       return most_used_device_bytes(device);
                     }});
}

}  // namespace gld
