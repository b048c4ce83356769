#include "datasets/pictures/contact_sheet.h"

#include "datasets/pictures/drawing.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <cairo.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// Saturated colours that the sheet itself does not use, so that pictures are found by them.
Image flat(int64_t width, int64_t height, const Rgb& colour) { return filled_image(width, height, colour); }

Rgb colour_of(size_t view, uint8_t kind) { return {static_cast<uint8_t>(view), kind, 255}; }

struct Place {
  int64_t left = 1 << 30;
  int64_t top = 1 << 30;
  int64_t right = -1;
  int64_t bottom = -1;
  int64_t pixels = 0;
  int64_t width() const { return right - left + 1; }
  int64_t height() const { return bottom - top + 1; }
};

std::map<Rgb, Place> places(const Image& sheet) {
  std::map<Rgb, Place> result;
  for (int64_t y = 0; y < sheet.height; ++y) {
    for (int64_t x = 0; x < sheet.width; ++x) {
      const uint8_t* pixel = sheet.pixel(x, y);
      if (pixel[2] != 255 || pixel[1] > 3 || pixel[0] > 20) continue;
      Place& place = result[{pixel[0], pixel[1], pixel[2]}];
      place.left = std::min(place.left, x);
      place.right = std::max(place.right, x);
      place.top = std::min(place.top, y);
      place.bottom = std::max(place.bottom, y);
      ++place.pixels;
    }
  }
  return result;
}

std::vector<SheetView> views_of(size_t sources, size_t targets, int64_t width, int64_t height) {
  std::vector<SheetView> views;
  for (size_t i = 0; i < sources + targets; ++i) {
    SheetView view;
    view.name = "view_" + std::to_string(i);
    view.role = i < sources ? SheetRole::kSource : SheetRole::kTarget;
    view.image = flat(width, height, colour_of(i, 0));
    view.depth = flat(width, height, colour_of(i, 2));
    if (i >= sources) {
      view.truth = flat(width, height, colour_of(i, 1));
      view.note = "21.3 dB";
    }
    views.push_back(view);
  }
  return views;
}

TEST(ContactSheet, AVerdictStandsAboveThePictures) {
  SheetText text;
  text.title = "gld sample";
  const Image without = make_contact_sheet(views_of(1, 1, 112, 112), text);
  text.verdict = {"These pictures are as good as their photographs'", "predictions of each other are."};
  const Image with = make_contact_sheet(views_of(1, 1, 112, 112), text);
  // Two lines of 14 pixels with what is between them; the pictures give way where the sheet may not grow.
  const int64_t top = places(without).at(colour_of(0, 0)).top;
  const int64_t lower = places(with).at(colour_of(0, 0)).top - top;
  EXPECT_GE(lower, 2 * 14);
  EXPECT_LE(lower, 4 * 14);
  const auto dark_above = [](const Image& sheet, int64_t end) {
    int64_t dark = 0;
    for (int64_t y = 0; y < end; ++y) {
      for (int64_t x = 0; x < sheet.width; ++x) dark += sheet.pixel(x, y)[0] < 100 ? 1 : 0;
    }
    return dark;
  };
  EXPECT_GT(dark_above(with, top + lower), dark_above(without, top) + 500);  // words of 74 letters
}

TEST(ContactSheet, ShowsEveryPictureOnceAtItsAspect) {
  struct Case {
    size_t sources;
    size_t targets;
    int64_t width;
    int64_t height;
  };
  for (const Case& c : {Case{2, 6, 504, 280}, Case{1, 1, 112, 112}, Case{4, 12, 504, 504},
                        Case{0, 3, 64, 512}, Case{1, 7, 512, 64}, Case{8, 0, 336, 504}}) {
    SCOPED_TRACE(testing::Message() << c.sources << "+" << c.targets << " of " << c.width << "x" << c.height);
    SheetText text;
    text.title = "gld sample";
    text.subtitle = "seed 0, 16 evaluations";
    text.depth_unit = "m";
    const Image sheet = make_contact_sheet(views_of(c.sources, c.targets, c.width, c.height), text);
    const std::map<Rgb, Place> found = places(sheet);
    EXPECT_EQ(found.size(), 2 * c.sources + 3 * c.targets);
    const double aspect = static_cast<double>(c.width) / static_cast<double>(c.height);
    for (const auto& [colour, place] : found) {
      EXPECT_EQ(place.pixels, place.width() * place.height()) << "covered or torn";
      EXPECT_NEAR(static_cast<double>(place.width()), aspect * static_cast<double>(place.height()),
                  std::max(aspect, 1.0));
      EXPECT_GE(std::max(place.width(), place.height()), 140);
      EXPECT_GE(place.left, 24);
      EXPECT_GE(place.top, 24);
      EXPECT_LE(place.right, sheet.width - 24);
      EXPECT_LE(place.bottom, sheet.height - 24);
    }
    // What belongs to one view stands in one column: image, truth, depth from top to bottom.
    for (size_t i = c.sources; i < c.sources + c.targets; ++i) {
      const Place& image = found.at(colour_of(i, 0));
      const Place& truth = found.at(colour_of(i, 1));
      const Place& depth = found.at(colour_of(i, 2));
      EXPECT_EQ(image.left, truth.left);
      EXPECT_EQ(image.left, depth.left);
      EXPECT_LT(image.bottom, truth.top);
      EXPECT_LT(truth.bottom, depth.top);
    }
    if (c.sources > 0 && c.targets > 0) {
      EXPECT_LT(found.at(colour_of(c.sources - 1, 2)).bottom, found.at(colour_of(c.sources, 0)).top);
    }
  }
}

TEST(ContactSheet, SectionsOfPicturesStandBelowEachOther) {
  std::vector<SheetSection> sections(2);
  for (size_t i = 0; i < 5; ++i) {
    sections[i < 3 ? 0 : 1].pictures.emplace_back("decoded", flat(112, 112, colour_of(i, 0)));
  }
  sections[0].heading = "room_0";
  sections.emplace_back();  // nothing to show
  const std::map<Rgb, Place> found = places(make_picture_sheet(sections, {"title", {}, "", {}, ""}));
  ASSERT_EQ(found.size(), 5U);
  const auto at = [&](size_t picture) { return found.at(colour_of(picture, 0)); };
  for (const size_t i : {0U, 1U, 3U}) {
    EXPECT_EQ(at(i).top, at(i + 1).top);
    EXPECT_LT(at(i).right, at(i + 1).left);
  }
  EXPECT_LT(at(0).bottom, at(3).top);
  EXPECT_EQ(at(0).left, at(3).left);
  EXPECT_EQ(at(0).left, 24);  // no column of labels
}

TEST(ContactSheet, StaysInsideItsLimitsForEightViews) {
  const Image sheet = make_contact_sheet(views_of(2, 6, 504, 280), {"title", {}, "subtitle", {}, ""});
  EXPECT_LE(sheet.width, 1920);
  EXPECT_LE(sheet.height, 1600);
  EXPECT_GT(sheet.width, 900);
  SheetLimits small;
  small.width = 800;
  small.height = 800;
  const Image smaller = make_contact_sheet(views_of(2, 2, 504, 280), {}, small);
  EXPECT_LE(smaller.width, 800);
  EXPECT_LE(smaller.height, 800);
}

TEST(ContactSheet, LeavesRowsOutThatNobodyHasAndMarksMissingPictures) {
  std::vector<SheetView> views = views_of(1, 2, 200, 100);
  for (SheetView& view : views) view.depth = Image();
  const int64_t with_truth = make_contact_sheet(views, {}).height;
  for (SheetView& view : views) view.truth = Image();
  const Image without_truth = make_contact_sheet(views, {});
  EXPECT_LT(without_truth.height, with_truth);
  EXPECT_EQ(places(without_truth).size(), 3U);
  views = views_of(1, 2, 200, 100);
  views[2].truth = Image();
  const Image sheet = make_contact_sheet(views, {});
  EXPECT_EQ(places(sheet).size(), 7U);
  EXPECT_EQ(places(sheet).count(colour_of(2, 1)), 0U);
}

TEST(ContactSheet, TheSameInputGivesTheSamePixels) {
  const SheetText text{"title", {}, "subtitle", {0.5, 12}, "m"};
  EXPECT_EQ(make_contact_sheet(views_of(2, 3, 112, 112), text).rgb,
            make_contact_sheet(views_of(2, 3, 112, 112), text).rgb);
}

TEST(ContactSheet, RefusesNothing) {
  EXPECT_EQ(test::error_of([] { make_contact_sheet({}, {}); }),
            "contact sheet: expected at least one picture, found none; decode images or depth.");
  EXPECT_EQ(test::error_of([] { make_picture_sheet({SheetSection()}, {}); }),
            "contact sheet: expected at least one picture, found none; decode images or depth.");
  EXPECT_EQ(test::error_of([] { make_contact_sheet({SheetView()}, {}); }),
            "contact sheet: expected at least one picture, found none; decode images or depth.");
}

TEST(Drawing, TextIsInsideTheWidthItClaims) {
  for (const TextStyle& style : {TextStyle{13, {255, 255, 255}, TextWeight::kRegular},
                                 TextStyle{24, {255, 255, 255}, TextWeight::kBold}}) {
    Image image = filled_image(300, 60, {0, 0, 0});
    draw_text(image, 20, 10, "Source views (4)", style);
    int64_t left = 300;
    int64_t right = 0;
    int64_t top = 60;
    int64_t bottom = 0;
    for (int64_t y = 0; y < 60; ++y) {
      for (int64_t x = 0; x < 300; ++x) {
        if (image.pixel(x, y)[0] < 32) continue;
        left = std::min(left, x);
        right = std::max(right, x);
        top = std::min(top, y);
        bottom = std::max(bottom, y);
      }
    }
    EXPECT_GE(left, 18);
    EXPECT_LE(right, 20 + text_width("Source views (4)", style) + 2);
    EXPECT_GT(right, 20 + text_width("Source views (4)", style) * 3 / 4);
    EXPECT_GE(top, 10);
    EXPECT_LE(bottom, 10 + 2 * style.size);
  }
}

TEST(Drawing, ClipsAndCutsText) {
  Image image = filled_image(20, 20, {0, 0, 0});
  draw_text(image, -30, -10, "outside on all sides", {30, {255, 255, 255}, TextWeight::kBold});
  fill_rect(image, {-5, 15, 100, 100}, {1, 2, 3});
  EXPECT_EQ(image.pixel(19, 19)[2], 3);
  paste(image, filled_image(8, 8, {9, 9, 9}), 16, -4);
  EXPECT_EQ(image.pixel(16, 3)[0], 9);
  EXPECT_NE(image.pixel(16, 4)[0], 9);
  const TextStyle style;
  EXPECT_EQ(fitted_text("short", 200, style), "short");
  const std::string cut = fitted_text("a rather long name of a view 0012", 110, style);
  EXPECT_LE(text_width(cut, style), 110);
  EXPECT_THAT(
      cut, testing::AllOf(testing::StartsWith("a ra"), testing::HasSubstr("…"), testing::EndsWith("0012")));
}

TEST(Drawing, NamesInOtherScriptsAreLetters) {
  const TextStyle style{20, {255, 255, 255}, TextWeight::kRegular};
  const auto drawn = [&](const std::string& text) {
    Image image = filled_image(400, 40, {0, 0, 0});
    draw_text(image, 10, 5, text, style);
    return image.rgb;
  };
  EXPECT_NE(drawn("Zürich"), drawn("Zurich"));
  EXPECT_NE(drawn("Комната"), drawn("???????"));
  EXPECT_NE(drawn("Комната"), drawn("Комнаты"));
  // The letter is in a plane that is left to private use, where no usual font has anything.
  EXPECT_EQ(drawn("a\U0010FFFDb"), drawn("aU+10FFFDb"));
}

TEST(Drawing, PaintsWithCairoOnlyInsideItsRectangle) {
  Image image = filled_image(6, 4, {10, 20, 30});
  paint_with_cairo(image, {2, 1, 100, 2}, [](cairo_t* cairo) {
    set_source(cairo, {200, 100, 50});
    cairo_paint(cairo);
  });
  for (int64_t y = 0; y < 4; ++y) {
    for (int64_t x = 0; x < 6; ++x) {
      const bool inside = x >= 2 && (y == 1 || y == 2);
      const uint8_t* pixel = image.pixel(x, y);
      EXPECT_EQ((Rgb{pixel[0], pixel[1], pixel[2]}), (inside ? Rgb{200, 100, 50} : Rgb{10, 20, 30}))
          << x << " " << y;
    }
  }
  paint_with_cairo(image, {6, 4, 2, 2}, [](cairo_t*) { FAIL() << "nothing is left to paint on"; });
}

}  // namespace
}  // namespace gld
