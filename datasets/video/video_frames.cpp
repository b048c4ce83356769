#include "datasets/video/video_frames.h"

#include "datasets/images/image_file.h"
#include "datasets/video/ffmpeg.h"
#include "datasets/video/video_stream.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/error.h"
#include "gld/base/work_folder.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

// A list of other files that calls itself a video is none of these.
constexpr const char* kContainers = "mov,matroska,avi";
// Sharpness is told at this size as well as at any, and sooner.
constexpr int kLookWidth = 480;

std::filesystem::path require_program(const std::string& name, const std::filesystem::path& video) {
  auto program = found_program(name);
  if (program.empty()) {
    fail({video.string(), "the program " + name + " on the PATH, which reads videos", "none",
          "install it (apt install ffmpeg), or give single pictures"});
  }
  return program;
}

// FFmpeg takes a name with a colon for a protocol.
std::string as_file(const std::filesystem::path& video) {
  return "file:" + std::filesystem::absolute(video).string();
}

void run(const std::vector<std::string>& command, WorkFolder& work, const std::filesystem::path& video) {
  const int status = run_program(command, work.log(), "while " + video.string() + " was read");
  if (status == 0) return;
  work.keep();
  fail({video.string(), "a video that ffmpeg reads",
        fmt::format("exit status {} of {}; what it printed is in {}", status,
                    std::filesystem::path(command.front()).filename().string(), work.log().string()),
        "see there, or give single pictures"});
}

VideoStream stream_of(const std::filesystem::path& video, WorkFolder& work) {
  const auto answer = work.path() / "stream.json";
  run({require_program("ffprobe", video).string(), "-v", "error", "-protocol_whitelist", "file",
       "-format_whitelist", kContainers, "-select_streams", "v:0", "-show_entries",
       "stream=duration,avg_frame_rate:format=duration", "-of", "json", "-o", answer.string(),
       as_file(video)},
      work, video);
  return parse_video_stream(read_file(answer), video);
}

// Returns the pictures at `rate` a second that pass `filter`, as 000001.png, ...
std::vector<std::filesystem::path> pictures_of(const std::filesystem::path& video, double rate,
                                               const std::string& filter, const std::filesystem::path& folder,
                                               WorkFolder& work) {
  std::filesystem::create_directories(folder);
  std::vector<std::string> command = ffmpeg_command(require_program("ffmpeg", video));
  const std::vector<std::string> rest{"-format_whitelist",
                                      kContainers,
                                      "-i",
                                      as_file(video),
                                      "-map",
                                      "0:v:0",
                                      "-vf",
                                      fmt::format("fps={:.9g},{}", rate, filter),
                                      "-fps_mode",
                                      "passthrough",
                                      "-f",
                                      "image2",
                                      (folder / "%06d.png").string()};
  command.insert(command.end(), rest.begin(), rest.end());
  run(command, work, video);
  std::vector<std::filesystem::path> pictures;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) pictures.push_back(entry.path());
  std::sort(pictures.begin(), pictures.end());
  return pictures;
}

// Returns the variance of four times a pixel less its neighbours.
double sharpness_of(const std::filesystem::path& picture) {
  const Image image = read_image(picture);
  double sum = 0, squares = 0;
  int64_t count = 0;
  const auto brightness = [&](int64_t x, int64_t y) { return static_cast<double>(image.pixel(x, y)[0]); };
  for (int64_t y = 1; y + 1 < image.height; ++y) {
    for (int64_t x = 1; x + 1 < image.width; ++x) {
      const double edge = 4 * brightness(x, y) - brightness(x - 1, y) - brightness(x + 1, y) -
                          brightness(x, y - 1) - brightness(x, y + 1);
      sum += edge;
      squares += edge * edge;
      ++count;
    }
  }
  if (count == 0) return 0;
  const double mean = sum / static_cast<double>(count);
  return squares / static_cast<double>(count) - mean * mean;
}

}  // namespace

bool is_video_name(const std::filesystem::path& file) {
  std::string ending = file.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  constexpr std::array<const char*, 6> kEndings{".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi"};
  return std::find(kEndings.begin(), kEndings.end(), ending) != kEndings.end();
}

std::vector<std::filesystem::path> sharpest_frames(const std::filesystem::path& video, int64_t count,
                                                   const std::filesystem::path& folder) {
  WorkFolder work("video");
  const VideoStream stream = stream_of(video, work);
  const double rate =
      std::min(stream.pictures_a_second, static_cast<double>(count * kLooksAStretch) / stream.seconds);
  const auto looks = pictures_of(video, rate, fmt::format("scale='min({},iw)':-2,format=gray", kLookWidth),
                                 work.path() / "looks", work);
  if (looks.empty()) fail({video.string(), "a video", "one without a picture", "record it again"});
  const auto stretches = std::min(static_cast<size_t>(count), looks.size());
  std::vector<size_t> chosen;
  std::string passing;
  for (size_t i = 0; i < stretches; ++i) {
    const size_t first = i * looks.size() / stretches, end = (i + 1) * looks.size() / stretches;
    size_t best = first;
    double sharpest = -1;
    for (size_t look = first; look < end; ++look) {
      const double sharpness = sharpness_of(looks[look]);
      if (sharpness > sharpest) {
        sharpest = sharpness;
        best = look;
      }
    }
    chosen.push_back(best);
    passing += fmt::format("{}eq(n\\,{})", i == 0 ? "" : "+", best);
  }
  const auto pictures = pictures_of(video, rate, "select='" + passing + "'", work.path() / "chosen", work);
  if (pictures.size() != chosen.size()) {
    fail({video.string(), fmt::format("{} pictures of ffmpeg", chosen.size()),
          fmt::format("{}", pictures.size()), "convert the video with ffmpeg, or give single pictures"});
  }
  std::vector<std::filesystem::path> frames;
  for (size_t i = 0; i < chosen.size(); ++i) {
    const auto milliseconds = std::llround(1000 * static_cast<double>(chosen[i]) / rate);
    frames.push_back(folder / fmt::format("{}_{:07}ms.png", video.stem().string(), milliseconds));
    write_file_atomically(frames.back(), read_file(pictures[i]));
  }
  return frames;
}

}  // namespace gld
