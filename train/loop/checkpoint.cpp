#include "train/loop/checkpoint.h"

#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <cstdio>
#include <cstring>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr const char* kFormat = "gld training checkpoint 1";

// A 64-bit multiply-xor hash over the bytes of all tensors in name order. A file whose blocks never reached
// the disk reads as zeros, which the file's length alone does not show.
class Checksum {
 public:
  void add(const torch::Tensor& tensor) {
    const torch::Tensor bytes = tensor.detach().to(torch::kCPU).contiguous();
    const auto* data = static_cast<const uint8_t*>(bytes.data_ptr());
    size_t left = static_cast<size_t>(bytes.numel()) * bytes.element_size();
    while (left > 0) {
      uint64_t word = 0;
      const size_t take = std::min<size_t>(left, sizeof(word));
      std::memcpy(&word, data, take);
      hash_ = (hash_ ^ word) * 0x9E3779B97F4A7C15ULL;
      hash_ ^= hash_ >> 29U;
      data += take;
      left -= take;
    }
  }
  std::string text() const {
    char buffer[17];
    std::snprintf(buffer, sizeof(buffer), "%016llx", static_cast<unsigned long long>(hash_));
    return buffer;
  }

 private:
  uint64_t hash_ = 0xCBF29CE484222325ULL;
};

std::string checksum_of(const std::map<std::string, torch::Tensor>& tensors) {
  Checksum checksum;
  for (const auto& item : tensors) checksum.add(item.second);
  return checksum.text();
}

}  // namespace

void save_checkpoint(const std::filesystem::path& file, const Checkpoint& checkpoint) {
  save_safetensors(file, checkpoint.tensors,
                   {{"format", kFormat},
                    {"step", std::to_string(checkpoint.step)},
                    {"checksum", checksum_of(checkpoint.tensors)},
                    {"state", checkpoint.metadata.dump()}});
}

Checkpoint load_checkpoint(const std::filesystem::path& file) {
  const auto weights = WeightFile::open(file);
  const auto& metadata = weights->metadata();
  const auto format = metadata.find("format");
  if (format == metadata.end() || format->second != kFormat) {
    fail({file.string(), "a training checkpoint", "a weight file of another kind",
          "name the checkpoints folder of a gld train run"});
  }
  Checkpoint checkpoint;
  try {
    checkpoint.step = std::stoll(metadata.at("step"));
    checkpoint.metadata = nlohmann::json::parse(metadata.at("state"));
  } catch (const std::exception&) {
    fail({file.string(), "the run's state in the metadata", "text that cannot be read",
          "use an older checkpoint"});
  }
  for (const TensorEntry& entry : weights->entries()) {
    checkpoint.tensors[entry.name] = read_tensor(*weights, entry);
  }
  const auto checksum = metadata.find("checksum");
  if (checksum == metadata.end() || checksum->second != checksum_of(checkpoint.tensors)) {
    fail({file.string(), "tensors that match the checksum", "changed or missing data",
          "use an older checkpoint"});
  }
  return checkpoint;
}

CheckpointFolder::CheckpointFolder(std::filesystem::path folder, const CheckpointFolderOptions& options)
    : folder_(std::move(folder)), options_(options) {}

std::filesystem::path CheckpointFolder::file_of(int64_t step) const {
  char name[40];
  std::snprintf(name, sizeof(name), "step_%09lld.safetensors", static_cast<long long>(step));
  return folder_ / name;
}

std::vector<int64_t> CheckpointFolder::steps() const {
  std::vector<int64_t> steps;
  std::error_code none;
  for (const auto& item : std::filesystem::directory_iterator(folder_, none)) {
    const std::string name = item.path().filename().string();
    long long step = 0;
    int end = 0;
    if (std::sscanf(name.c_str(), "step_%lld.safetensors%n", &step, &end) == 1 &&
        end == static_cast<int>(name.size())) {
      steps.push_back(step);
    }
  }
  std::sort(steps.begin(), steps.end());
  return steps;
}

std::filesystem::path CheckpointFolder::save(const Checkpoint& checkpoint) const {
  std::filesystem::create_directories(folder_);
  const auto file = file_of(checkpoint.step);
  save_checkpoint(file, checkpoint);
  auto present = steps();
  const auto keep = static_cast<size_t>(std::max<int64_t>(options_.keep_last, 1));
  for (size_t i = 0; i + keep < present.size(); ++i) {
    std::error_code ignored;
    std::filesystem::remove(file_of(present[i]), ignored);
  }
  return file;
}

std::filesystem::path CheckpointFolder::save_best(const Checkpoint& checkpoint) const {
  std::filesystem::create_directories(folder_);
  const auto file = folder_ / "best.safetensors";
  save_checkpoint(file, checkpoint);
  return file;
}

std::optional<CheckpointFolder::Resumable> CheckpointFolder::newest() const {
  const auto present = steps();
  if (present.empty()) return std::nullopt;
  Resumable result;
  for (auto step = present.rbegin(); step != present.rend(); ++step) {
    try {
      result.file = file_of(*step);
      result.checkpoint = load_checkpoint(result.file);
      return result;
    } catch (const Error& error) {
      result.damaged.emplace_back(error.what());
    }
  }
  fail({folder_.string(), "a complete checkpoint", "only damaged ones (" + result.damaged.front() + ")",
        "start again without --resume"});
}

}  // namespace gld
