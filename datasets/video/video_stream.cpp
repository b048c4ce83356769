#include "datasets/video/video_stream.h"

#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <cstdlib>

namespace gld {
namespace {

// Beyond what any camera takes, and so far from the limits of doubles that times in milliseconds are whole numbers.
constexpr double kSmallest = 1e-9, kLargest = 1e9;

double usual(double value) { return value >= kSmallest && value <= kLargest ? value : 0; }

// Returns 0 where there is none, as of what follows.
double number_of(const nlohmann::ordered_json& json, const char* key) {
  const auto found = json.find(key);
  if (found == json.end() || !found->is_string()) return 0;
  return usual(std::strtod(found->get<std::string>().c_str(), nullptr));
}

// Reads a rate such as "30000/1001".
double rate_of(const nlohmann::ordered_json& stream) {
  const auto found = stream.find("avg_frame_rate");
  if (found == stream.end() || !found->is_string()) return 0;
  const auto text = found->get<std::string>();
  char* end = nullptr;
  const double above = std::strtod(text.c_str(), &end);
  const double below = *end == '/' ? std::strtod(end + 1, nullptr) : 1;
  return above > 0 && below > 0 ? usual(above / below) : 0;
}

nlohmann::ordered_json parsed(const std::string& probed, const std::filesystem::path& video) {
  try {
    return parse_ordered_json(probed, video.string());
  } catch (const Error& error) {
    fail({video.string(), "ffprobe to describe it as JSON", "text that is none (" + error.parts().found + ")",
          "install FFmpeg again (apt install ffmpeg), or give single pictures"});
  }
}

}  // namespace

VideoStream parse_video_stream(const std::string& probed, const std::filesystem::path& video) {
  const auto json = parsed(probed, video);
  const auto streams = json.find("streams");
  if (streams == json.end() || !streams->is_array() || streams->empty()) {
    fail({video.string(), "a video", "a file without pictures", "check the name"});
  }
  VideoStream stream;
  stream.pictures_a_second = rate_of(streams->front());
  stream.seconds = number_of(streams->front(), "duration");
  if (const auto format = json.find("format"); stream.seconds <= 0 && format != json.end()) {
    stream.seconds = number_of(*format, "duration");
  }
  if (stream.seconds <= 0 || stream.pictures_a_second <= 0) {
    fail({video.string(), "a video that says how long it is and how many pictures it shows a second",
          "one that does not", "convert it with ffmpeg"});
  }
  return stream;
}

}  // namespace gld
