#include "models/dit/dit_options.h"

#include "gld/base/configuration.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"

#include <functional>
#include <string>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::small_dit_options;

TEST(DitOptions, RefuseWhatDoesNotFitTogether) {
  const auto refusal = [](const std::function<void(DitOptions&)>& change) {
    DitOptions options;
    change(options);
    return test::error_of([&] { check_options(options, "model.yaml"); });
  };
  EXPECT_NE(
      refusal([](DitOptions& o) {
        o.num_heads = {7, 16};
      })
          .find("expected head sizes (hidden_size / num_heads) that are multiples of 8, as PRoPE needs, "
                "found 768 / 7; choose another number of heads."),
      std::string::npos);
  EXPECT_NE(refusal([](DitOptions& o) { o.num_special_tokens = 5; })
                .find("expected a decoder width of 1536, the channels of the latent, found 2048; "
                      "set hidden_size[1] to in_channels, or num_special_tokens to 0."),
            std::string::npos);
  EXPECT_NE(refusal([](DitOptions& o) { o.prope_image_size = "large"; })
                .find("expected image or a positive number of pixels, found 'large'; "
                      "write for example prope_image_size: 504."),
            std::string::npos);
  EXPECT_NE(
      refusal([](DitOptions& o) { o.carried_error = 0.1; })
          .find(
              "expected 0 for a model without warped_sources, found 0.1; set it to 0, or warped_sources to 1 "
              "or more."),
      std::string::npos);
  EXPECT_NE(refusal([](DitOptions& o) { o.carried_guess = CarriedGuess::kCorrected; })
                .find("carried_guess: expected mixed without a carried_error, prediction: data and "
                      "num_special_tokens: 0, found corrected; give these, or leave it out."),
            std::string::npos);
  EXPECT_NE(refusal([](DitOptions& o) {
              o.depth = {28};
            }).find("expected two values, [condition encoder, velocity decoder], found 1; give two."),
            std::string::npos);
}

TEST(DitOptions, NoteAVelocityDecoderThatIsNarrowerThanTheLatent) {
  EXPECT_EQ(narrow_decoder_note(DitOptions()), "");
  DitOptions options = small_dit_options();
  options.in_channels = 64;
  EXPECT_EQ(narrow_decoder_note(options),
            "hidden_size[1] is 48, below in_channels of 64: "
            "the loss cannot fall below 0.250, because the velocity holds the noise of every channel; "
            "widen it to 64 or more");
}

TEST(DitOptions, SwigluWidthsOfThePublishedModels) {
  const DitOptions options;
  EXPECT_EQ(options.swiglu_width(768), 2048);
  EXPECT_EQ(options.swiglu_width(2048), 5461);
  EXPECT_EQ(options.swiglu_width(64), 170);
}

}  // namespace
}  // namespace gld
