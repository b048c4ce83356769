#include "models/backbones/backbone_registry.h"

#include "models/backbones/autoencoder_kl.h"
#include "models/backbones/da3_backbone.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/backbones/tiny_autoencoder.h"
#include "models/backbones/vggt_backbone.h"

namespace gld {

const std::vector<BackboneKind>& backbone_kinds() {
  static const std::vector<BackboneKind> kinds = {
      architecture_kind<BackboneArchitecture, Da3BackboneOptions>("da3"),
      architecture_kind<BackboneArchitecture, VggtBackboneOptions>("vggt"),
      architecture_kind<BackboneArchitecture, Dinov2Options>("dinov2"),
      architecture_kind<BackboneArchitecture, AutoencoderKlOptions>("autoencoder_kl"),
      architecture_kind<BackboneArchitecture, TinyAutoencoderOptions>("tiny_autoencoder"),
  };
  return kinds;
}

BackboneOptions::BackboneOptions() : ChosenArchitecture(backbone_kinds(), "family of the backbone") {}

BackboneOptions::BackboneOptions(const BackboneArchitecture& architecture) : BackboneOptions() {
  choose(architecture);
}

}  // namespace gld
