// Internal to the emitter: names and expressions of values.
#pragma once

#include <string>

#include "emit_plan.h"

namespace nova::ir {

class ValueText {
 public:
  // `device`: the text is for compilers that have no option for wrapping integers and that divide
  // zero slowly.
  ValueText(const Program& program, const EmitPlan& plan, bool device = false)
      : p_(program), plan_(plan), device_(device) {}

  bool uniform(Value v) const { return plan_.uniform[static_cast<size_t>(v)] != 0; }
  Type type(Value v) const { return result_type(p_.instrs[static_cast<size_t>(v)].op); }
  // Returns the text for the value: a literal, a parameter or a variable.
  std::string name(Value v) const;
  // Returns the text for the value as a vector of lanes.
  std::string lanes(Value v) const;
  // Returns the C type of the value's variable.
  std::string c_type(Value v) const;
  // Returns the right side of the assignment to the value's variable. Not for loads and leaves.
  std::string expression(Value v) const;
  // Returns the text for a leaf, such as a constant.
  std::string literal(const Instr& in) const;

 private:
  const Program& p_;
  const EmitPlan& plan_;
  const bool device_;
};

}  // namespace nova::ir
