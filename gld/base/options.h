#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace gld {

// One options struct per component; each field is declared once, in the struct's visit(), and that one
// declaration serves YAML, JSON, the command line, --help, the range checks and the documentation.
//
//   struct SolverOptions : OptionsGroup {
//     int64_t evaluations = 16;
//     void visit(FieldVisitor& visitor) override {
//       visitor.integer({"evaluations", "function evaluations per level"}, evaluations, {1, 100000});
//     }
//   };

struct Field {
  std::string name;  // snake_case, unique in its group
  std::string help;  // one line, units included
};

struct IntegerRange {
  int64_t minimum = std::numeric_limits<int64_t>::min();
  int64_t maximum = std::numeric_limits<int64_t>::max();
};

struct RealRange {
  double minimum = -std::numeric_limits<double>::infinity();
  double maximum = std::numeric_limits<double>::infinity();
};

class FieldVisitor;

struct OptionsGroup {
  virtual ~OptionsGroup() = default;
  virtual void visit(FieldVisitor& visitor) = 0;
  // Checks relations between fields that ranges cannot express. Throws Error.
  virtual void check() const {}

 protected:
  OptionsGroup() = default;
  OptionsGroup(const OptionsGroup&) = default;
  OptionsGroup& operator=(const OptionsGroup&) = default;
};

class FieldVisitor {
 public:
  virtual ~FieldVisitor() = default;
  virtual void boolean(const Field& field, bool& value) = 0;
  virtual void integer(const Field& field, int64_t& value, const IntegerRange& range = {}) = 0;
  virtual void real(const Field& field, double& value, const RealRange& range = {}) = 0;
  virtual void text(const Field& field, std::string& value) = 0;
  // value is an index into names; files and flags use the name.
  virtual void choice(const Field& field, int& value, const std::vector<std::string>& names) = 0;
  virtual void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange& range = {}) = 0;
  virtual void reals(const Field& field, std::vector<double>& value, const RealRange& range = {}) = 0;
  virtual void texts(const Field& field, std::vector<std::string>& value) = 0;
  // A nested group; its fields are named "group.field".
  virtual void group(const Field& field, OptionsGroup& value) = 0;
};

// A choice held as an enum class whose enumerators are numbered 0, 1, ... in the order of names.
template <class Enum>
void visit_choice(FieldVisitor& visitor, const Field& field, Enum& value,
                  const std::vector<std::string>& names) {
  int index = static_cast<int>(value);
  visitor.choice(field, index, names);
  value = static_cast<Enum>(index);
}

}  // namespace gld
