#include "train/loop/resumable_checkpoint.h"

#include "gld/base/error.h"
#include "gld/base/option_differences.h"

#include <algorithm>

#include <torch/types.h>

namespace gld {

void check_resumable(const Checkpoint& checkpoint, const Checkpoint& like, const std::string& kind_of_run,
                     const std::string& where) {
  const auto& state = checkpoint.metadata;
  const std::string remedy = "resume with the options that wrote the checkpoint";
  const auto has_kind = state.is_object() && state.contains("kind") && state["kind"].is_string();
  const std::string kind = has_kind ? state["kind"].get<std::string>() : "nameless";
  if (kind != kind_of_run) {
    fail({where, "a checkpoint of a " + kind_of_run + " run", "one of a " + kind + " run",
          "name the folder of the run to resume"});
  }
  for (const char* name : {"batch_index", "skipped_steps", "skipped_in_a_row"}) {
    const auto found = state.find(name);
    if (found == state.end() || !found->is_number_integer() || found->get<int64_t>() < 0) {
      fail({where, std::string("a count '") + name + "'", "none", remedy});
    }
  }
  for (const char* name : {"loss", "seconds", "best"}) {
    const auto found = state.find(name);
    const bool may_be_null = std::string(name) == "best";  // before the first validation
    if (found == state.end() || !(found->is_number() || (may_be_null && found->is_null()))) {
      fail({where, std::string("a number '") + name + "'", "none", remedy});
    }
  }
  for (const auto& [name, expected] : like.tensors) {
    const auto found = checkpoint.tensors.find(name);
    const auto text = [](const torch::Tensor& tensor) {
      return "shape " + c10::str(tensor.sizes()) + " in " + c10::toString(tensor.scalar_type());
    };
    if (found == checkpoint.tensors.end()) {
      if (name.rfind(kUntrainedTensors, 0) == 0) continue;  // of a program of before
      fail({where, "tensor '" + name + "' of " + text(expected), "none of that name", remedy});
    }
    if (found->second.sizes() != expected.sizes() || found->second.scalar_type() != expected.scalar_type()) {
      fail({where, "tensor '" + name + "' of " + text(expected), text(found->second), remedy});
    }
  }
}

void check_same_model(const Checkpoint& checkpoint, const OptionsGroup& model, const OptionsGroup* defaults,
                      const std::vector<std::string>& may_change, const std::string& where) {
  const auto& state = checkpoint.metadata;
  const auto found = state.find("model");
  if (found == state.end() || !found->is_string()) return;  // of a program of before
  for (const auto& difference : differences_from(found->get<std::string>(), where, model, defaults)) {
    const std::string key = "model." + difference.key;
    if (difference.key == "name" ||
        std::find(may_change.begin(), may_change.end(), key) != may_change.end()) {
      continue;
    }
    fail({"--resume",
          "the model.yaml that the run was begun with (" + difference.key + " " + difference.before + ")",
          difference.now, "leave it as it was, or allow it with --may-change " + key});
  }
}

void check_same_parts(const Checkpoint& checkpoint, const std::map<std::string, std::string>& parts,
                      const std::string& where) {
  const auto& state = checkpoint.metadata;
  const auto begun_on = state.find("trained_on");
  if (begun_on == state.end() || !begun_on->is_object()) return;  // of a program of before
  for (const auto& [name, hash] : parts) {
    const auto before = begun_on->find(name);
    if (before == begun_on->end() || *before == hash) continue;
    fail({"--resume", "the " + name + " that " + where + " was trained on", "another " + name + " in --model",
          "give the model that the run was begun with, or go on beside another one with --allow-mixed"});
  }
}

}  // namespace gld
