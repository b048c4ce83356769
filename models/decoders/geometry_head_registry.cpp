#include "models/decoders/geometry_head_registry.h"

#include "gld/base/error.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/vggt_heads.h"

#include <string>

namespace gld {
namespace {

const std::string kNone = "none";

struct NoGeometryHead : GeometryHeadArchitecture {
  void visit(FieldVisitor& /*visitor*/) override {}
  std::string kind() const override { return kNone; }
  std::unique_ptr<GeometryHeadArchitecture> copy() const override {
    return std::make_unique<NoGeometryHead>();
  }
  std::shared_ptr<GeometryHead> make(const ParameterPlacement& /*placement*/) const override {
    fail({"geometry", "a model with a geometry head", "one whose dpt_head is of type none",
          "ask for images alone, or give gld sample a --geometry-model that looks at the generated images"});
  }
  std::string published_prefix() const override { return ""; }
  int64_t level_channels() const override { return 0; }
  int64_t patch_side() const override { return 0; }
  Cost cost(const LatentGrid& /*grid*/, GeometryMaps /*maps*/) const override { return {}; }
};

}  // namespace

const std::vector<GeometryHeadKind>& geometry_head_kinds() {
  static const std::vector<GeometryHeadKind> kinds = {
      architecture_kind<GeometryHeadArchitecture, DptHeadOptions>("da3"),
      architecture_kind<GeometryHeadArchitecture, VggtHeadsOptions>("vggt"),
      architecture_kind<GeometryHeadArchitecture, NoGeometryHead>(kNone),
  };
  return kinds;
}

GeometryHeadOptions::GeometryHeadOptions()
    : ChosenArchitecture(geometry_head_kinds(), "family of the geometry head") {}

GeometryHeadOptions::GeometryHeadOptions(const GeometryHeadArchitecture& architecture)
    : GeometryHeadOptions() {
  choose(architecture);
}

GeometryHeadOptions GeometryHeadOptions::none() { return GeometryHeadOptions(NoGeometryHead()); }

bool GeometryHeadOptions::exists() const { return architecture().kind() != kNone; }

}  // namespace gld
