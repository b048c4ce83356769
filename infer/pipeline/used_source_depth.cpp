#include "infer/pipeline/used_source_depth.h"

#include <memory>
#include <optional>
#include <utility>

namespace gld {

PhotographDepth used_source_depth(const PipelineModels& models, const PhotographUse& use, const Views& views,
                                  const torch::Tensor& source_images, const SourcePhotographs& photographs,
                                  const GeometryOutput* head, double single_source_unit) {
  // Not loaded for what it has no part in: nothing of one photograph is matched.
  std::shared_ptr<DepthRefinement> refinement;
  if (use.refines() && views.num_sources > 1) refinement = models.depth_refinement();
  PhotographDepthOptions options;
  options.stereo = use.matches() ? std::optional(use.stereo) : std::nullopt;
  options.refinement = refinement.get();
  options.single_source_unit = single_source_unit;
  // A model that takes the head's depth as it is was trained on that.
  options.follows_edges = use.matches();
  PhotographDepth found = photograph_depth(views, source_images, photographs, head, options);
  if (use.depth_error > 0) found.depth = with_depth_error(std::move(found.depth), use.depth_error);
  return found;
}

}  // namespace gld
