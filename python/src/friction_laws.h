// The names of friction_law and penalty_law for rigid contacts, and their properties.
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

inline PenaltyLaw to_penalty_law(const std::string& name) {
  if (name == "sampled") return PenaltyLaw::Sampled;
  require(name == "mean", ErrorKind::Value, "penalty_law: expected \"sampled\" or \"mean\", got \"",
          name, "\"");
  return PenaltyLaw::Mean;
}
inline const char* penalty_law_name(PenaltyLaw law) {
  return law == PenaltyLaw::Mean ? "mean" : "sampled";
}

// Binds friction_law and penalty_law of a solver as read-only properties.
template <class Solver>
void add_contact_laws(Solver& of) {
  using Type = typename Solver::type;
  of.def_property_readonly(
      "friction_law", [](const Type& s) { return friction_law_name(s.options().friction_law); },
      "The friction law: \"viscous\", \"huber\", \"newton17\" or \"newton18\".");
  of.def_property_readonly(
      "penalty_law", [](const Type& s) { return penalty_law_name(s.options().penalty_law); },
      "The law of penalty contacts: \"sampled\" or \"mean\".");
}
// Binds friction_law and penalty_law of settings. set(settings, name, member, value) assigns one.
template <class Settings, class Set>
void add_contact_laws(Settings& of, const Set& set) {
  using Type = typename Settings::type;
  of.def_property(
      "friction_law", [](const Type& s) { return friction_law_name(s.friction_law); },
      [set](Type& s, const std::string& law) {
        set(s, "friction_law", &Type::friction_law, to_friction_law(law));
      },
      "The friction law of contacts of bodies: \"viscous\" or \"huber\", see SolverSemiImplicit. "
      "\"newton17\" and \"newton18\" have no gradient and raise an error.");
  of.def_property(
      "penalty_law", [](const Type& s) { return penalty_law_name(s.penalty_law); },
      [set](Type& s, const std::string& law) {
        set(s, "penalty_law", &Type::penalty_law, to_penalty_law(law));
      },
      "The law of penalty contacts of bodies: \"sampled\" or \"mean\", see SolverSemiImplicit. The "
      "gradient of \"mean\" is that of the motion.");
}

}  // namespace novaphy::python
