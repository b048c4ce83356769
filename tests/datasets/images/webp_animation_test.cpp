#include "datasets/images/webp_animation.h"

#include "datasets/images/webp_file.h"
#include "gld/base/error.h"
#include "tests/support/error_of.h"
#include "tests/support/webp_frames.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using ::testing::HasSubstr;

// A smooth pattern that moves.
Image drawn(int64_t width, int64_t height, double phase) {
  Image image(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const double u = static_cast<double>(x) / 9 + phase, v = static_cast<double>(y) / 7;
      image.pixel(x, y)[0] = static_cast<uint8_t>(127 + 100 * std::sin(u));
      image.pixel(x, y)[1] = static_cast<uint8_t>(127 + 100 * std::sin(u + v));
      image.pixel(x, y)[2] = static_cast<uint8_t>(127 + 100 * std::cos(v));
    }
  }
  return image;
}

std::string film(const std::vector<Image>& frames, const std::string& xmp) {
  WebpAnimation animation(frames.front().width, frames.front().height, 92);
  for (size_t i = 0; i < frames.size(); ++i) animation.add(frames[i], static_cast<int64_t>(100 * i));
  return animation.finish(static_cast<int64_t>(100 * frames.size()), xmp);
}

TEST(WebpAnimation, IsDecodedToItsFramesAtTheirTimes) {
  std::vector<Image> frames;
  frames.reserve(4);
  for (int i = 0; i < 4; ++i) frames.push_back(drawn(61, 44, 0.6 * i));
  const std::string bytes = film(frames, "<x>one &amp; two</x>");
  EXPECT_EQ(bytes, film(frames, "<x>one &amp; two</x>"));
  const test::WebpFrames read = test::webp_frames(bytes);
  EXPECT_EQ(read.loops, 0);
  EXPECT_EQ(read.xmp, "<x>one &amp; two</x>");
  ASSERT_EQ(read.frames.size(), 4U);
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(read.ends_ms[i], static_cast<int>(100 * (i + 1)));
    EXPECT_GT(test::psnr_of(read.frames[i], frames[i]), 35) << i;
    // Another frame is another picture.
    EXPECT_LT(test::psnr_of(read.frames[i], frames[(i + 2) % 4]), 25) << i;
  }
  EXPECT_TRUE(test::webp_frames(film(frames, "")).xmp.empty());
}

// A picture of a scene is still a still for our reader, which says so of a film.
TEST(WebpAnimation, IsNoStillPicture) {
  const std::string bytes = film({drawn(16, 16, 0), drawn(16, 16, 1)}, "");
  EXPECT_THAT(error_of([&] { decode_webp(bytes, "a.webp"); }), HasSubstr("an animation of 2"));
}

TEST(WebpAnimation, RefusesInASentence) {
  EXPECT_EQ(error_of([] { WebpAnimation(20000, 10, 90); }),
            "WebP animation: expected sides of 1 to 16383 pixels, found 20000x10; choose another format.");
  EXPECT_EQ(error_of([] { WebpAnimation(10, 10, 101); }),
            "WebP animation: expected a quality from 0 to 100, found 101; choose another.");
  WebpAnimation animation(10, 10, 90);
  animation.add(drawn(10, 10, 0), 0);
  EXPECT_EQ(error_of([&] { animation.add(drawn(10, 12, 0), 50); }),
            "WebP animation: expected frames of one size, 10x10, found 10x12; check what made them.");
  EXPECT_EQ(error_of([&] { animation.add(drawn(10, 10, 0), 0); }),
            "WebP animation: expected a frame after 0 ms, found one at 0 ms; show each for a millisecond at "
            "least.");
}

}  // namespace
}  // namespace gld
