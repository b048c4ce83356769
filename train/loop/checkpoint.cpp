#include "train/loop/checkpoint.h"

#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <cstring>

#include <torch/autograd.h>

namespace gld {
namespace {

// Format 1 had a checksum over the tensors' bytes alone.
constexpr const char* kFormat = "gld training checkpoint 2";
constexpr const char* kFirstFormat = "gld training checkpoint 1";
const std::string kChecksumKey = "checksum";

// A 64-bit multiply-xor hash. A file whose blocks never reached the disk reads as zeros, which the file's length alone
// does not show; nor does it show a flipped bit or a number changed by hand.
class Checksum {
 public:
  void add(const void* bytes, size_t left) {
    const auto* data = static_cast<const uint8_t*>(bytes);
    while (left > 0) {
      uint64_t word = 0;
      const size_t take = std::min<size_t>(left, sizeof(word));
      std::memcpy(&word, data, take);
      add(word);
      data += take;
      left -= take;
    }
  }
  void add(uint64_t word) {
    hash_ = (hash_ ^ word) * 0x9E3779B97F4A7C15ULL;
    hash_ ^= hash_ >> 29U;
  }
  // A text is added with its length, so that a character cannot move from one text to the next.
  void add(const std::string& text) {
    add(static_cast<uint64_t>(text.size()));
    add(text.data(), text.size());
  }
  void add_bytes(const torch::Tensor& tensor) {
    const torch::Tensor bytes = tensor.detach().to(torch::kCPU).contiguous();
    add(bytes.data_ptr(), static_cast<size_t>(bytes.numel()) * bytes.element_size());
  }
  std::string text() const {
    char buffer[17];
    std::snprintf(buffer, sizeof(buffer), "%016llx", static_cast<unsigned long long>(hash_));
    return buffer;
  }

 private:
  uint64_t hash_ = 0xCBF29CE484222325ULL;
};

std::string checksum_of_bytes(const std::map<std::string, torch::Tensor>& tensors) {
  Checksum checksum;
  for (const auto& item : tensors) checksum.add_bytes(item.second);
  return checksum.text();
}

std::string checksum_of(const std::map<std::string, torch::Tensor>& tensors,
                        const std::map<std::string, std::string>& metadata) {
  Checksum checksum;
  for (const auto& [name, text] : metadata) {
    if (name == kChecksumKey) continue;
    checksum.add(name);
    checksum.add(text);
  }
  for (const auto& [name, tensor] : tensors) {
    checksum.add(name);
    checksum.add(std::string(c10::toString(tensor.scalar_type())));
    for (const int64_t size : tensor.sizes()) checksum.add(static_cast<uint64_t>(size));
    checksum.add_bytes(tensor);
  }
  return checksum.text();
}

}  // namespace

void save_checkpoint(const std::filesystem::path& file, const Checkpoint& checkpoint) {
  std::map<std::string, std::string> metadata = {{"format", kFormat},
                                                 {"step", std::to_string(checkpoint.step)},
                                                 {"state", json_text(checkpoint.metadata)}};
  metadata[kChecksumKey] = checksum_of(checkpoint.tensors, metadata);
  save_safetensors(file, checkpoint.tensors, metadata);
}

Checkpoint load_checkpoint(const std::filesystem::path& file) {
  const auto weights = WeightFile::open(file);
  const auto& metadata = weights->metadata();
  const auto text_of = [&](const std::string& key) {
    const auto found = metadata.find(key);
    return found == metadata.end() ? std::string() : found->second;
  };
  const std::string format = text_of("format");
  if (format != kFormat && format != kFirstFormat) {
    fail({file.string(), "a training checkpoint", "a weight file of another kind",
          "name the checkpoints folder of a gld train run"});
  }
  Checkpoint checkpoint;
  checkpoint.header_is_checked = format == kFormat;
  for (const TensorEntry& entry : weights->entries()) {
    checkpoint.tensors[entry.name] = read_tensor(*weights, entry);
  }
  const std::string expected = checkpoint.header_is_checked ? checksum_of(checkpoint.tensors, metadata)
                                                            : checksum_of_bytes(checkpoint.tensors);
  if (text_of(kChecksumKey) != expected) {
    fail({file.string(), "contents that match the checksum", "changed or missing data",
          "use an older checkpoint"});
  }
  const std::string step = text_of("step");
  const auto parsed = std::from_chars(step.data(), step.data() + step.size(), checkpoint.step);
  if (parsed.ec != std::errc() || parsed.ptr != step.data() + step.size() || checkpoint.step < 0) {
    fail({file.string(), "the run's step in the metadata", "'" + step + "'", "use an older checkpoint"});
  }
  checkpoint.metadata = parse_json(text_of("state"), file.string() + ", state");
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
  auto file = file_of(checkpoint.step);
  save_checkpoint(file, checkpoint);
  auto present = steps();
  // A later one that was damaged, and passed over, is nobody's to count.
  present.erase(std::upper_bound(present.begin(), present.end(), checkpoint.step), present.end());
  const auto keep = static_cast<size_t>(std::max<int64_t>(options_.keep_last, 1));
  for (size_t i = 0; i + keep < present.size(); ++i) {
    std::error_code ignored;
    std::filesystem::remove(file_of(present[i]), ignored);
  }
  return file;
}

std::filesystem::path CheckpointFolder::save_best(const Checkpoint& checkpoint) const {
  std::filesystem::create_directories(folder_);
  auto file = folder_ / "best.safetensors";
  save_checkpoint(file, checkpoint);
  return file;
}

std::optional<CheckpointFolder::Resumable> CheckpointFolder::newest(const Check& check) const {
  const auto present = steps();
  if (present.empty()) return std::nullopt;
  Resumable result;
  for (auto step = present.rbegin(); step != present.rend(); ++step) {
    bool sound = false;  // the file is what was written
    try {
      result.file = file_of(*step);
      result.checkpoint = load_checkpoint(result.file);
      sound = result.checkpoint.header_is_checked;
      if (check) check(result.checkpoint, result.file.string());
      return result;
    } catch (const Error& error) {
      if (sound) throw;
      result.damaged.emplace_back(error.what());
    }
  }
  fail({folder_.string(), "a complete checkpoint", "only damaged ones (" + result.damaged.front() + ")",
        "start again without --resume"});
}

}  // namespace gld
