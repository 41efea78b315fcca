// Kernel of the tangent of a step of articulations with contacts and dry friction
// (articulation/contact_jvp.h), for devices. A kernel row is a group.
#pragma once

// clang-format off: before what reads it
#include "novaphy/dynamics/articulation/matrix_trees.h"
// clang-format on
#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/contact_groups.h"
#include "novaphy/dynamics/articulation/contact_jvp.h"
#include "novaphy/dynamics/articulation/jvp_arguments.h"

namespace novaphy {

// Arguments. step.workspace also has the responses of dry friction, behind the workspace of a tree.
// impulses {contacts} and friction_impulses {dofs} are those of the step. changes {contacts}: the
// tangents of the impulses in the world; null: not requested. The memory `system` of a group has a
// number of floats per contact, and another number per group. status {groups}: 0, or 1 + the size
// of a system that did not fit.
struct ArticulationContactJvpArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationJvpArguments> step; Part<ContactGroupArguments> of;
                    Given<Vec3f> impulses; Given<float> friction_impulses;
                    Given<DualFloat> joint_friction, mu, restitution, ke, kd;
                    Optional<Writes<Vec3f>> changes; Writes<double> system;
                    Number<int64_t> system_of_contact, system_of_group; WritesRow<int32_t> status;)
};

// Returns the memory (bytes) of a contact between trees with `dofs` degrees of freedom.
inline int64_t dual_contact_bytes(int32_t dofs) {
  return (static_cast<int64_t>(sizeof(articulation::DualContact)) +
          articulation::dual_contact_numbers(dofs) *
              static_cast<int64_t>(sizeof(articulation::DualFloat)) +
          7) /
         8 * 8;
}

struct GroupTangent : GroupLists {
  const ArticulationContactJvpArguments& all;

  GroupTangent(const ArticulationContactJvpArguments& arguments, int64_t row)
      : GroupLists(arguments.step.in.rows, arguments.of, arguments.step.in.dt.value, row, nullptr),
        all(arguments) {}

  articulation::Tree<articulation::DualFloat> tree(int32_t i) const {
    return articulation_tree(all.step.in, rows(i));
  }
  unsigned char* memory(int32_t i) const {
    return reinterpret_cast<unsigned char*>(all.step.workspace + i * all.step.stride.value);
  }
  articulation::Workspace<articulation::DualFloat> workspace(int32_t i) const {
    return articulation::make_workspace<articulation::DualFloat>(memory(i), rows(i).link_count,
                                                                 rows(i).dof_count);
  }
  articulation::DualFloat* response(int32_t i, int32_t dof) const {
    const int32_t dofs = rows(i).dof_count;
    auto* const first = reinterpret_cast<articulation::DualFloat*>(
        memory(i) +
        articulation::workspace_bytes<articulation::DualFloat>(rows(i).link_count, dofs));
    return first + dof * dofs;
  }
  articulation::DualFloat limit(int32_t i, int32_t dof) const {
    return all.joint_friction[rows(i).first_dof + dof] * articulation::DualFloat(law.dt);
  }
  float friction_impulse(int32_t i, int32_t dof) const {
    return all.friction_impulses[rows(i).first_dof + dof];
  }
  articulation::DualMaterials materials() const {
    return {all.mu, all.restitution, all.ke, all.kd, a.mixing};
  }
  // Returns the pose of a side's body, as dual numbers, relative to the point `about`.
  Transform<articulation::DualFloat> pose(const articulation::ContactSide& side,
                                          const Vec3f& about) const {
    using articulation::constant;
    if (side.tree < 0) return {constant(-about), constant(Quatf::identity())};
    const auto& link = workspace(side.tree).links[side.link];
    return {link.p + (link.origin - constant(about)), link.q};
  }
  // Returns the moving contact point of a contact: how its points and its normal move with the
  // poses of the two bodies.
  articulation::DualTurning turning(const articulation::DualContact& row) const {
    articulation::DualTurning to;
    if (!contacts.found || row.follows) return to;
    const int32_t c = row.contact;
    const int first = row.sides[0].tree >= 0 ? 0 : 1;
    const auto& link = workspace(row.sides[first].tree).links[row.sides[first].link];
    to.about = articulation::value_of(link.origin);
    for (int side = 0; side < 2; ++side) to.pose[side] = pose(row.sides[side], to.about);
    to.find(turning_shapes(),
            turning_input(c, [&](int side) { return articulation::value_of(to.pose[side]); }),
            contacts.margin0[c], contacts.margin1[c]);
    return to;
  }
  articulation::DualContact& row(int32_t place) const {
    return reinterpret_cast<articulation::DualContact*>(island_memory())[place - first_place()];
  }
};

// An island with the members that solve_dual_island needs.
struct TangentIsland : ActiveIsland<GroupTangent> {
  template <class F>
  void for_sticking(const F& f) const {
    for (int32_t i = root; i >= 0; i = s.a.nodes[i].next)
      for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
        if (s.has_friction(i, k) &&
            articulation::holds(s.friction_impulse(i, k), s.limit(i, k).value))
          f(i, k, s.response(i, k));
  }
};

// Sets the tangents of an island to NaN, because its system does not fit into the memory.
inline void fill_tangents(const GroupTangent& s, int32_t root) {
  for (int32_t i = root; i >= 0; i = s.a.nodes[i].next)
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
      s.workspace(i).qd_next[k].tangent = math::bits_float(0x7fc00000);
}

inline void solve_island_tangent(const GroupTangent& s, int32_t root) {
  if (s.a.nodes[root].solved != 0) return;
  s.a.nodes[root].solved = 1;
  const TangentIsland island{{s, root}};
  if (!articulation::solve_dual_island(s, island, s.law.cone)) return fill_tangents(s, root);
  if (s.all.changes == nullptr) return;
  island.for_contacts(
      [&](const articulation::DualContact& row) { s.all.changes[row.contact] = row.change; });
}

// A group in which a tree fails gets no tangent, as on the host.
NOVAPHY_ROW_KERNEL(articulation_contact_jvp, ArticulationContactJvpArguments) {
  using articulation::DualFloat;
  const GroupTangent s(a, row);
  const int32_t* const trees = a.of.trees;
  const articulation::StepInputs<DualFloat> in = articulation_inputs(a.step.in);
  const articulation::StepOptions<DualFloat> options = articulation_options(a.step.in);
  a.status[row] = 0;
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const articulation::Tree<DualFloat> tree = s.tree(trees[t]);
    articulation::Workspace<DualFloat> ws = s.workspace(trees[t]);
    if (articulation::accelerate_again(tree, in, options, a.step.branch, ws) >= 0) return;
    articulation::free_rates(tree, in, options, ws);
    start_node(s, trees[t]);
  }
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) join_contact(s, place);
  list_trees(s);
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) list_contact(s, place);
  const articulation::ContactLaw<DualFloat> law = articulation::dual_law(s.law);
  auto* numbers = reinterpret_cast<DualFloat*>(&s.row(s.end_place()));
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) {
    articulation::DualContact& contact = s.row(place);
    contact = articulation::DualContact{};
    if (a.of.chain[place].next == -2) continue;
    contact.contact = a.of.contacts[place];
    contact_sides(a.of.shapes, contact.contact, contact.sides);
    contact.follows = s.follows(contact.contact, contact.sides);
    int32_t widths[2];
    articulation::set_widths(s.all_rows, contact.sides, widths);
    for (int side = 0; side < 2; ++side) contact.solver.sides[side].width = widths[side];
    articulation::build_dual_contact(s.contacts, s, in.qd, law, s.materials(),
                                     a.impulses[contact.contact], numbers, contact);
    for (const articulation::DualSide& m : contact.moved) numbers += 6 * m.dofs;
  }
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    for (int r = 0; r < 3; ++r)
      articulation::dual_push(s.row(place), r, DualFloat(s.row(place).solver.impulse[r]), s);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const int32_t i = trees[t];
    const articulation::Tree<DualFloat> tree = s.tree(i);
    articulation::Workspace<DualFloat> ws = s.workspace(i);
    for (int32_t k = 0; k < tree.dof_count; ++k)
      if (s.has_friction(i, k))
        articulation::push_dual_friction(tree, ws, k, s.limit(i, k), s.friction_impulse(i, k),
                                         s.response(i, k));
    articulation::push_absent_friction(tree, ws, a.joint_friction, s.law.dt);
  }
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t)
    if (s.root(trees[t]) == trees[t]) solve_island_tangent(s, trees[t]);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t)
    for (int32_t k = 0; k < s.rows(trees[t]).dof_count; ++k)
      s.workspace(trees[t]).bias[k] = DualFloat();
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t)
    if (s.root(trees[t]) == trees[t] &&
        !articulation::add_dual_shifts(s, TangentIsland{{s, trees[t]}}))
      fill_tangents(s, trees[t]);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const articulation::Tree<DualFloat> tree = s.tree(trees[t]);
    articulation::Workspace<DualFloat> ws = s.workspace(trees[t]);
    ws.shift = ws.bias;
    finish_step(a.step, tree, in, options, ws);
  }
}

}  // namespace novaphy
