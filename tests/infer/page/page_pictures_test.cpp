#include "infer/page/page_pictures.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::StartsWith;

// Returns what PNG cannot make smaller.
Image noisy(int64_t width, int64_t height) {
  Image image(width, height);
  uint32_t state = 1;
  for (uint8_t& value : image.rgb) {
    state = state * 1664525U + 1013904223U;
    value = static_cast<uint8_t>(state >> 24);
  }
  return image;
}

TEST(PagePictures, AreLosslessWhereThereIsRoom) {
  PagePictures pictures;
  EXPECT_EQ(pictures.add(noisy(60, 40)), 0);
  EXPECT_EQ(pictures.add(Image(60, 40)), 1);
  const auto addresses = pictures.addresses(1'000'000);
  ASSERT_EQ(addresses.size(), 2u);
  EXPECT_THAT(addresses[0], StartsWith("data:image/png;base64,"));
  EXPECT_THAT(addresses[1], StartsWith("data:image/png;base64,"));
  EXPECT_EQ(addresses, pictures.addresses(1'000'000));
}

TEST(PagePictures, AreAsGoodAsTheRoomLetsThem) {
  PagePictures pictures;
  pictures.add(noisy(120, 80));
  pictures.add(Image(120, 80));  // one colour: a PNG is smaller whatever the room
  const auto size = [](const std::vector<std::string>& addresses) {
    return addresses[0].size() + addresses[1].size();
  };
  const size_t lossless = size(pictures.addresses(1'000'000));
  const auto good = pictures.addresses(lossless - 1);
  EXPECT_THAT(good[0], StartsWith("data:image/jpeg;base64,"));
  EXPECT_THAT(good[1], StartsWith("data:image/png;base64,"));
  EXPECT_LT(size(good), lossless);
  const auto worse = pictures.addresses(size(good) - 1);
  EXPECT_LT(size(worse), size(good));
  // No worse than quality 70, whatever is asked for.
  EXPECT_EQ(size(pictures.addresses(1)), size(pictures.addresses(0)));
  EXPECT_GT(pictures.addresses(0)[0].size(), 4000u);
}

TEST(PagePictures, OfManyPixelsAreReduced) {
  PagePictures large, small;
  large.add(Image(4 * kPagePictureSide, 400));
  small.add(Image(kPagePictureSide, 100));
  EXPECT_EQ(large.addresses(1'000'000), small.addresses(1'000'000));
}

}  // namespace
}  // namespace gld
