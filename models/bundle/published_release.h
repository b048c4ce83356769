#pragma once

#include "models/bundle/conversion.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Files of the published release (the snapshot SeonghuJeon/GLD of Hugging Face, put into a clone of
// cvlab-kaist/Geometric-Latent-Diffusion as its README says), by their paths there.
struct ReleaseFile {
  std::string path;                        // "checkpoints/da3_level1.pt"
  std::string ConversionOptions::*option;  // what gld convert is given it as; null for da3
};

// Those of the model on DA3, or on VGGT. VGGT-1B itself is not among them.
enum class ReleasedModel { kDa3, kVggt };
const std::vector<ReleaseFile>& release_files(ReleasedModel model);

// Returns the options with every file that is not given taken from options.release: the model on VGGT where vggt is
// given, else that on DA3. A file is found at its path in the release, below the release's first folder left out, and
// where that name is of one file alone beside the others. Options without a release stay as they are. Throws Error
// naming all files that are missing; what may be missing is what an option gives.
ConversionOptions with_release(const ConversionOptions& options);

}  // namespace gld
