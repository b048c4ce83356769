#include "datasets/video/video_stream.h"

#include "tests/support/error_of.h"

#include <string>

#include <gtest/gtest.h>

namespace gld {
namespace {

std::string refusal(const std::string& probed) {
  return test::error_of([&] { parse_video_stream(probed, "walk.mp4"); });
}

TEST(VideoStream, IsWhatFfprobeSays) {
  const VideoStream mp4 = parse_video_stream(
      R"({"programs": [], "streams": [{"avg_frame_rate": "30000/1001", "duration": "12.5"}], "format": {"duration": "99"}})",
      "walk.mp4");
  EXPECT_EQ(mp4.seconds, 12.5);
  EXPECT_DOUBLE_EQ(mp4.pictures_a_second, 30000.0 / 1001);
  // Matroska files tell of the whole alone.
  const VideoStream mkv = parse_video_stream(
      R"({"streams": [{"avg_frame_rate": "8"}], "format": {"duration": "3.000"}})", "walk.mkv");
  EXPECT_EQ(mkv.seconds, 3);
  EXPECT_EQ(mkv.pictures_a_second, 8);
}

TEST(VideoStream, ThatIsNoneIsASentence) {
  const std::string kNone = "walk.mp4: expected a video, found a file without pictures; check the name.";
  for (const char* probed : {"{}", "[]", "3", "null", R"("streams")", R"({"streams": []})",
                             R"({"streams": {}})", R"({"streams": "v"})", R"([{"streams": [{}]}])"})
    EXPECT_EQ(refusal(probed), kNone) << probed;
}

TEST(VideoStream, WithoutTimeOrRateIsASentence) {
  const std::string kUntold =
      "walk.mp4: expected a video that says how long it is and how many pictures it shows a second, found one that "
      "does not; convert it with ffmpeg.";
  for (const char* duration : {"N/A", "", "-1", "0", "nan", "inf", "1e300", "1e-300", "x"})
    EXPECT_EQ(refusal(std::string(R"({"streams": [{"avg_frame_rate": "8/1", "duration": ")") + duration +
                      R"("}]})"),
              kUntold)
        << duration;
  for (const char* rate : {"0/0", "8/0", "8/", "/", "", "-8/1", "-8/-1", "8/-1", "nan/1", "8/nan",
                           "1e300/1e-300", "1/1e300", "eight"})
    EXPECT_EQ(
        refusal(std::string(R"({"streams": [{"duration": "1", "avg_frame_rate": ")") + rate + R"("}]})"),
        kUntold)
        << rate;
  for (const char* stream : {"3", "null", "[]", "{}", R"({"duration": 1, "avg_frame_rate": 8})",
                             R"({"duration": ["1"], "avg_frame_rate": {"8": 1}})"})
    EXPECT_EQ(refusal(std::string(R"({"streams": [)") + stream + R"(], "format": "long"})"), kUntold)
        << stream;
}

TEST(VideoStream, ThatIsNoJsonIsASentence) {
  const auto expected = [](const std::string& found) {
    return "walk.mp4: expected ffprobe to describe it as JSON, found text that is none (" + found +
           "); install FFmpeg again (apt install ffmpeg), or give single pictures.";
  };
  EXPECT_EQ(refusal(""), expected("a syntax error"));
  EXPECT_EQ(refusal(R"({"streams": [)"), expected("a syntax error"));
  EXPECT_EQ(refusal("streams.stream.0.duration=3"), expected("a syntax error"));
  EXPECT_EQ(refusal("{\"streams\": [{\"duration\": \"\xff\"}]}"), expected("text that is no UTF-8"));
  EXPECT_EQ(refusal(R"({"streams": [], "streams": []})"), expected("\"streams\" twice"));
  EXPECT_EQ(refusal(std::string(100'000, '[')), expected("more"));
}

}  // namespace
}  // namespace gld
