// Islands: trees that touch each other, directly or through other trees, with their contacts and
// the dry friction of their joints. The contacts of an island are solved together (pgs.h). The
// solver on the host and the device kernel (articulation_contact_kernels.h) share this source, each
// with its own memory and lists of rows. The code of tree_contacts.h solves a tree that touches
// only the world and has no dry friction.
#pragma once

#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/articulation/contact_points.h"
#include "novaphy/dynamics/articulation/pair_material.h"
#include "novaphy/dynamics/articulation/pgs.h"
#include "novaphy/dynamics/articulation/tree_contacts.h"

namespace novaphy::articulation {

inline constexpr int32_t kMostTreeContacts = 64;

// Returns the padded number of dofs that rates and rows of a tree have.
inline int32_t padded_dofs(int32_t dofs) { return (dofs + 3) / 4 * 4; }

// Returns whether impulses move the tree of a side. `trees`: rows with `moves` and `dof_count`.
template <class TreeRows>
bool moves(const TreeRows* trees, const ContactSide& side) {
  return side.tree >= 0 && trees[side.tree].moves != 0;
}
// Returns the first of a contact's trees that impulses move. The contact belongs to the island of
// that tree.
template <class TreeRows>
int32_t moved_tree(const TreeRows* trees, const ContactSide* sides) {
  return sides[moves(trees, sides[0]) ? 0 : 1].tree;
}
// Sets the widths of a contact's rows (padded dofs). Returns false if the contact moves nothing.
template <class TreeRows>
bool set_widths(const TreeRows* trees, const ContactSide* sides, int32_t* widths) {
  for (int side = 0; side < 2; ++side)
    widths[side] = sides[side].tree < 0 ? 0 : padded_dofs(trees[sides[side].tree].dof_count);
  if (sides[0].tree == sides[1].tree) widths[1] = 0;  // side 0 then has the rows of both sides
  return moves(trees, sides[0]) || moves(trees, sides[1]);
}

// Returns whether a contact makes its island coupled: it connects two trees, or a tree with too
// many `dofs` for tree_contacts.h. An island is also coupled with more than kMostTreeContacts
// contacts, or with dry friction.
inline bool couples_trees(const ContactSide* sides, int32_t dofs) {
  return (sides[0].tree >= 0 && sides[1].tree >= 0) || dofs > kTreeContactDofs;
}

// Returns the root of a tree's island: the tree with the smallest index in the island.
// root_of(tree) is a tree nearer to the root (union-find).
template <class RootOf>
int32_t find_root(const RootOf& root_of, int32_t tree) {
  while (root_of(tree) != tree) {
    int32_t& up = root_of(tree);
    up = root_of(up);
    tree = up;
  }
  return tree;
}
template <class RootOf>
void join_trees(const RootOf& root_of, int32_t tree, int32_t other) {
  const int32_t a = find_root(root_of, tree), b = find_root(root_of, other);
  root_of(a < b ? b : a) = a < b ? a : b;
}

// The impulses of a contact point (N s), for the warm start of the next step.
struct KeptContact {
  int32_t shape0 = 0, shape1 = 0, point = 0;
  float normal = 0.0f;  // 0: not used for a warm start
  Vec3f tangent = {};
};
inline KeptContact kept_contact(const ContactRows& c, int32_t contact,
                                const ContactFrame<float>& frame, const float* impulse) {
  const Vec3f tangent = frame.axes[1] * impulse[1] + frame.axes[2] * impulse[2];
  return {c.shape0[contact], c.shape1[contact], c.point_id == nullptr ? -1 : c.point_id[contact],
          impulse[0], tangent};
}
// Returns the mean force of a step on side B (N).
inline Vec3f contact_force(const ContactFrame<float>& frame, const KeptContact& of, float dt) {
  return (frame.axes[0] * of.normal + of.tangent) * (1.0f / dt);
}

// Returns the index of the same contact point in the impulses of the step before, or -1. Both lists
// are sorted by shapes. `next`: search position, initially 0, then the last found pair.
inline int32_t find_kept(const KeptContact* kept, int32_t count, int32_t& next,
                         const ContactRows& c, int32_t contact) {
  const int32_t a = c.shape0[contact], b = c.shape1[contact];
  while (next < count &&
         (kept[next].shape0 < a || (kept[next].shape0 == a && kept[next].shape1 < b)))
    ++next;
  for (int32_t i = next; i < count && kept[i].shape0 == a && kept[i].shape1 == b; ++i)
    if (kept[i].point == c.point_id[contact] && kept[i].normal > 0.0f) return i;
  return -1;
}

// Returns whether the point of a shape that touches a plane is fixed to the shape: a sphere's
// center, a capsule's end or a corner.
inline bool meets_planes_in_points(int32_t shape_type) {
  const ShapeTraits traits = shape_traits(static_cast<GeoType>(shape_type));
  return traits.plane_contacts > 0 && !traits.is_curved;
}
// Returns IslandContact::follows: whether a point fixed to its shape touches a plane of the world.
inline bool follows_plane(const ContactRows& c, const int32_t* shape_type, int32_t contact,
                          const ContactSide* sides) {
  const int32_t types[2] = {shape_type[c.shape0[contact]], shape_type[c.shape1[contact]]};
  bool follows = false;
  for (int side = 0; c.found && side < 2; ++side)
    follows =
        follows || (sides[side].tree < 0 && types[side] == static_cast<int32_t>(GeoType::PLANE) &&
                    meets_planes_in_points(types[1 - side]));
  return follows;
}

// The data of a tree that the contact rows of an island read and change.
struct IslandTree {
  Tree<float> tree;
  Workspace<float> ws;  // after free_rates
  float* rates;         // {2, padded_dofs}: ws.qd_next, which contacts change, and the shifts;
                        // padded with zeros
  const float* qd;      // rates before the step
  bool moves;           // whether impulses move the tree
};

// A contact of an island. `contact`: its row in Contacts. The widths come from set_widths.
struct IslandContact {
  int32_t contact = 0;
  ContactSide sides[2] = {};
  ContactFrame<float> frame = {};
  ContactPlace<float> place = {};
  Vec3f cores[2] = {};  // relative to the origins
  float before = 0.0f;  // J_n qd
  NormalTarget<float> target = {};
  PgsContact<float> solver = {};
  // Used for derivatives (active_rows.h): the contact was found from the state of the step, between
  // a point fixed to its shape and a plane of the world. The normal is then constant, and the point
  // on the plane is the projection of the other point.
  bool follows = false;
  bool turns = false;        // moving contact point (turning_contacts.h)
  bool elastic = false;      // whether the contact has restitution
  float* numbers = nullptr;  // {6, widths of both sides}: per side J, then Y = M^-1 J^T
  bool whole = false;        // whether build_responses was called
};

// Returns whether a contact has an impulse or a shift.
inline bool pushes(const IslandContact& row) {
  return row.solver.impulse[0] > 0.0f || row.solver.shifted > 0.0f;
}

// Computes the points and the frame of a contact, and its Jacobian J in row.numbers.
template <class TreeOf>
void build_jacobian(const ContactRows& c, const TreeOf& tree_of, IslandContact& row) {
  const int32_t i = row.contact;
  const Vec3f normal = c.normal[i];
  SurfacePoint<float> points[2];
  contact_points(c, i, row.sides, tree_of, points);
  for (int side = 0; side < 2; ++side) {
    const Vec3f core = side == 0 ? c.point0[i] : c.point1[i];
    row.cores[side] = side_point(tree_of, row.sides[side], core, Vec3f{}).at;
  }
  const ContactPlace<float> place = contact_place(points[0], points[1], normal);
  row.place = place;
  row.frame = contact_frame(normal);
  const bool itself = row.sides[0].tree == row.sides[1].tree;
  float before = 0.0f;
  float* jacobian = row.numbers;
  for (int side = 0; side < 2; ++side) {
    RowSide<float>& to = row.solver.sides[side];
    if (to.width == 0) continue;
    const IslandTree of = tree_of(row.sides[side].tree);
    for (int32_t k = 0; k < 3 * to.width; ++k) jacobian[k] = 0.0f;
    add_point_rows(of.tree, of.ws.axes, row.sides[side].link, side == 0 ? place.a : place.b,
                   row.frame, side == 0 ? -1.0f : 1.0f, to.width, jacobian);
    if (itself)
      add_point_rows(of.tree, of.ws.axes, row.sides[1].link, place.b, row.frame, 1.0f, to.width,
                     jacobian);
    to.rates = of.rates;
    to.jacobian = jacobian;
    for (int32_t k = 0; k < of.tree.dof_count; ++k) before += jacobian[k] * of.qd[k];
    jacobian += 6 * to.width;
  }
  row.before = before;
}

// Computes the responses Y of a contact, after build_jacobian.
template <class TreeOf>
void build_responses(const ContactRows& c, const TreeOf& tree_of, IslandContact& row) {
  row.whole = true;
  const bool itself = row.sides[0].tree == row.sides[1].tree;
  row.solver.mass = 0.0f;
  float* jacobian = row.numbers;
  for (int side = 0; side < 2; ++side) {
    RowSide<float>& to = row.solver.sides[side];
    if (to.width == 0) continue;
    const IslandTree of = tree_of(row.sides[side].tree);
    float* const response = jacobian + 3 * to.width;
    const int32_t last = itself ? -1 : last_dof(of.tree, row.sides[side].link);
    if (of.moves) response_rows(of.tree, of.ws, last, to.width, jacobian, response);
    to.response = of.moves ? response : nullptr;
    row.solver.mass += parted_mass(of.tree, of.ws, row.sides);
    jacobian += 6 * to.width;
  }
  set_diagonals(row.solver);
  const RowSide<float>& inner = row.solver.sides[0];
  if (itself && inner.response != nullptr) {
    const IslandTree of = tree_of(row.sides[0].tree);
    row.solver.apart += shared_in_tree(of.tree, of.ws, row.sides[0].link, row.place.a,
                                       c.normal[row.contact], inner.response);
  }
}
template <class TreeOf>
void build_contact(const ContactRows& c, const TreeOf& tree_of, float* numbers,
                   IslandContact& row) {
  row.numbers = numbers;
  build_jacobian(c, tree_of, row);
  build_responses(c, tree_of, row);
}

// Sets beta of a contact's normal row, after build_jacobian and at the rates without impulses.
inline void aim(const ContactLaw<float>& law, const ContactMaterial<float>& material,
                IslandContact& row) {
  row.target = normal_target(law, material, row.place.gap, row.before, slip(row.solver, 0));
  row.solver.bias = row.target.bias;
  row.solver.shift = row.target.shift;
  row.solver.cfm = row.target.cfm;
  row.solver.friction = material.friction;
  row.elastic = material.restitution > 0.0f;
}
// Sets beta of a contact's normal row, after build_contact.
inline void set_target(const ContactLaw<float>& law, const ContactMaterial<float>& material,
                       IslandContact& row) {
  aim(law, material, row);
  set_steps<float>(law.dt, row.solver);
}

// Starts from the impulses of the step before, times `scale` (a change of dt).
inline void start_from_kept(const KeptContact& kept, float scale, bool cone, IslandContact& row) {
  const Vec3f tangent = kept.tangent * scale;
  warm_start(row.solver, cone, kept.normal * scale, math::dot(tangent, row.frame.axes[1]),
             math::dot(tangent, row.frame.axes[2]));
}

// Builds the row of a dof's dry friction, with its `response` {padded_dofs}. `limit`: friction dt.
inline void build_friction(const IslandTree& of, int32_t dof, float limit, float* response,
                           PgsJointFriction<float>& row) {
  const int32_t width = padded_dofs(of.tree.dof_count);
  for (int32_t k = 0; k < width; ++k) response[k] = 0.0f;
  response[dof] = 1.0f;
  solve(of.tree, of.ws, response);
  row.rates = of.rates;
  row.response = response;
  row.width = width;
  row.dof = dof;
  row.limit = limit;
  row.impulse = 0.0f;
  // At a velocity limit the rate is fixed, and friction only changes the force of that limit.
  if (response[dof] == 0.0f && of.rates[dof] != 0.0f)
    row.impulse = of.rates[dof] > 0.0f ? -limit : limit;
}

struct IslandResult {
  int32_t sweeps = 0;
  float residual = 0.0f;  // m/s, largest change of velocity in the last sweep
  float largest = 0.0f;   // m/s, largest impulse as a velocity
};
// Stores the rates of a tree in qd_next and qdd, and sets its shifts. Returns the first dof whose
// rate or shift is not finite, or -1. The function stops at that dof.
inline int32_t take_rates(float* rates, const float* qd, float dt, int32_t dofs,
                          Workspace<float>& ws) {
  ws.shift = rates + padded_dofs(dofs);
  for (int32_t k = 0; k < dofs; ++k) {
    if (!has_finite_square(rates[k]) || !has_finite_square(ws.shift[k])) return k;
    if (rates[k] == ws.qd_next[k]) continue;
    ws.qdd[k] = (rates[k] - qd[k]) / dt;
    ws.qd_next[k] = rates[k];
  }
  return -1;
}

// Adds the impulses of a contact on the dofs of a tree (N s or N m s) to `to`. `rates` identifies
// the tree.
inline void add_impulses(const PgsContact<float>& c, const float* rates, int32_t dofs, float* to) {
  for (const RowSide<float>& s : c.sides)
    for (int32_t r = 0; s.width > 0 && s.rates == rates && r < 3; ++r)
      for (int32_t k = 0; k < dofs; ++k) to[k] += s.jacobian[r * s.width + k] * c.impulse[r];
}
// Computes the accelerations of a tree after finish_sweeps, and calls renew_branches.
template <class ForContacts, class ForFriction>
bool renew_tree(const IslandTree& of, const StepInputs<float>& in, const StepOptions<float>& how,
                int32_t round, const ForContacts& for_contacts, const ForFriction& for_friction) {
  Workspace<float> ws = of.ws;
  const int32_t dofs = of.tree.dof_count;
  if (take_rates(of.rates, of.qd, how.dt, dofs, ws) >= 0) return false;
  for (int32_t k = 0; k < dofs; ++k) ws.given[k] = 0.0f;
  if (holds_rates(of.tree, ws)) {
    for_contacts(false, [&](const IslandContact& row) {
      add_impulses(row.solver, of.rates, dofs, ws.given);
    });
    for_friction([&](const PgsJointFriction<float>& f) {
      if (f.rates == of.rates) ws.given[f.dof] += f.impulse;
    });
  }
  return renew_branches(of.tree, in, how, true, round, ws);
}
// Computes the rates without impulses again. Returns the dof that fails, or -1.
inline int32_t restart_tree(const IslandTree& of, const StepInputs<float>& in,
                            const StepOptions<float>& how) {
  Workspace<float> ws = of.ws;
  const int32_t failed = solve_accelerations(of.tree, in, how, ws);
  if (failed < 0) free_rates(of.tree, in, how, ws);
  for (int32_t k = 0; failed < 0 && k < of.tree.dof_count; ++k) of.rates[k] = ws.qd_next[k];
  const int32_t width = padded_dofs(of.tree.dof_count);
  for (int32_t k = 0; k < width; ++k) of.rates[width + k] = 0.0f;  // shifts
  return failed;
}

// Returns the dofs that move a link, as bits, for tree_contacts.h.
template <class T>
int32_t moving_dofs(const Tree<T>& tree, int32_t link) {
  uint32_t bits = 0;
  for (int32_t d = last_dof(tree, link); d >= 0; d = tree.dof_parent[d])
    if (d < kTreeContactDofs) bits |= 1u << d;
  return static_cast<int32_t>(bits);
}
// Returns the data of a contact between a tree and the world for tree_contacts.h. `moved_by`: dofs
// that move the link, as bits. `kept`: impulses for the warm start, or zeros.
inline TreeContact<float> tree_contact(const ContactRows& c, int32_t i, int32_t side,
                                       int32_t moved_by, const ContactMaterial<float>& material,
                                       const KeptContact& kept, float scale) {
  const Vec3f points[2] = {c.point0[i], c.point1[i]};
  const float margins[2] = {c.margin0[i], -c.margin1[i]};
  TreeContact<float> contact;
  contact.moved_by = moved_by;
  contact.sign = side == 0 ? -1.0f : 1.0f;
  contact.normal = c.normal[i];
  contact.core = points[side];
  contact.world = points[1 - side];
  contact.margin = margins[side];
  contact.world_margin = margins[1 - side];
  contact.material = material;
  contact.start_normal = kept.normal * scale;
  contact.start_tangent = kept.tangent * scale;
  return contact;
}

}  // namespace novaphy::articulation
