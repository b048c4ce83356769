#pragma once

#include "gld/files/weight_file.h"
#include "models/bundle/bundle_options.h"
#include "models/weights/weight_loading.h"

#include <functional>
#include <string>
#include <vector>

namespace gld {

// A published file of a backbone: the option of gld convert that takes it, how it is recognised, and what it holds.
struct PublishedBackbone {
  std::string option;     // "vggt"
  std::string name;       // "VGGT", for people
  std::string kind;       // of BackboneArchitecture
  std::string signature;  // a tensor's name, or its beginning, that no other published file has
  // Beginnings of names that are taken away, which not every such file has.
  std::vector<std::string> outer_prefixes;
  std::string
      module_prefix;  // in front of the file's names in the bundle: "encoder." of a file with that half alone
  bool with_head = false;  // whether it holds the geometry head too
  std::vector<IgnoredName> ignored;
  // The module's name of a tensor of the file, after the prefixes; empty for the same.
  std::function<std::string(const std::string& name, const BundleOptions& bundle)> renamed;
  std::function<BundleOptions()> options;  // the model it is of, where no description is given
};

const std::vector<PublishedBackbone>& published_backbones();
const PublishedBackbone& published_backbone(const std::string& option);

// Error naming what the file is, where it is a published backbone, but not one of that option.
void require_published(const WeightFile& file, const std::string& option);

// The name in diffusers' files of a tensor of an autoencoder in the original ones (CompVis), which both also write in older
// ways; others are returned as they are. stages: of the autoencoder, which originals count from the finest in both halves.
std::string diffusers_autoencoder_name(const std::string& name, int64_t stages);

}  // namespace gld
