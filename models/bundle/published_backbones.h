#pragma once

#include "gld/files/weight_file.h"
#include "models/bundle/bundle_options.h"
#include "models/weights/weight_loading.h"

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// A published file of a backbone: the option of gld convert that takes it, how it is recognised, and what it holds.
// This table and backbone_registry.cpp are what names a family outside its own file.
struct PublishedBackbone {
  std::string option;     // "vggt"
  std::string help;       // of that option
  std::string name;       // "VGGT", for people
  std::string kind;       // of BackboneArchitecture
  std::string signature;  // a tensor's name, or its beginning, that no other published file has
  // These beginnings of names are taken away, one after the other; not every such file has them.
  std::vector<std::string> outer_prefixes;
  // Beginnings that the same weights have in other layouts, which are not read, and what those are.
  std::vector<std::pair<std::string, std::string>> other_layouts;
  std::string
      module_prefix;  // in front of the file's names in the bundle: "encoder." of a file with that half alone
  bool with_head = false;  // whether it holds the geometry head too
  std::vector<IgnoredName> ignored;
  // Returns the module's name of a tensor of the file, after the prefixes; empty stands for the same.
  std::function<std::string(const std::string& name, const BundleOptions& bundle)> renamed;
  std::function<BundleOptions()> options;  // the model it is of, where no description is given
  // Sets in the model's options, by what the file holds, what of that model files may have or not. Empty stands for
  // nothing.
  std::function<void(const WeightFile& file, BundleOptions& bundle)> take_optional_parts;
  // Returns the parts of the file that the model does without.
  std::function<std::vector<IgnoredName>(const BundleOptions& bundle)> left_out;
  // Requires what else the file must hold for that model: throws Error naming the first that is missing. Empty stands
  // for nothing.
  std::function<void(const WeightFile& file, const BundleOptions& bundle)> require_whole;
};

// Returns what the released DA3-Base checkpoints need: 28-layer RGB decoder, cascade with single embedders, published
// conventions of cameras.
BundleOptions released_da3_options();
// Returns the same for the released VGGT checkpoints: 5 special tokens generated with the
// patches (num_special_tokens: 0 leaves them to propagation, as the paper's final experiments do).
BundleOptions released_vggt_options();

const std::vector<PublishedBackbone>& published_backbones();
const PublishedBackbone& published_backbone(const std::string& option);

// Of files by their options, those that are given, in the table's order.
struct GivenBackbone {
  const PublishedBackbone& published;
  std::string path;
};
std::vector<GivenBackbone> given_backbones(const std::map<std::string, std::string>& files);

// Returns the name of a tensor of such a file without what is taken away in front.
std::string inner_name(const PublishedBackbone& published, const std::string& name);

// Throws Error naming what the file is, where it is a published backbone, but not one of that option.
void require_published(const WeightFile& file, const std::string& option);

// Throws, of a file that is to hold something else ("M1"), Error naming the backbone that it holds, or latent
// statistics.
void require_no_backbone(const WeightFile& file, const std::string& wanted);

// Returns the name in diffusers' files of a tensor of an autoencoder in the original ones (CompVis), which both also
// write in older ways; others are returned as they are. stages are those of the autoencoder, which originals count from
// the finest in both halves.
std::string diffusers_autoencoder_name(const std::string& name, int64_t stages);

}  // namespace gld
