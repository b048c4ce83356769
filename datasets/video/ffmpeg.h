#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Returns how every command of the program ffmpeg begins here: it asks nothing, prints errors alone, writes over what
// is there and, whatever a file may hold, opens nothing but files.
std::vector<std::string> ffmpeg_command(const std::filesystem::path& program);

}  // namespace gld
