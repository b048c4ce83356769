#include "models/backbones/backbone_registry.h"

#include "models/backbones/da3_backbone.h"

namespace gld {
namespace {

template <class Architecture>
std::unique_ptr<BackboneArchitecture> with_defaults() {
  return std::make_unique<Architecture>();
}

}  // namespace

const std::vector<BackboneKind>& backbone_kinds() {
  static const std::vector<BackboneKind> kinds = {
      {"da3", with_defaults<Da3BackboneOptions>},
  };
  return kinds;
}

BackboneOptions::BackboneOptions() : architecture_(backbone_kinds().front().architecture()) {}

BackboneOptions::BackboneOptions(const BackboneArchitecture& architecture)
    : architecture_(architecture.copy()) {}

BackboneOptions::BackboneOptions(const BackboneOptions& other)
    : OptionsGroup(other), architecture_(other.architecture_->copy()) {}

BackboneOptions& BackboneOptions::operator=(const BackboneOptions& other) {
  if (this != &other) architecture_ = other.architecture_->copy();
  return *this;
}

void BackboneOptions::visit(FieldVisitor& visitor) {
  std::vector<std::string> names;
  int kind = 0;
  for (const auto& entry : backbone_kinds()) {
    if (entry.name == architecture_->kind()) kind = static_cast<int>(names.size());
    names.push_back(entry.name);
  }
  visitor.choice({"type", "family of the backbone"}, kind, names);
  const auto& chosen = backbone_kinds().at(static_cast<size_t>(kind));
  if (chosen.name != architecture_->kind()) architecture_ = chosen.architecture();
  architecture_->visit(visitor);
}

}  // namespace gld
