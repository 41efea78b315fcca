// Internal to the emitter: names and expressions of values.
#pragma once

#include <string>

#include "emit_plan.h"

namespace nova::ir {

class ValueText {
 public:
  // `device`: for compilers without an option for wrapping integers, and with a slow division of
  // zero.
  ValueText(const Program& program, const EmitPlan& plan, bool device = false)
      : p_(program), plan_(plan), device_(device) {}

  bool uniform(Value v) const { return plan_.uniform[static_cast<size_t>(v)] != 0; }
  Type type(Value v) const { return result_type(p_.instrs[static_cast<size_t>(v)].op); }
  // Returns the text of the value: a literal, a parameter or a variable.
  std::string name(Value v) const;
  // Returns the same as a vector of lanes.
  std::string lanes(Value v) const;
  // Returns the C type of its variable.
  std::string c_type(Value v) const;
  // Returns the right side of its assignment. Not for loads and leaves.
  std::string expression(Value v) const;
  // Returns the text of a leaf.
  std::string literal(const Instr& in) const;

 private:
  const Program& p_;
  const EmitPlan& plan_;
  const bool device_;
};

}  // namespace nova::ir
