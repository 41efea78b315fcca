// The gradient of a contact's rows by q, for the adjoint (contact_adjoint.h):
//   -lambda . (J of p) + (B^T z) . (J of v')
// A rotation of all descendants of link i by S_k changes a motion T of link b by S_k x (T_b - T_i).
// In addition, the midpoint, the axes and the gap move with the two bodies:
//   held       ("frozen") core points are fixed in their bodies and axes in the world; the midpoint
//              moves with the mean of both points
//   follows    the point on the plane moves along the plane below the other point
//   turns      moving contact point, turning_contacts.h
// Source: Featherstone (2008), section 3.3, for motions.
#pragma once

#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/articulation/step_vjp.h"
#include "novaphy/dynamics/articulation/turning_contacts.h"

namespace novaphy::articulation {

struct AdjointContact : IslandContact {
  Vec3f z{};             // multipliers of the contact's equations
  Vec3f pull{};          // B^T z, along n, t1, t2
  float shift_z = 0.0f;  // multiplier y of its shift (contact_adjoint.h)
  float by_impulse[3] = {};  // J M^-1 g: the gradient by its impulses, along n, t1, t2
  ContactTurning turning{};
};

// Computes the spatial velocity of each link for three vectors of joint rates, after
// step_vjp_solve: `w` for its solution lambda, `a_adjoint` for `rates`, the rates after the impulses, and `v` for
// qd.
inline void set_contact_motions(const Tree<float>& tree, const float* rates, Workspace<float>& ws,
                                const AdjointMemory<float>& memory) {
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const Link& link = tree.links[i];
    LinkState<float>& to = ws.links[i];
    to.w = joint_motion(tree, link, ws.axes, memory.scratch);
    to.a_adjoint = joint_motion(tree, link, ws.axes, rates);
    if (link.parent < 0) continue;
    to.w = ws.links[link.parent].w + to.w;
    to.a_adjoint = ws.links[link.parent].a_adjoint + to.a_adjoint;
  }
}

// Signs of the two sides in a row. 0: the side is not in the row, but its motion moves the
// midpoint.
struct RowSigns {
  float of[2] = {-1.0f, 1.0f};
};
// The inputs of a row's derivative. forces: along the motions w, a_adjoint and v of the row's
// links. The remaining members are the derivative by the position of the contact: a force (`linear`
// at `at`) and a torque on the pose of each side.
struct RowGeometry {
  Vec3f forces[3] = {};
  SpatialVectorf motions[2][3] = {};
  SpatialVectorf pulls[2] = {};
  Vec3f at[2] = {};
};

// Sets the forces of a moving contact point. `by_point`: derivative by its midpoint.
template <class Geometry>
void turn_row(const AdjointContact& row, float dt, const RowSigns& signs, const Vec3f& by_point,
              Geometry& g) {
  const Vec3f points[2] = {row.place.a, row.place.b};
  Vec3f moved[3] = {};  // the motions that J acts on
  for (int side = 0; side < 2; ++side)
    for (int f = 0; f < 3; ++f)
      moved[f] =
          moved[f] + math::motion_at(g.motions[side][f], points[side]).linear * signs.of[side];
  const float pull[3] = {row.pull.x, row.pull.y, row.pull.z};
  Vec3f by_axes[3];
  for (int r = 0; r < 3; ++r)
    by_axes[r] = moved[1] * pull[r] - moved[0] * (row.solver.impulse[r] / dt);
  const float bounce = row.z.x * row.target.bounce + row.shift_z * row.target.shift_bounce;
  by_axes[0] = by_axes[0] + moved[2] * bounce;
  const TurningPulls of =
      turning_pulls(row.turning, row.frame, by_point, by_axes, row.z.x * row.target.slope);
  for (int side = 0; side < 2; ++side) {
    g.pulls[side] = of.on[side];
    g.at[side] = points[side];
  }
}

template <class TreeOf>
RowGeometry row_geometry(const AdjointContact& row, float dt, const TreeOf& tree_of,
                         const RowSigns& signs) {
  const Vec3f* const axes = row.frame.axes;
  const auto world = [&](float x, float y, float z) {
    return axes[0] * x + (axes[1] * y + axes[2] * z);
  };
  const float* const impulse = row.solver.impulse;
  const float normal = row.z.x;
  const Vec3f push = world(impulse[0], impulse[1], impulse[2]) * (1.0f / dt);
  RowGeometry g;
  g.forces[0] = -push;
  g.forces[1] = world(row.pull.x, row.pull.y, row.pull.z);
  g.forces[2] = axes[0] * (normal * row.target.bounce + row.shift_z * row.target.shift_bounce);
  Vec3f by_point{};  // derivative of the sum by the midpoint, halved
  for (int side = 0; side < 2; ++side) {
    const ContactSide& at = row.sides[side];
    if (at.tree < 0 || signs.of[side] == 0.0f) continue;
    const LinkState<float>& s = tree_of(at.tree).ws.links[at.link];
    const SpatialVectorf of[3] = {s.w, s.a_adjoint, s.v};
    for (int f = 0; f < 3; ++f) {
      g.motions[side][f] = of[f];
      by_point = by_point + math::cross(g.forces[f], of[f].angular) * (0.5f * signs.of[side]);
    }
  }
  if (row.turning.is_exact) {
    turn_row(row, dt, signs, by_point * 2.0f, g);
    return g;
  }
  if (row.follows) by_point = by_point * 2.0f - axes[0] * math::dot(axes[0], by_point);
  for (int side = 0; side < 2; ++side) {
    g.pulls[side].linear = by_point + axes[0] * (signs.of[side] * normal * row.target.slope);
    g.at[side] = row.cores[side];
  }
  return g;
}

// Adds a row's derivative by q at constant multipliers, and a bounce's by qd, to the gradients of
// its trees. tree_of(i): an IslandTree. memory_of(i): an AdjointMemory.
template <class TreeOf, class MemoryOf>
void add_contact_geometry(const AdjointContact& row, float dt, const TreeOf& tree_of,
                          const MemoryOf& memory_of, const RowSigns& signs = {}) {
  const RowGeometry g = row_geometry(row, dt, tree_of, signs);
  const Vec3f points[2] = {row.place.a, row.place.b};
  const Vec3f bounce = g.forces[2];
  for (int side = 0; side < 2; ++side) {
    const ContactSide& at = row.sides[side];
    if (at.tree < 0) continue;
    const float sign = signs.of[side];
    const IslandTree of = tree_of(at.tree);
    const Tree<float>& tree = of.tree;
    const AdjointMemory<float> memory = memory_of(at.tree);
    for (int32_t i = at.link; i >= 0; i = tree.links[i].parent) {
      const Link& link = tree.links[i];
      const LinkState<float>& s = of.ws.links[i];
      const SpatialVectorf own[3] = {s.w, s.a_adjoint, s.v};
      // The rates of a FREE joint refer to its center of mass, which moves with the translation and
      // with body_com. The contribution uses the joint's own rotation without that of its parent.
      Vec3f turning[3] = {};
      if (is_free(link) && sign != 0.0f) {
        Vec3f by_com{};
        for (int f = 0; f < 3; ++f) {
          turning[f] = own[f].angular;
          if (link.parent >= 0) {
            const LinkState<float>& parent = of.ws.links[link.parent];
            const SpatialVectorf& carried = f == 0   ? parent.w
                                            : f == 1 ? parent.a_adjoint
                                                     : parent.v;
            turning[f] = turning[f] - carried.angular;
          }
          by_com = by_com + math::cross(turning[f], g.forces[f]);
        }
        memory.moved_com[i] = memory.moved_com[i] - math::rotate_inverse(s.q, by_com * sign);
      }
      for (int32_t j = 0; j < link.dofs; ++j) {
        const int32_t k = local_dof(tree, link) + j;
        const SpatialVectorf& axis = of.ws.axes[k];
        float sum = math::dot(g.pulls[side].linear, math::motion_at(axis, g.at[side]).linear);
        if (row.turning.is_exact) sum += math::dot(g.pulls[side].angular, axis.angular);
        for (int f = 0; sign != 0.0f && f < 3; ++f) {
          SpatialVectorf d = math::cross_motion(axis, g.motions[side][f] - own[f]);
          if (is_free(link) && j < 3) d.linear = d.linear + math::cross(axis.linear, turning[f]);
          sum += sign * math::dot(g.forces[f], math::motion_at(d, points[side]).linear);
        }
        memory.tangent[k] -= sum;
        if (!(row.target.bounce > 0.0f)) continue;
        const bool held = has(of.ws.branch[k], kVelocityClamped);
        (held ? memory.bounce : memory.rate)[k] -=
            sign * math::dot(bounce, math::motion_at(axis, points[side]).linear);
      }
    }
  }
}

}  // namespace novaphy::articulation
