#pragma once

#include <filesystem>
#include <string>

namespace gld {

// What the program ffprobe says of a video's pictures. Both are positive and such as videos have.
struct VideoStream {
  double seconds = 0;
  double pictures_a_second = 0;
};

// probed is the JSON that ffprobe writes for -show_entries stream=duration,avg_frame_rate:format=duration of one
// stream. Throws Error naming the video where it is no JSON, or lists no stream, or does not tell one of the two.
VideoStream parse_video_stream(const std::string& probed, const std::filesystem::path& video);

}  // namespace gld
