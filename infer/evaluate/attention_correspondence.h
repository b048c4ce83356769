#pragma once

#include "gld/report/plot.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/request/sampling_scene.h"

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// How well the queries of a DiT block find the keys of the same place in other views (CAMEO; GLD's Fig. 14).
struct AttentionCorrespondence {
  std::string stage;  // "M1"
  int64_t block = 0;  // counted over the model, the condition encoder's first
  bool in_encoder = false;
  double time = 0;  // flow time
  double pck =
      0;  // percent (gld/metrics/correspondence_metrics.h), mean over the pairs of the first view with the others
};

// Returns this for every generator and block at each time: queries and keys are taken as attention multiplies them
// (after normalisation and PRoPE), heads one after the other, of the patch tokens; the state is the scene's own latent
// on the straight path to the noise of that seed. The result is empty where a target has no picture, a view no true
// depth, or no pair of views a point.
std::vector<AttentionCorrespondence> attention_correspondence(const EvaluationModels& models,
                                                              const SamplingScene& scene,
                                                              const std::vector<double>& times,
                                                              int64_t noise_seed);

// These make the record of a scene and read it back. Reading throws nlohmann::json::exception for something else.
nlohmann::ordered_json attention_record(const std::vector<AttentionCorrespondence>& scene);
std::vector<AttentionCorrespondence> attention_from_record(const nlohmann::json& record);

// Returns attention_pck.csv, which has a row a stage, block and time: the means with intervals over scenes.
std::string attention_csv(const std::vector<std::vector<AttentionCorrespondence>>& scenes);
// Draws a panel a stage, with PCK against the block, a line a time.
Figure attention_picture(const std::vector<std::vector<AttentionCorrespondence>>& scenes);

}  // namespace gld
