#pragma once

#include "infer/request/sampling_scene.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>

#include <torch/types.h>

namespace gld {

// Generated levels of a run that is not finished, in its folder: gld sample --resume goes on from them. A level appears
// whole or not at all.
class UnfinishedLatents {
 public:
  explicit UnfinishedLatents(const std::filesystem::path& run_folder) : folder_(run_folder / "unfinished") {}

  // What made a level.
  struct Origin {
    std::string model_hash;
    std::string method;  // its options as JSON
    std::string inputs;  // inputs_hash()
  };

  // Returns them as PipelineRequest::kept_latents takes them; those of another origin are not taken, nor damaged ones:
  // their bytes are under a checksum. Their stages run again.
  std::map<int64_t, torch::Tensor> read(const Origin& origin) const;
  void write(int64_t level, const torch::Tensor& latent, const Origin& origin) const;
  // When everything that is made of them is written.
  void remove() const;

 private:
  std::filesystem::path folder_;
};

// Returns the SHA-256 of what a scene gives the pipeline: sizes, names, cameras, and the pixels and measured depth of
// the source views.
std::string inputs_hash(const SamplingScene& scene);

}  // namespace gld
