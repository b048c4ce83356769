#include "models/dit/dit_options.h"

#include "gld/base/error.h"

#include <charconv>
#include <cmath>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kLargestSize = int64_t{1} << 20;

bool read_pixels(const std::string& text, int64_t& pixels) {
  const char* end = text.data() + text.size();
  const auto result = std::from_chars(text.data(), end, pixels);
  return result.ec == std::errc() && result.ptr == end && pixels > 0 && pixels <= kLargestSize;
}

void check_pair(const char* name, size_t count) {
  if (count != 2) {
    fail({name, "two values, [condition encoder, velocity decoder]", std::to_string(count), "give two"});
  }
}

}  // namespace

void DitOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"in_channels", "channels of a latent"}, in_channels, {1, kLargestSize});
  visitor.integers({"hidden_size", "widths of condition encoder and velocity decoder"}, hidden_size,
                   {8, kLargestSize});
  visitor.integers({"depth", "blocks of condition encoder and velocity decoder"}, depth, {0, 1000});
  visitor.integers({"num_heads", "attention heads of condition encoder and velocity decoder"}, num_heads,
                   {1, 1024});
  visitor.real({"mlp_ratio", "feed-forward width over width before SwiGLU's factor 2/3"}, mlp_ratio,
               {0.01, 100});
  visitor.integer({"patch_size", "latent tokens per model token along each side"}, patch_size, {1, 1});
  visitor.boolean({"qk_norm", "normalise queries and keys"}, qk_norm);
  visitor.integer({"camera_patch_size", "pixels per token along each side"}, camera_patch_size, {1, 1024});
  visitor.integer({"num_special_tokens", "special tokens in front of each view's patch tokens"},
                  num_special_tokens, {0, 1024});
  visitor.boolean({"split_embedders", "separate embedders for source and target views"}, split_embedders);
  visit_choice(visitor, {"conditioning", "what the condition encoder sees beside the source features"},
               conditioning, {"none", "deeper_level"});
  visit_choice(
      visitor,
      {"translation_unit", "what camera translations are divided by; largest_component is the release's"},
      translation_unit, {"largest_component", "largest_distance"});
  visitor.text({"prope_image_size", "pixels that PRoPE divides intrinsics by: image or a number"},
               prope_image_size);
  visit_choice(visitor, {"prope_inverse", "inverse of the projection in PRoPE"}, prope_inverse,
               {"published", "true"});
  visit_choice(visitor, {"prope_frame", "frame of the poses in PRoPE; matters with special tokens only"},
               prope_frame, {"reference_view", "world"});
  visit_choice(visitor, {"unconditional_intrinsics", "intrinsics of the unconditional branch"},
               unconditional_intrinsics, {"identity", "keep"});
  visit_choice(visitor, {"camera_embedding_input", "where the camera embedding is added"},
               camera_embedding_input, {"condition_encoder", "velocity_decoder"});
  visit_choice(visitor, {"position_embedding", "absolute positions of the tokens"}, position_embedding,
               {"none", "sincos"});
  visitor.reals({"pixel_offset", "where in a pixel its ray starts, [x, y]"}, pixel_offset, {-10, 10});
  visit_choice(visitor, {"prediction", "what the last layer gives; the velocity of data follows from it"},
               prediction, {"velocity", "data"});
  visitor.real(
      {"largest_inverse_time",
       "prediction of data: bound of 1/t where the velocity is formed; carried_guess: corrected needs none"},
      largest_inverse_time, {1, 1000});
  visitor.integer(
      {"warped_sources",
       "photographs carried into each target view by their depth, as one more input; 0: none, as published"},
      warped_sources, {0, 8});
  visitor.real(
      {"carried_error",
       "warped_sources: squared error of the carried features over the latent's variance, by which the "
       "predicted data rests on them; 0: they are only embedded"},
      carried_error, {0, 10});
  visit_choice(visitor,
               {"carried_guess",
                "carried_error: mixed with what the network predicts, or corrected by it (prediction: data)"},
               carried_guess, {"mixed", "corrected"});
}

void DitOptions::check() const {
  check_pair("hidden_size", hidden_size.size());
  check_pair("depth", depth.size());
  check_pair("num_heads", num_heads.size());
  check_pair("pixel_offset", pixel_offset.size());
  for (size_t part = 0; part < 2; ++part) {
    if (hidden_size[part] % (8 * num_heads[part]) != 0) {
      fail({"num_heads", "head sizes (hidden_size / num_heads) that are multiples of 8, as PRoPE needs",
            fmt::format("{} / {}", hidden_size[part], num_heads[part]), "choose another number of heads"});
    }
  }
  if (num_special_tokens > 0 && decoder_width() != in_channels) {
    fail({"num_special_tokens", fmt::format("a decoder width of {}, the channels of the latent", in_channels),
          std::to_string(decoder_width()), "set hidden_size[1] to in_channels, or num_special_tokens to 0"});
  }
  if (carried_guess == CarriedGuess::kCorrected &&
      (carried_error == 0 || prediction != FlowPrediction::kData || num_special_tokens > 0)) {
    fail({"carried_guess", "mixed without a carried_error, prediction: data and num_special_tokens: 0",
          "corrected", "give these, or leave it out"});
  }
  if (carried_error > 0 && warped_sources == 0) {
    fail({"carried_error", "0 for a model without warped_sources", fmt::format("{:g}", carried_error),
          "set it to 0, or warped_sources to 1 or more"});
  }
  int64_t pixels = 0;
  if (prope_image_size != "image" && !read_pixels(prope_image_size, pixels)) {
    fail({"prope_image_size", "image or a positive number of pixels", "'" + prope_image_size + "'",
          "write for example prope_image_size: 504"});
  }
}

int64_t DitOptions::swiglu_width(int64_t width) const {
  const auto plain = static_cast<int64_t>(static_cast<double>(width) * mlp_ratio);
  return static_cast<int64_t>(2.0 / 3.0 * static_cast<double>(plain));
}

int64_t DitOptions::prope_pixels() const {
  int64_t pixels = 0;
  return prope_image_size == "image" || !read_pixels(prope_image_size, pixels) ? 0 : pixels;
}

std::string narrow_decoder_note(const DitOptions& options) {
  if (options.decoder_width() >= options.in_channels) return {};
  const double floor =
      1.0 - static_cast<double>(options.decoder_width()) / static_cast<double>(options.in_channels);
  return fmt::format(
      "hidden_size[1] is {}, below in_channels of {}: "
      "the loss cannot fall below {:.3f}, because the velocity holds the noise of every channel; "
      "widen it to {} or more",
      options.decoder_width(), options.in_channels, floor, options.in_channels);
}

void apply_published_conventions(DitOptions& options) {
  options.prope_inverse = PropeInverse::kPublished;
  options.prope_frame = PropeFrame::kWorld;
  options.pixel_offset = {-0.5, 0.5};
}

}  // namespace gld
