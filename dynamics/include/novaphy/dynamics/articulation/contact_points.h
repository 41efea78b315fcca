// Contacts between trees as the collision search found them, and their surface points
// (contact_rows.h).
#pragma once

#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/articulation/pair_material.h"
#include "novaphy/dynamics/articulation/pgs.h"

namespace novaphy::articulation {

// Rigid contacts (core/sim/contacts.h). `point_id` may be null if no warm start uses it. `found`:
// the contacts were found from the state of the step, and derivatives move them with the state.
struct ContactRows {
  int32_t count = 0;
  const int32_t *shape0 = nullptr, *shape1 = nullptr, *point_id = nullptr;
  const Vec3f *point0 = nullptr, *point1 = nullptr, *normal = nullptr;
  const float *margin0 = nullptr, *margin1 = nullptr;
  bool found = false;
};

// Returns the material of a contact, with the fractions of its two shapes.
inline PairParts contact_parts(const ShapeMaterials& of, const ContactRows& c, int32_t contact) {
  return pair_parts(of, c.shape0[contact], c.shape1[contact], [](float x) { return x; });
}
inline ContactMaterial<float> contact_material(const ShapeMaterials& of, const ContactRows& c,
                                               int32_t contact) {
  return pair_material(of, contact_parts(of, c, contact), c.shape0[contact], c.shape1[contact]);
}

struct ContactSide {
  int32_t tree = -1, link = -1;  // -1: the world, or a link that no dof moves
};

// Returns the surface point of a side. tree_of(i): tree i. On GPUs a null pointer to the link of
// the world fails (note 0023), so the world has its own branch.
template <class TreeOf>
SurfacePoint<float> side_point(const TreeOf& tree_of, const ContactSide& side, const Vec3f& core,
                               const Vec3f& out) {
  if (side.tree < 0) return world_point(core, out);
  return surface_point(tree_of(side.tree).ws.links[side.link], core, out);
}

template <class TreeOf>
void contact_points(const ContactRows& c, int32_t contact, const ContactSide* sides,
                    const TreeOf& tree_of, SurfacePoint<float>* points) {
  const Vec3f normal = c.normal[contact];
  points[0] = side_point(tree_of, sides[0], c.point0[contact], normal * c.margin0[contact]);
  points[1] = side_point(tree_of, sides[1], c.point1[contact], normal * -c.margin1[contact]);
}

// Returns whether a contact may touch in a step of dt; only such contacts are solved. The gap may
// be up to dt times the sum of kMoreSpeed and twice the approach speed of the points by the links'
// motions. The margin is for velocity changes in the step. A contact with a NaN gap may touch.
template <class TreeOf>
bool may_touch(const ContactRows& c, int32_t contact, const ContactSide* sides,
               const TreeOf& tree_of, float dt) {
  const Vec3f normal = c.normal[contact];
  SurfacePoint<float> points[2];
  contact_points(c, contact, sides, tree_of, points);
  const ContactPlace<float> place = contact_place(points[0], points[1], normal);
  float closing = 0.0f;
  for (int k = 0; k < 2; ++k) {
    if (sides[k].tree < 0) continue;
    const SpatialVectorf& v = tree_of(sides[k].tree).ws.links[sides[k].link].v;
    const float along = math::dot(math::motion_at(v, k == 0 ? place.a : place.b).linear, normal);
    closing += k == 0 ? along : -along;
  }
  return !(place.gap > (2.0f * math::max(closing, 0.0f) + kMoreSpeed) * dt);
}

}  // namespace novaphy::articulation
