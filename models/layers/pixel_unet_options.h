#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <vector>

namespace gld {

// Of a network over the pixels of a picture.
struct PixelUnetOptions : OptionsGroup {
  // At full size, half, a quarter ...; none: the model has no such network.
  std::vector<int64_t> channels;
  // Pixels: larger pictures are looked at reduced to it, as those were that it was trained on.
  int64_t side = 112;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  bool exists() const { return !channels.empty(); }
};

}  // namespace gld
