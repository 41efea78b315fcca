// Internal to the emitter: names and expressions of values.
#pragma once

#include <string>

#include "emit_plan.h"

namespace nova::ir {

class ValueText {
 public:
  // `device`: for compilers that have no option which makes integers wrap, and divide zero slowly.
  ValueText(const Program& program, const EmitPlan& plan, bool device = false)
      : p_(program), plan_(plan), device_(device) {}

  bool uniform(Value v) const { return plan_.uniform[static_cast<size_t>(v)] != 0; }
  Type type(Value v) const { return result_type(p_.instrs[static_cast<size_t>(v)].op); }
  // How the value is written: a literal, a parameter, a variable.
  std::string name(Value v) const;
  // The same as a vector of lanes.
  std::string lanes(Value v) const;
  // The C type of its variable.
  std::string c_type(Value v) const;
  // What computes it: the right side of its assignment. Not for loads and leaves.
  std::string expression(Value v) const;
  // A leaf.
  std::string literal(const Instr& in) const;

 private:
  const Program& p_;
  const EmitPlan& plan_;
  const bool device_;
};

}  // namespace nova::ir
