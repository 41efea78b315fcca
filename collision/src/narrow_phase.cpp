#include "novaphy/collision/narrow_phase.h"

#include "novaphy/core/error.h"

namespace novaphy {

NarrowPhase parse_narrow_phase(std::string_view name) {
  if (name == "auto") return NarrowPhase::Auto;
  if (name == "fcl") return NarrowPhase::Fcl;
  fail(ErrorKind::Value, "narrow_phase: expected \"auto\" or \"fcl\", got \"", name, "\"");
}

const char* narrow_phase_name(NarrowPhase narrow_phase) {
  return narrow_phase == NarrowPhase::Fcl ? "fcl" : "auto";
}

}  // namespace novaphy
