#include "models/losses/lpips_files.h"

#include "gld/base/error.h"

namespace gld {

void LpipsFiles::visit(FieldVisitor& visitor) {
  visitor.text({"lpips_backbone", "classification network of LPIPS; empty: LPIPS is absent"}, lpips_backbone);
  visitor.text({"lpips_heads", "published linear heads of LPIPS"}, lpips_heads);
  visitor.group({"lpips", "which LPIPS"}, lpips);
}

void LpipsFiles::check() const {
  if (lpips_backbone.empty() == lpips_heads.empty()) return;
  fail({"--lpips-backbone, --lpips-heads", "both files, or neither",
        lpips_backbone.empty() ? "only the heads" : "only the backbone", "give both files"});
}

std::shared_ptr<Lpips> load_lpips(const LpipsFiles& files, const ParameterPlacement& placement) {
  if (files.lpips_backbone.empty()) return nullptr;
  auto lpips = std::make_shared<Lpips>(files.lpips, placement);
  load_lpips(*lpips, *WeightFile::open(files.lpips_backbone), *WeightFile::open(files.lpips_heads));
  return lpips;
}

}  // namespace gld
