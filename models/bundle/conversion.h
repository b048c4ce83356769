#pragma once

#include "gld/base/options.h"
#include "gld/files/stored_precision.h"
#include "models/bundle/bundle.h"

#include <filesystem>
#include <map>
#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// Which copy of the weights a PyTorch checkpoint gives: its moving average, its last step, or the file itself where it
// is a plain state_dict.
enum class CheckpointWeights { kEma, kModel, kPlain };

// gld convert makes of the published files a model bundle. Parts whose file is not given are left out and can be added
// later by converting again into the same folder.
struct ConversionOptions : OptionsGroup {
  // Folder of the published release, whose files are known by their names (published_release.h); empty: none. Files
  // that are given besides take the place of the release's.
  std::string release;
  // Files of backbones by their options in published_backbones.h, which says what each holds: {"vggt", "model.pt"}.
  std::map<std::string, std::string> backbones;
  std::string dpt_decoder;        // GLD .pt of a DA3 head that takes the place of the backbone's own
  std::string rgb_decoder;        // GLD .pt
  std::string level1;             // GLD .pt of M1
  std::string cascade;            // GLD .pt of M1->0
  std::string statistics_level0;  // .pt with mean and var
  std::string statistics_level1;
  std::string special_statistics_level0;  // the same of special tokens
  std::string special_statistics_level1;
  // model.yaml of the weights; empty for that of the bundle that is there already, the released model of the backbone
  // that is given, or the released DA3-Base model.
  std::string description;
  CheckpointWeights weights = CheckpointWeights::kEma;
  StoredPrecision store = StoredPrecision::kFloat32;
  std::string out;
  bool overwrite = false;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Converts and returns the report: {"bundle", "parts": {name: {"source", "selection", "tensors", "elements", "from":
// {dtype: tensors}, "to", "bytes"}}, "ignored": [{"source", "names", "tensors", "reason"}], "missing": [...]}. It is
// strict: every tensor of a source file is used or listed under "ignored" with its reason, and every tensor of a module
// is there. Numbers that are not finite, or not in the new precision, are an Error naming the tensor. Tensors are
// converted one at a time. The report is also written into the bundle as conversion.json, with what earlier
// conversions into it said of other parts. Where it fails the bundle is as it was.
nlohmann::ordered_json convert(const ConversionOptions& options);

std::string conversion_text(const nlohmann::ordered_json& report);

}  // namespace gld
