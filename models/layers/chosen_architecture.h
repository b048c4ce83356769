#pragma once

#include "gld/base/options.h"

#include <cstddef>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// A family of architectures: its name in model.yaml, and its options with the defaults of its most common size.
template <class Architecture>
struct ArchitectureKind {
  std::string name;
  std::unique_ptr<Architecture> (*architecture)();
};

template <class Architecture, class Options>
ArchitectureKind<Architecture> architecture_kind(const std::string& name) {
  return {name, []() -> std::unique_ptr<Architecture> { return std::make_unique<Options>(); }};
}

// One of the registered families, and that family's fields. Architecture has kind() and copy(). Copies hold
// architectures of their own.
template <class Architecture>
class ChosenArchitecture : public OptionsGroup {
 public:
  using Kinds = std::vector<ArchitectureKind<Architecture>>;

  // It starts as the first of the kinds, which must outlive this.
  ChosenArchitecture(const Kinds& kinds, std::string help)
      : kinds_(&kinds), help_(std::move(help)), architecture_(kinds.front().architecture()) {}
  ChosenArchitecture(const ChosenArchitecture& other)
      : OptionsGroup(other),
        kinds_(other.kinds_),
        help_(other.help_),
        architecture_(other.architecture_->copy()) {}
  ChosenArchitecture& operator=(const ChosenArchitecture& other) {
    if (this != &other) architecture_ = other.architecture_->copy();
    return *this;
  }
  ~ChosenArchitecture() override = default;

  // Reads the kind first; the fields are then those of that kind.
  void visit(FieldVisitor& visitor) override {
    std::vector<std::string> names;
    int kind = 0;
    for (const auto& entry : *kinds_) {
      if (entry.name == architecture_->kind()) kind = static_cast<int>(names.size());
      names.push_back(entry.name);
    }
    visitor.choice({"type", help_}, kind, names);
    const auto& chosen = kinds_->at(static_cast<size_t>(kind));
    if (chosen.name != architecture_->kind()) architecture_ = chosen.architecture();
    architecture_->visit(visitor);
  }
  void check() const override { architecture_->check(); }

  const Architecture& architecture() const { return *architecture_; }
  void choose(const Architecture& architecture) { architecture_ = architecture.copy(); }
  // For who knows the family. std::bad_cast where it is another.
  template <class Options>
  Options& as() {
    return dynamic_cast<Options&>(*architecture_);
  }
  template <class Options>
  const Options& as() const {
    return dynamic_cast<const Options&>(*architecture_);
  }

 private:
  const Kinds* kinds_;
  std::string help_;
  std::unique_ptr<Architecture> architecture_;
};

}  // namespace gld
