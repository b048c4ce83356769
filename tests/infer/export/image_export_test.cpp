#include "infer/export/image_export.h"

#include "datasets/images/image_file.h"
#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"
#include "gld/report/provenance.h"
#include "tests/support/error_of.h"
#include "tests/support/exported_files.h"
#include "tests/support/temporary_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::ElementsAre;
using testing::Pair;

struct TwoOptions : OptionsGroup {
  int64_t steps = 16;
  std::string out = "runs/one";
  void visit(FieldVisitor& visitor) override {
    visitor.integer({"steps", "evaluations"}, steps, {1, 100});
    visitor.text({"out", "folder"}, out);
  }
};

Provenance example() {
  Provenance provenance = make_provenance("sample", TwoOptions());
  provenance.model_hash = "00ff";
  provenance.seed = 7;
  return provenance;
}

Image ramp(int64_t width, int64_t height) {
  Image image(width, height);
  for (size_t i = 0; i < image.rgb.size(); ++i) image.rgb[i] = static_cast<uint8_t>(i * 7);
  return image;
}

TEST(Provenance, LeavesOutWhatDoesNotChangeTheResult) {
  EXPECT_THAT(
      provenance_items(example()),
      ElementsAre(Pair("Software", testing::StartsWith("gld ")), Pair("gld:command", "sample"),
                  Pair("gld:options", R"({"steps":16})"), Pair("gld:model", "00ff"), Pair("gld:seed", "7")));
  Provenance without_model = example();
  without_model.model_hash.clear();
  EXPECT_EQ(test::find_text(provenance_items(without_model), "gld:model"), "");
  EXPECT_EQ(test::find_text(provenance_items(without_model), "gld:seed"), "7");
}

struct SceneOptions : OptionsGroup {
  std::string scene;
  void visit(FieldVisitor& visitor) override { visitor.text({"scene", "a folder"}, scene); }
};

TEST(Provenance, DoesNotSayWhereItsMakerKeepsThings) {
  SceneOptions options;
  for (const auto& [folder, shown] :
       {std::pair<std::string, std::string>{"/home/someone/private/scene", "scene"},
        {"/home/someone/scene/", "scene"},
        {"photos/scene", "photos/scene"},
        {"/home/someone/\xFF", "\xEF\xBF\xBD"}}) {
    options.scene = folder;
    EXPECT_EQ(make_provenance("sample", options).options, R"({"scene":")" + shown + R"("})");
  }
}

TEST(ImageExport, KeepsPixelsAndProvenance) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "view_00.png";
  const Image image = ramp(31, 17);
  export_image(file, image, example(), {{"gld:view", "source – Zürich"}});
  const Image read = read_image(file);
  EXPECT_EQ(read.width, 31);
  EXPECT_EQ(read.height, 17);
  EXPECT_EQ(read.rgb, image.rgb);
  TextItems expected = provenance_items(example());
  expected.emplace_back("gld:view", "source – Zürich");  // not ASCII: an iTXt chunk
  EXPECT_EQ(test::read_png_texts(file), expected);
}

TEST(ImageExport, TheSameInputGivesTheSameBytes) {
  test::TemporaryFolder folder;
  for (const char* name : {"a.png", "b.png"}) export_image(folder.path() / name, ramp(64, 48), example());
  EXPECT_EQ(read_file(folder.path() / "a.png"), read_file(folder.path() / "b.png"));
  size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
    files += entry.exists() ? 1 : 0;
  EXPECT_EQ(files, 2U) << "a temporary file was left";
}

TEST(ImageExport, TakesBlackAndLongShapes) {
  test::TemporaryFolder folder;
  for (const auto& [width, height] : {std::pair<int64_t, int64_t>{8, 64}, {64, 8}, {2, 2}}) {
    const Image black(width, height);
    export_image(folder.path() / "black.png", black, example());
    EXPECT_EQ(read_image(folder.path() / "black.png").rgb, black.rgb);
  }
}

TEST(ImageExport, RefusesWhatIsNoImage) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "none.png";
  EXPECT_EQ(test::error_of([&] { export_image(file, Image(), example()); }),
            "PNG: expected an image with pixels, found 0x0 with 0 values; check what made it.");
  Image torn(4, 4);
  torn.rgb.pop_back();
  EXPECT_EQ(test::error_of([&] { export_image(file, torn, example()); }),
            "PNG: expected an image with pixels, found 4x4 with 47 values; check what made it.");
  EXPECT_EQ(test::error_of([&] {
              encode_png(ramp(2, 2), {{"", "text"}});
            }),
            "PNG text: expected a name of 1 to 79 ASCII characters, found \"\"; shorten it.");
  EXPECT_FALSE(std::filesystem::exists(file));
}

TEST(PngTexts, ThatAreDamagedAreRefusedWithTheirPicture) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "broken.png";
  const std::string whole = encode_png(ramp(9, 9), {{"name", "text"}});
  const auto refusal_of = [&](const std::string& bytes) {
    write_file_atomically(file, bytes);
    return test::error_of([&] { read_image(file); });
  };
  std::string altered = whole;
  altered[33 + 8 + 5] = 'T';  // inside the text chunk behind the header
  EXPECT_EQ(refusal_of(altered),
            file.string() +
                ": expected an image that can be decoded, found damaged data (libpng: tEXt: CRC error); "
                "copy or download it again.");
  // A length field that reaches beyond the file.
  std::string endless = whole;
  endless[33] = '\x7f';
  EXPECT_EQ(
      refusal_of(endless),
      file.string() + ": expected a whole image file, found one that ends early; copy or download it again.");
}

TEST(PngTexts, RefusesWhatThePngFormatWouldChange) {
  EXPECT_EQ(
      test::error_of([] {
        encode_png(ramp(2, 2), {{"two  blanks", "text"}});
      }),
      "PNG: expected libpng to encode the image, found \"keyword \"two  blanks\": bad character '0x20'\".");
  EXPECT_EQ(test::error_of([] {
              encode_png(ramp(2, 2), {{"name", std::string("a\0b", 3)}});
            }),
            "PNG text name: expected a text without zero bytes, found one; leave them out.");
}

TEST(PngTexts, LongTextsAndPicturesKeepEveryByte) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "long.png";
  const std::string ascii(3'000'000, 'x');
  const TextItems texts{{"ascii", ascii}, {"unicode", "漢字 " + ascii}, {"lines", "a\nb"}, {"empty", ""}};
  write_file_atomically(file, encode_png(ramp(301, 203), texts));
  EXPECT_EQ(test::read_png_texts(file), texts);
  EXPECT_EQ(read_image(file).rgb, ramp(301, 203).rgb);
}

TEST(PngTexts, NothingReachesTheTerminal) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "broken.png";
  const std::string whole = encode_png(ramp(9, 9), {{"name", "text"}});
  testing::internal::CaptureStderr();
  for (size_t i = 8; i < whole.size(); ++i) {
    std::string altered = whole;
    altered[i] = static_cast<char>(altered[i] ^ 0x41);
    write_file_atomically(file, altered);
    const std::string error = test::error_of([&] { read_image(file); });
    EXPECT_EQ(error.find('\n'), std::string::npos) << i;
    EXPECT_EQ(error.rfind(file.string() + ": expected ", 0), 0U) << i << ": " << error;
  }
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

TEST(ViewName, HasEnoughDigits) {
  EXPECT_EQ(view_name(3, 8), "view_03");
  EXPECT_EQ(view_name(3, 101), "view_003");
  EXPECT_EQ(view_name(99, 100), "view_99");
}

}  // namespace
}  // namespace gld
