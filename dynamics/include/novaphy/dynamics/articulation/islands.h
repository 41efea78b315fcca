// Islands: trees that touch each other, directly or by others, with their contacts and the dry
// friction of their joints, which are solved together (pgs.h). The solver on the host and the
// kernel of devices (articulation_contact_kernels.h) share this text; where rows are kept, and in
// which lists, is theirs.
// A tree that touches nothing but the world, without dry friction, is solved by tree_contacts.h.
#pragma once

#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/articulation/pair_material.h"
#include "novaphy/dynamics/articulation/pgs.h"
#include "novaphy/dynamics/articulation/tree_contacts.h"

namespace novaphy::articulation {

inline constexpr int32_t kMostTreeContacts = 64;

// Rigid contacts (core/sim/contacts.h). `point_id` may be null where nothing starts warm. `found`:
// the search found them from the state of the step, so that derivatives let them follow it.
struct ContactRows {
  int32_t count = 0;
  const int32_t *shape0 = nullptr, *shape1 = nullptr, *point_id = nullptr;
  const Vec3f *point0 = nullptr, *point1 = nullptr, *normal = nullptr;
  const float *margin0 = nullptr, *margin1 = nullptr;
  bool found = false;
};

// The material of a contact, and the parts that its shapes have in that.
inline PairParts contact_parts(const ShapeMaterials& of, const ContactRows& c, int32_t contact) {
  return pair_parts(of, c.shape0[contact], c.shape1[contact], [](float x) { return x; });
}
inline ContactMaterial<float> contact_material(const ShapeMaterials& of, const ContactRows& c,
                                               int32_t contact) {
  return pair_material(of, contact_parts(of, c, contact), c.shape0[contact], c.shape1[contact]);
}

struct ContactSide {
  int32_t tree = -1, link = -1;  // -1: the world, or what no dof moves
};

// Of the rates of a tree, and of its rows.
inline int32_t padded_dofs(int32_t dofs) { return (dofs + 3) / 4 * 4; }

// Whether impulses move the tree of a side; `trees`: rows with `moves` and `dof_count`.
template <class TreeRows>
bool moves(const TreeRows* trees, const ContactSide& side) {
  return side.tree >= 0 && trees[side.tree].moves != 0;
}
// The first tree of a contact that they move, whose island has it.
template <class TreeRows>
int32_t moved_tree(const TreeRows* trees, const ContactSide* sides) {
  return sides[moves(trees, sides[0]) ? 0 : 1].tree;
}
// The widths of the rows of a contact; false: it moves nothing.
template <class TreeRows>
bool set_widths(const TreeRows* trees, const ContactSide* sides, int32_t* widths) {
  for (int side = 0; side < 2; ++side)
    widths[side] = sides[side].tree < 0 ? 0 : padded_dofs(trees[sides[side].tree].dof_count);
  if (sides[0].tree == sides[1].tree) widths[1] = 0;  // one row holds both sides
  return moves(trees, sides[0]) || moves(trees, sides[1]);
}

// Whether the island of a contact is more than one tree with the world, or has too many `dofs` for
// tree_contacts.h; more than kMostTreeContacts contacts and dry friction make it so too.
inline bool joins_more(const ContactSide* sides, int32_t dofs) {
  return (sides[0].tree >= 0 && sides[1].tree >= 0) || dofs > kTreeContactDofs;
}

// Trees that touch have the root of the smallest index. root_of(tree) is a tree nearer to it.
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

// The impulses of a point, for the next step.
struct KeptContact {
  int32_t shape0 = 0, shape1 = 0, point = 0;
  float normal = 0.0f;  // 0: nobody starts from it
  Vec3f tangent = {};
};
inline KeptContact kept_contact(const ContactRows& c, int32_t contact,
                                const ContactFrame<float>& frame, const float* impulse) {
  const Vec3f tangent = frame.axes[1] * impulse[1] + frame.axes[2] * impulse[2];
  return {c.shape0[contact], c.shape1[contact], c.point_id == nullptr ? -1 : c.point_id[contact],
          impulse[0], tangent};
}
// The mean force of a step on B, N.
inline Vec3f contact_force(const ContactFrame<float>& frame, const KeptContact& of, float dt) {
  return (frame.axes[0] * of.normal + of.tangent) * (1.0f / dt);
}

// Where the impulses of the same point stand in those of the step before, or -1. `next` is where
// the pair before stood, 0 at first: both lists are in the order of shapes.
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

// Whether the point of a shape that meets a plane is fixed to it: a center, an end, a corner.
inline bool meets_planes_in_points(int32_t shape_type) {
  switch (static_cast<GeoType>(shape_type)) {
    case GeoType::SPHERE:
    case GeoType::CAPSULE:
    case GeoType::BOX:
    case GeoType::CONVEX_MESH:
    case GeoType::MESH:
      return true;
    default:
      return false;
  }
}
// IslandContact::follows of a contact.
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

// What the rows of an island read of a tree, and move.
struct IslandTree {
  Tree<float> tree;
  Workspace<float> ws;  // behind free_rates
  float* rates;         // {2, padded_dofs}: ws.qd_next, which contacts change, and shifts; zeros
  const float* qd;      // of before
  bool moves;           // by impulses
};

// A contact of an island; `contact` is its row, and the widths are those of set_widths.
struct IslandContact {
  int32_t contact = 0;
  ContactSide sides[2] = {};
  ContactFrame<float> frame = {};
  ContactPlace<float> place = {};
  Vec3f cores[2] = {};  // about the origins
  float before = 0.0f;  // J_n qd
  NormalTarget<float> target = {};
  PgsContact<float> solver = {};
  // For derivatives (active_rows.h). Found from the state, of a point that is fixed to its shape
  // and a plane of the world: so the normal is constant, and the point of the plane goes along it
  // below the other.
  bool follows = false;
  bool turns = false;        // points and normal follow both bodies (turning_contacts.h)
  bool elastic = false;      // it has restitution
  float* numbers = nullptr;  // {6, widths of both sides}: J, and Y behind it, of each side
  bool whole = false;        // build_responses was there
};

// Whether it pushes or shifts.
inline bool pushes(const IslandContact& row) {
  return row.solver.impulse[0] > 0.0f || row.solver.shifted > 0.0f;
}

inline void contact_points(const ContactRows& c, int32_t contact,
                           const LinkState<float>* const* links, SurfacePoint<float>* points) {
  const Vec3f normal = c.normal[contact];
  points[0] = surface_point(links[0], c.point0[contact], normal * c.margin0[contact]);
  points[1] = surface_point(links[1], c.point1[contact], normal * -c.margin1[contact]);
}

// Whether a contact may touch in a step of dt: its gap is at most twice the way that its points
// come together with the motions of the links (null: the world), and kMoreSpeed (m/s) dt for what
// the step does to them. Only such contacts are solved. A gap that is no number may.
inline bool may_touch(const ContactRows& c, int32_t contact, const LinkState<float>* const* links,
                      float dt) {
  const Vec3f normal = c.normal[contact];
  SurfacePoint<float> points[2];
  contact_points(c, contact, links, points);
  const ContactPlace<float> place = contact_place(points[0], points[1], normal);
  float closing = 0.0f;
  if (links[0] != nullptr)
    closing += math::dot(math::motion_at(links[0]->v, place.a).linear, normal);
  if (links[1] != nullptr)
    closing -= math::dot(math::motion_at(links[1]->v, place.b).linear, normal);
  return !(place.gap > (2.0f * math::max(closing, 0.0f) + kMoreSpeed) * dt);
}

// Where a contact is and its J, in row.numbers.
template <class TreeOf>
void build_jacobian(const ContactRows& c, const TreeOf& tree_of, IslandContact& row) {
  const int32_t i = row.contact;
  const Vec3f normal = c.normal[i];
  const Vec3f cores[2] = {c.point0[i], c.point1[i]};
  const LinkState<float>* links[2];
  SurfacePoint<float> points[2];
  for (int side = 0; side < 2; ++side) {
    const ContactSide& at = row.sides[side];
    links[side] = at.tree < 0 ? nullptr : tree_of(at.tree).ws.links + at.link;
    row.cores[side] = surface_point(links[side], cores[side], Vec3f{}).at;
  }
  contact_points(c, i, links, points);
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

// Behind build_jacobian: what its impulses do.
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

// What its normal wants, behind build_jacobian and at the rates without impulses.
inline void aim(const ContactLaw<float>& law, const ContactMaterial<float>& material,
                IslandContact& row) {
  row.target = normal_target(law, material, row.place.gap, row.before, slip(row.solver, 0));
  row.solver.bias = row.target.bias;
  row.solver.shift = row.target.shift;
  row.solver.cfm = row.target.cfm;
  row.solver.friction = material.friction;
  row.elastic = material.restitution > 0.0f;
}
// Likewise, behind build_contact.
inline void set_target(const ContactLaw<float>& law, const ContactMaterial<float>& material,
                       IslandContact& row) {
  aim(law, material, row);
  set_steps<float>(law.dt, row.solver);
}

// Starts from the impulses of the step before, times `scale`.
inline void start_from_kept(const KeptContact& kept, float scale, bool cone, IslandContact& row) {
  const Vec3f tangent = kept.tangent * scale;
  warm_start(row.solver, cone, kept.normal * scale, math::dot(tangent, row.frame.axes[1]),
             math::dot(tangent, row.frame.axes[2]));
}

// Dry friction of a dof, with its `response` {padded_dofs}; `limit`: friction dt.
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
  // Of a dof at its velocity limit nothing but the limit's force depends on it.
  if (response[dof] == 0.0f && of.rates[dof] != 0.0f)
    row.impulse = of.rates[dof] > 0.0f ? -limit : limit;
}

struct IslandResult {
  int32_t sweeps = 0;
  float residual = 0.0f;  // the largest change of velocity of the last, m/s
  float largest = 0.0f;   // impulse, as a velocity, m/s
};
// The rates that an island left, into qd_next and qdd, and its shifts. The first dof whose rate is
// not finite, or -1; there it stops.
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

// Adds what a contact pushes the dofs of a tree with, N s or N m s. `rates`: those of the tree.
inline void add_impulses(const PgsContact<float>& c, const float* rates, int32_t dofs, float* to) {
  for (const RowSide<float>& s : c.sides)
    for (int32_t r = 0; s.width > 0 && s.rates == rates && r < 3; ++r)
      for (int32_t k = 0; k < dofs; ++k) to[k] += s.jacobian[r * s.width + k] * c.impulse[r];
}
// Behind sweep_island: accelerations, and renew_branches, of one of its trees.
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
// Its rates without impulses once more. The dof that fails, or -1.
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

// Bits of the dofs that move a link, for tree_contacts.h.
template <class T>
int32_t moving_dofs(const Tree<T>& tree, int32_t link) {
  uint32_t bits = 0;
  for (int32_t d = last_dof(tree, link); d >= 0; d = tree.dof_parent[d])
    if (d < kTreeContactDofs) bits |= 1u << d;
  return static_cast<int32_t>(bits);
}
// The contact of a tree with the world, for tree_contacts.h. `moved_by`: bits of the dofs that move
// its link; `kept`: what it starts from, zeros where that is nothing.
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
