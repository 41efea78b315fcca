// <attach>: adds a body of another MJCF file, or its whole world, to the file that has the element.
#pragma once

#include "mjcf_bodies.h"

namespace novaphy::detail {

// An attached file, which stays in memory as long as its elements are used.
struct MjcfAttached {
  MjcfAttached(const MjcfContext& parent, XmlSource source);
  XmlFile file;
  MjcfContext context;
};

// Reads the bodies of an attached file below `to` into the Robot of `context`.
void attach(MjcfContext& context, const Element& e, BodyPart& to);
// Reads <contact> and <actuator> of attached files. Call this after the masses are known.
void finish_attached(MjcfContext& context);

}  // namespace novaphy::detail
