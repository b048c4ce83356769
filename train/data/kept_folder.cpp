#include "train/data/kept_folder.h"

#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/tensors/weight_tensors.h"

#include <cstdint>
#include <exception>
#include <iostream>

#include <fmt/format.h>

namespace gld {
namespace {

// A safetensors file without a tensor is none.
constexpr const char* kNothing = "nothing";
// Bytes that are left to checkpoints and whatever else there is.
constexpr uintmax_t kSpaceForOthers = uintmax_t{4} << 30;

const std::string& this_executable() {
  static const std::string hash = sha256_of_file("/proc/self/exe");
  return hash;
}

}  // namespace

KeptFolder::KeptFolder(const std::filesystem::path& folder, const std::string& made_of)
    : folder_(folder), made_of_("gld kept scene 1\n" + this_executable() + '\n' + made_of + '\n') {
  std::error_code error;
  const bool taken =
      std::filesystem::exists(folder_, error) && !std::filesystem::is_directory(folder_, error);
  if (!taken) std::filesystem::create_directories(folder_, error);
  if (taken || error) {
    fail({"--kept-scenes " + folder_.string(), "a folder that can be written",
          taken ? "a file of that name" : error.message(), "choose another"});
  }
}

std::filesystem::path KeptFolder::file_of(const std::string& key) const {
  Sha256 hash;
  hash.update(made_of_);
  hash.update(key);
  const std::string digits = hash.hex_digest();
  return folder_ / digits.substr(0, 2) / (digits.substr(2) + ".safetensors");
}

std::optional<KeptThing> KeptFolder::find(const std::string& key) const {
  const auto file = file_of(key);
  std::error_code unreadable;
  if (!std::filesystem::is_regular_file(file, unreadable)) return std::nullopt;
  try {
    const auto opened = WeightFile::open(file);
    KeptThing thing;
    thing.text = opened->metadata();
    for (const TensorEntry& entry : opened->entries()) {
      if (entry.name != kNothing) thing.tensors[entry.name] = read_tensor(*opened, entry);
    }
    return thing;
  } catch (const std::exception&) {
    return std::nullopt;  // it is made anew
  }
}

bool KeptFolder::keep(const std::string& key, const KeptThing& thing) const {
  if (failed_) return false;
  try {
    if (std::filesystem::space(folder_).available < kSpaceForOthers)
      fail({folder_.string(), "4 GiB of free space", "less", "make room, or train without --kept-scenes"});
    KeptTensors tensors = thing.tensors;
    if (tensors.empty()) tensors[kNothing] = torch::zeros({1}, torch::kUInt8);
    const auto file = file_of(key);
    std::filesystem::create_directories(file.parent_path());
    save_safetensors(file, tensors, thing.text);
    return true;
  } catch (const std::exception& error) {
    if (failed_.exchange(true)) return false;
    std::cerr << fmt::format("warning: nothing more is kept in {}: {}\n", folder_.string(), error.what());
    return false;
  }
}

}  // namespace gld
