// <attach>: a body of another file, or all of its world, becomes a part of this one.
#pragma once

#include "mjcf_bodies.h"

namespace novaphy::detail {

// The other file, as long as its elements are in use.
struct MjcfAttached {
  MjcfAttached(const MjcfContext& parent, XmlSource source);
  XmlFile file;
  MjcfContext context;
};

// Reads the bodies into the Robot of `context`, below `to`.
void attach(MjcfContext& context, const Element& e, BodyPart& to);
// <contact> and <actuator> of what is attached, once the masses are known.
void finish_attached(MjcfContext& context);

}  // namespace novaphy::detail
