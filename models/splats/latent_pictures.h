#pragma once

#include "gld/cameras/image_size.h"
#include "gld/latents/latent_statistics.h"
#include "gld/splatting/latent_view.h"
#include "models/bundle/bundle.h"

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// Which latent space features are of: features fitted in one mean nothing in another.
struct LatentTag {
  std::string model;          // the bundle's name
  std::string backbone;       // its kind, "da3"
  std::string backbone_hash;  // SHA-256 of its weights
  int64_t level = 0;
  int64_t channels = 0;
  int64_t width = 0, height = 0;  // of a view in latent pixels, where the features were fitted
  std::string statistics;         // what they are normalised by: "of the model" or "of the views"
  std::string statistics_hash;    // SHA-256 of the model's, else empty
};
nlohmann::ordered_json tag_json(const LatentTag& tag);
// Returns what tag_json wrote; none for anything else.
std::optional<LatentTag> tag_of_json(const nlohmann::json& json);

// A level of a latent space as pictures that Gaussians can be fitted to: an autoencoder's on the grid of its pixels,
// others on the grid of their patch tokens.
struct LatentPictures {
  LatentTag tag;
  LatentStatistics statistics;       // of a channel of the pictures
  std::vector<SplatImage> pictures;  // a view, normalised

  // Returns the camera of an image over the latent's pixels.
  Camera camera_of(const Camera& of_image) const;
  // Returns pictures `first` to `end` together, normalised: (views, channels, height, width).
  torch::Tensor views(int64_t first, int64_t end) const;
  // Returns (channels, height, width), raw: before normalisation.
  torch::Tensor raw(const SplatImage& picture) const;
};
// Returns normalised latents (views, channels, height, width) as they were before.
torch::Tensor raw_latents(const torch::Tensor& normalised, const LatentStatistics& statistics);
// Returns raw latents of that shape normalised.
torch::Tensor normalised_latents(const torch::Tensor& raw, const LatentStatistics& statistics);

// Returns the bundle's statistics of a level, of a channel of its pictures. Throws Error where it has none.
LatentStatistics statistics_of_pictures(const ModelBundle& bundle, int64_t level);

// Returns the levels that `names` says: numbers from 0, or "all". Throws Error for other words and for levels that the
// backbone does not have; option names what was asked ("--features").
std::vector<int64_t> latent_levels(const std::vector<std::string>& names, const BundleOptions& bundle,
                                   const std::string& option);

// Returns the size of pictures of about this size as the bundle's backbone takes them: sides are whole patches of it.
ImageSize latent_image_size(const BundleOptions& bundle, const ImageSize& about);
// Returns the image size of a view whose latent has so many pixels. Throws Error where an autoencoder's tokens do not
// divide them.
ImageSize image_size_of_latents(const BundleOptions& bundle, int64_t width, int64_t height);

// Returns latents of whatever kind, (views, channels, height, width), raw, normalised by their own mean and variance;
// of tag the model is taken.
LatentPictures latent_pictures_of(const torch::Tensor& latents, LatentTag tag);

// Makes pictures of levels of images (views, 3, height, width), RGB in [0, 1], sides whole patches, on the CPU; they
// are encoded together, the first one as the reference view of backbones that have one. Levels with statistics in the
// bundle are normalised by those, others by the mean and variance of what is encoded in the call. Of the bundle only
// the backbone, once, and the statistics are read.
class LatentEncoding {
 public:
  explicit LatentEncoding(const ModelBundle& bundle);
  const BundleOptions& options() const { return bundle_.options(); }
  // Returns whether pictures are encoded each alone, so that it does not matter which are given together.
  bool encodes_alone() const;
  std::vector<LatentPictures> operator()(const torch::Tensor& images,
                                         const std::vector<int64_t>& levels) const;

 private:
  ModelBundle bundle_;
  std::shared_ptr<Backbone> backbone_;
  std::string backbone_hash_;
  // Of levels whose statistics the bundle has: these, and their file's hash.
  struct KeptStatistics {
    LatentStatistics values;
    std::string hash;
  };
  std::map<int64_t, KeptStatistics> statistics_;
};

// Returns the latent views of images with these cameras, the channels of all levels behind each other. Levels are of
// one grid, at least one.
std::vector<LatentView> latent_views(const std::vector<LatentPictures>& levels,
                                     const std::vector<Camera>& cameras);

// Returns the levels that the bundle's image decoder takes, rising.
std::vector<int64_t> decoded_levels(const BundleOptions& bundle);
// Makes images of maps of those levels, in their order, raw, (views, channels, height, width), as LatentPictures::raw
// gives them: (views, 3, height, width), RGB in about [0, 1]. Of the bundle only the backbone and the image decoder are
// read.
class LatentDecoding {
 public:
  explicit LatentDecoding(const ModelBundle& bundle);
  torch::Tensor operator()(const std::vector<torch::Tensor>& maps) const;

 private:
  std::shared_ptr<const Backbone> backbone_;
  std::shared_ptr<const ImageDecoder> decoder_;
};

// These turn (channels, height, width) into a picture and back.
SplatImage splat_image_of(const torch::Tensor& picture);
torch::Tensor tensor_of(const SplatImage& picture);

}  // namespace gld
