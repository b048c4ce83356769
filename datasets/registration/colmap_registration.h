#pragma once

#include "datasets/registration/registration.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

struct ColmapRegistrationOptions {
  std::filesystem::path program;  // found_colmap()
  double timeout = 1800;          // seconds, all its steps together
  int threads = 1;
  // Whether the folder of a failure is kept for somebody to look at; where it is not, the error has the last line
  // printed.
  bool keeps_failures = true;
};

// Returns the program colmap on the PATH; empty where there is none.
std::filesystem::path found_colmap();

// Finds cameras by COLMAP (Schoenberger & Frahm 2016) as a program of its own, on the CPU, in a temporary folder.
// Throws Error where it fails or takes too long, with the place of what it printed or its last line, and where
// fewer than two photographs register (it is not); where names the option in it.
Registration register_by_colmap(const std::vector<UnregisteredPhotograph>& photographs,
                                const ColmapRegistrationOptions& options, const std::string& where);

}  // namespace gld
