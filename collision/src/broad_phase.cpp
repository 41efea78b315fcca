#include "novaphy/collision/broad_phase.h"

#include "novaphy/core/error.h"

namespace novaphy {

BroadPhase parse_broad_phase(std::string_view name) {
  if (name == "explicit") return BroadPhase::Explicit;
  if (name == "nxn") return BroadPhase::NxN;
  if (name == "sap") return BroadPhase::Sap;
  fail(ErrorKind::Value, "broad_phase: expected \"explicit\", \"nxn\" or \"sap\", got \"", name,
       "\"");
}

const char* broad_phase_name(BroadPhase broad_phase) {
  switch (broad_phase) {
    case BroadPhase::Explicit:
      return "explicit";
    case BroadPhase::NxN:
      return "nxn";
    case BroadPhase::Sap:
      return "sap";
  }
  return "unknown";
}

}  // namespace novaphy
