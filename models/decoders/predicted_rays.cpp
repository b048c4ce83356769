#include "models/decoders/predicted_rays.h"

#include "models/decoders/vggt_heads.h"

namespace gld {

bool predicts_rays(const GeometryHeadOptions& head) {
  if (!head.exists()) return false;
  const auto* vggt = dynamic_cast<const VggtHeadsOptions*>(&head.architecture());
  return vggt == nullptr || vggt->camera_head;
}

}  // namespace gld
