// The names of the contact options of SolverFeatherstone.
#pragma once

#include <optional>
#include <string>

#include "convert.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy::python {

inline constexpr const char* kContacts[] = {nullptr, "pgs", "penalty"};  // by ArticulationContact
inline constexpr const char* kCones[] = {"cone", "pyramid"};             // by FrictionCone

inline ArticulationContact to_contact(const std::optional<std::string>& name) {
  if (!name) return ArticulationContact::None;
  for (size_t i = 1; i < std::size(kContacts); ++i)
    if (*name == kContacts[i]) return static_cast<ArticulationContact>(i);
  fail(ErrorKind::Value, "contact: expected \"pgs\", \"penalty\" or None, got \"", *name, "\"");
}
inline FrictionCone to_cone(const std::string& name) {
  for (size_t i = 0; i < std::size(kCones); ++i)
    if (name == kCones[i]) return static_cast<FrictionCone>(i);
  fail(ErrorKind::Value, "friction_cone: expected \"cone\" or \"pyramid\", got \"", name, "\"");
}
inline constexpr const char* kLimits[] = {"spring", "row"};  // by JointLimits
inline JointLimits to_limits(const char* user, const std::string& name) {
  for (size_t i = 0; i < std::size(kLimits); ++i)
    if (name == kLimits[i]) return static_cast<JointLimits>(i);
  fail(ErrorKind::Value, user, ": joint_limits: expected \"spring\" or \"row\", got \"", name,
       "\"");
}
inline const char* limits_name(JointLimits limits) { return kLimits[static_cast<size_t>(limits)]; }
inline std::optional<std::string> contact_name(ArticulationContact contact) {
  const char* const name = kContacts[static_cast<size_t>(contact)];
  if (name == nullptr) return {};
  return name;
}

}  // namespace novaphy::python
