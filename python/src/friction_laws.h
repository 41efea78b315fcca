// The names of the friction laws of rigid contacts.
#pragma once

#include <string>

#include "novaphy/core/error.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy::python {

struct NamedLaw {
  const char* name;
  FrictionLaw law;
};
inline constexpr NamedLaw kFrictionLaws[] = {{"viscous", FrictionLaw::Viscous},
                                             {"huber", FrictionLaw::Huber},
                                             {"newton17", FrictionLaw::Newton17},
                                             {"newton18", FrictionLaw::Newton18}};

inline FrictionLaw to_friction_law(const std::string& name) {
  for (const NamedLaw& known : kFrictionLaws)
    if (name == known.name) return known.law;
  fail(ErrorKind::Value,
       "friction_law: expected \"viscous\", \"huber\", \"newton17\" or \"newton18\", got \"", name,
       "\"");
}
inline const char* friction_law_name(FrictionLaw law) {
  for (const NamedLaw& known : kFrictionLaws)
    if (law == known.law) return known.name;
  return "";
}

}  // namespace novaphy::python
