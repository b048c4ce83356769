#pragma once

#include "gld/base/options.h"

#include <string>
#include <vector>

namespace gld {

// Work of a DiT^DH that can be left out with the same result up to rounding. Each can be switched off, so that it
// can be measured and checked.
struct ExactSavings : OptionsGroup {
  bool camera_embedding_once = true;    // patch embedding of the camera conditioning, once a scene
  bool source_embedding_once = true;    // source-feature half of the patch embedders, once a scene
  bool shared_noisy_embedding = true;   // noisy half of the patch embedders, once for both branches
  bool cascade_input_once = true;       // the cascade's condition encoder input, once a scene
  bool encoder_reuse = true;            // the cascade's condition encoder output, again at an equal flow time
  bool time_rows_once = true;           // time embedding and encoder AdaLN, one row for all views
  bool prope_tables_once = true;        // PRoPE matrices and rotations, once a scene
  bool unconditional_constants = true;  // two camera embedding rows and one folded PRoPE matrix
  bool combined_last_linear = true;     // both branches combined before the last linear layer

  void visit(FieldVisitor& visitor) override;
};

// Returns the names that --no-skip accepts, in the order above.
std::vector<std::string> exact_saving_names();

// Switches one off. Throws Error naming the nearest valid name.
void disable_exact_saving(ExactSavings& savings, const std::string& name);

}  // namespace gld
