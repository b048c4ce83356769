#include "datasets/video/ffmpeg.h"

namespace gld {

std::vector<std::string> ffmpeg_command(const std::filesystem::path& program) {
  return {program.string(), "-nostdin", "-hide_banner",        "-loglevel",
          "error",          "-y",       "-protocol_whitelist", "file"};
}

}  // namespace gld
