#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

namespace gld {

// Returns whether a name ends like that of a video: .mp4, .mov, .m4v, .mkv, .webm or .avi, in whatever case.
bool is_video_name(const std::filesystem::path& file);

// Takes so many pictures of a video (fewer where it has fewer), as PNG files in `folder`, which exists: the video is
// cut into as many stretches of equal length, and of each the sharpest of up to kLooksAStretch evenly spread pictures
// is taken, by the variance of the Laplacian of its brightness. They are in order of time, named
// VIDEO_MILLISECONDSms.png, turned as the video says. The programs ffmpeg and ffprobe do it, which open nothing but
// files. Throws Error where one of them is missing or fails, and for a file without pictures; Interrupted on Ctrl-C.
std::vector<std::filesystem::path> sharpest_frames(const std::filesystem::path& video, int64_t count,
                                                   const std::filesystem::path& folder);
inline constexpr int64_t kLooksAStretch = 8;

}  // namespace gld
