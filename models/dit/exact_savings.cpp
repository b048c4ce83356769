#include "models/dit/exact_savings.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {

void ExactSavings::visit(FieldVisitor& visitor) {
  visitor.boolean({"camera_embedding_once", "embed the cameras once a scene"}, camera_embedding_once);
  visitor.boolean({"source_embedding_once", "embed the source features once a scene"}, source_embedding_once);
  visitor.boolean({"shared_noisy_embedding", "embed the noisy latent once for both branches of guidance"},
                  shared_noisy_embedding);
  visitor.boolean({"cascade_input_once", "embed the deeper level once a scene"}, cascade_input_once);
  visitor.boolean({"encoder_reuse", "use the cascade's condition encoder output again at an equal flow time"},
                  encoder_reuse);
  visitor.boolean({"time_rows_once", "one row of time embedding and modulation for all views"},
                  time_rows_once);
  visitor.boolean({"prope_tables_once", "compute the PRoPE tables once a scene"}, prope_tables_once);
  visitor.boolean({"unconditional_constants", "constant camera rows and one PRoPE matrix without cameras"},
                  unconditional_constants);
  visitor.boolean({"combined_last_linear", "combine both branches before the last linear layer"},
                  combined_last_linear);
}

std::vector<std::string> exact_saving_names() {
  std::vector<std::string> names;
  for (const auto& option : describe_options(ExactSavings())) names.push_back(option.key);
  return names;
}

void disable_exact_saving(ExactSavings& savings, const std::string& name) {
  const auto names = exact_saving_names();
  if (std::find(names.begin(), names.end(), name) == names.end()) {
    const auto near = nearest_name(name, names);
    fail({"--no-skip", fmt::format("one of {}", fmt::join(names, ", ")), "'" + name + "'",
          near.empty() ? "choose one of them" : "write '" + near + "'"});
  }
  apply_setting(savings, name, "false", "--no-skip");
}

}  // namespace gld
