#pragma once

#include <string>
#include <vector>

namespace gld {

// Which photographs are taken to have one lens, and so one focal length.
enum class PhotoLens {
  kBySize,  // those of equal size, upright or turned
  kShared,  // all, whatever their sizes: some may be smaller copies
  kOwn,     // none
};

// Photographs without cameras: files and folders.
struct PhotoSelection {
  std::vector<std::string> files;
  PhotoLens lens = PhotoLens::kBySize;
};

}  // namespace gld
