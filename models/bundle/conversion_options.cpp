#include "gld/base/command_options.h"
#include "gld/base/dashed_name.h"
#include "gld/base/error.h"
#include "models/bundle/conversion.h"
#include "models/bundle/published_backbones.h"

namespace gld {

void ConversionOptions::visit(FieldVisitor& visitor) {
  visitor.text(
      {"release",
       "folder of the published snapshot, whose files are known by their names: the model on DA3, or with "
       "--vggt on VGGT"},
      release);
  for (const auto& published : published_backbones()) {
    visitor.text({published.option, published.help}, backbones[published.option]);
  }
  visitor.text({"dpt_decoder", "GLD's dpt_decoder.pt: replaces tensors of the DA3 head"}, dpt_decoder);
  visitor.text({"rgb_decoder", "GLD's .pt file of the RGB decoder"}, rgb_decoder);
  visitor.text({"level1", "GLD's .pt file of M1"}, level1);
  visitor.text({"cascade", "GLD's .pt file of the cascade"}, cascade);
  visitor.text({"statistics_level0", ".pt file with mean and var of level 0"}, statistics_level0);
  visitor.text({"statistics_level1", ".pt file with mean and var of level 1"}, statistics_level1);
  visitor.text({"special_statistics_level0", "the same of special tokens"}, special_statistics_level0);
  visitor.text({"special_statistics_level1", "the same of special tokens"}, special_statistics_level1);
  visitor.text(
      {"description",
       "model.yaml that describes the weights; empty: that of --out, or the published model of the backbone"},
      description);
  visit_choice(visitor, {"weights", "copy in a PyTorch checkpoint; plain: the file is a state_dict itself"},
               weights, {"ema", "model", "plain"});
  visit_store(visitor, store);
  visit_out(visitor, out);
  visitor.boolean({"overwrite", "parts that are there already are replaced; the others stay"}, overwrite);
}

void ConversionOptions::check() const {
  check_out(out, "models/gld");
  const auto files = given_backbones(backbones);
  const bool gives_none = release.empty() && files.empty() && dpt_decoder.empty() && rgb_decoder.empty() &&
                          level1.empty() && cascade.empty() && statistics_level0.empty() &&
                          statistics_level1.empty() && special_statistics_level0.empty() &&
                          special_statistics_level1.empty();
  if (gives_none) {
    fail({"gld convert", "at least one file to convert", "none",
          "give --release, --da3, --level1, ... (see gld convert --help)"});
  }
  for (const auto& file : files) {
    if (file.published.kind == files.front().published.kind) continue;
    fail({"--" + dashed_name(files.front().published.option) + ", --" + dashed_name(file.published.option),
          "files of one backbone", "of two", "convert them into two folders"});
  }
}

}  // namespace gld
