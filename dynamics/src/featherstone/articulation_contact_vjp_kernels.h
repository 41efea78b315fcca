// Kernels of the adjoint of a step of articulations with contacts and dry friction
// (articulation/contact_adjoint.h), for devices.
//
//   articulation_contact_vjp        a row per group: all gradients, but those by materials only per
//                                   contact
//   articulation_material_clear     clears the stored gradients of contacts that have none
//   articulation_material_gradient  a row per shape: sums the gradients of its contacts, in their
//                                   order
#pragma once

// clang-format off: before what reads it
#include "novaphy/dynamics/articulation/matrix_trees.h"
// clang-format on
#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/contact_adjoint.h"
#include "novaphy/dynamics/articulation/contact_groups.h"
#include "novaphy/dynamics/articulation/island_sweeps.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"

namespace novaphy {

// Arguments. impulses {contacts} and friction_impulses {dofs} are those of the step.
// joint_friction: the gradient by it, to which the kernel adds. materials: a row per contact.
// shape_of {2 contacts}: the shapes of each contact. notes: the ContactNote of each contact that
// pushes. Null: not requested. The memory `system` of a group has a number of floats per contact,
// and another number per group. status {groups}: 0, or 1 + the size of a system that did not fit.
struct ArticulationContactVjpArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationStepVjpArguments> step; Part<ContactGroupArguments> of;
                    Given<Vec3f> impulses; Given<float> friction_impulses;
                    Optional<Changed<float>> joint_friction;
                    Optional<Writes<articulation::MaterialGradient>> materials;
                    Optional<Writes<int32_t>> shape_of;
                    Optional<Writes<articulation::ContactNote>> notes; Writes<double> system;
                    Number<int64_t> system_of_contact, system_of_group; WritesRow<int32_t> status;)
};

// Returns the memory (bytes) of a contact between trees with `dofs` degrees of freedom.
inline int64_t adjoint_contact_bytes(int32_t dofs) {
  return (static_cast<int64_t>(sizeof(articulation::AdjointContact)) + contact_row_bytes(dofs) +
          7) /
         8 * 8;
}

// The adjoint of one group.
struct GroupAdjoint : ContactGroup {
  const ArticulationContactVjpArguments& all;

  GroupAdjoint(const ArticulationContactVjpArguments& arguments, int64_t row)
      : ContactGroup(arguments.step.in, arguments.of, arguments.step.workspace,
                     arguments.step.stride.value, row, nullptr),
        all(arguments) {}

  articulation::AdjointContact& row(int32_t place) const {
    return reinterpret_cast<articulation::AdjointContact*>(island_memory())[place - first_place()];
  }
};

// An island with the members that solve_adjoint needs.
struct GroupIsland : ActiveIsland<GroupAdjoint> {
  template <class F>
  void for_sticking(const F& f) const {
    for (int32_t i = root; i >= 0; i = s.a.nodes[i].next) {
      const articulation::PgsJointFriction<float>* const dry = s.friction(i);
      for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
        if (s.has_friction(i, k) && articulation::holds(dry[k].impulse, dry[k].limit)) f(dry[k], i);
    }
  }
  float* rate_gradient(int32_t tree) const { return s.adjoint(tree).rate; }
  float* move_gradient(int32_t tree) const { return s.adjoint(tree).scratch + dofs(tree); }
  int32_t dofs(int32_t tree) const { return s.rows(tree).dof_count; }
};

// Evaluates a tree at the start of the step: the gradients by its rates, its dynamics, and its
// rates without impulses.
inline void start_adjoint(const GroupAdjoint& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  articulation::AdjointMemory<float> memory = s.adjoint(i);
  step_vjp_rates(s.all.step, of.tree, s.in, s.how, of.ws, memory);
  articulation::step_vjp_dynamics(of.tree, s.in, s.how, of.ws);
  const int32_t dofs = s.rows(i).dof_count;
  for (int32_t k = 0; k < 2 * articulation::padded_dofs(dofs); ++k)
    of.rates[k] = k < dofs ? of.qd[k] + s.how.dt * of.ws.qdd[k] : 0.0f;
  start_node(s, i);
}

// Finds the moving contact point of a contact that pushes or shifts, unless it is already known.
inline void find_turning(const GroupAdjoint& s, articulation::AdjointContact& row) {
  if (!s.contacts.found || row.follows || row.turning.is_exact || !articulation::pushes(row))
    return;
  const float margins[2] = {s.contacts.margin0[row.contact], -s.contacts.margin1[row.contact]};
  row.turning = articulation::contact_turning(s.turning_shapes(), s.turning_input(row), margins,
                                              row.sides[0].tree >= 0 ? row.place.a : row.place.b);
}

// Adds all impulses to the rates, times `sign`. -1 removes the impulses.
inline void apply_impulses(const GroupAdjoint& s, float sign) {
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) {
    const articulation::AdjointContact& row = s.row(place);
    for (int32_t r = 0; r < 3; ++r) articulation::push(row.solver, r, sign * row.solver.impulse[r]);
  }
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const int32_t i = s.a.trees[t];
    const articulation::PgsJointFriction<float>* const dry = s.friction(i);
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k) {
      if (!s.has_friction(i, k)) continue;
      const articulation::PgsJointFriction<float>& f = dry[k];
      for (int32_t x = 0; x < f.width; ++x) f.rates[x] += sign * f.impulse * f.response[x];
    }
  }
}

// Builds the rows of all contacts and of dry friction as in the step.
inline void build_rows(const GroupAdjoint& s) {
  auto* numbers = reinterpret_cast<float*>(&s.row(s.end_place()));
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) {
    articulation::AdjointContact& row = s.row(place);
    row = articulation::AdjointContact{};
    if (s.a.chain[place].next == -2) continue;
    const int32_t contact = s.a.contacts[place];
    build_row(s, contact, numbers, row);
    const Vec3f& impulse = s.all.impulses[contact];
    row.solver.impulse[0] = impulse.x;
    row.solver.impulse[1] = impulse.y;
    row.solver.impulse[2] = impulse.z;
    find_turning(s, row);
  }
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const int32_t i = s.a.trees[t];
    build_dry(s, i);
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
      if (s.has_friction(i, k))
        s.friction(i)[k].impulse = s.all.friction_impulses[s.rows(i).first_dof + k];
  }
  apply_impulses(s, -1.0f);
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    if (s.a.chain[place].next != -2)
      articulation::set_target(s.law, s.material(s.row(place).contact), s.row(place));
  apply_impulses(s, 1.0f);
}

// Solves for the shifts (position corrections, pgs.h) of an island from its impulses. Returns
// whether any contact shifts.
inline bool solve_island_shifts(const GroupAdjoint& s, int32_t root) {
  if (s.a.nodes[root].solved != 0) return false;
  s.a.nodes[root].solved = -1;
  const GroupIsland island = {{s, root}};
  articulation::sweep_shifts(
      [&](const auto& f) { island.for_rows(f); },
      [](const articulation::IslandContact& row, float) { return row.whole; });
  bool shifts = false;
  island.for_shifted([&](const articulation::AdjointContact&) { shifts = true; });
  return shifts;
}
// Sets the gradients of an island to NaN, because its system does not fit into the memory.
inline void fill_rates(const GroupAdjoint& s, int32_t root) {
  const float nan = math::bits_float(0x7fc00000);
  for (int32_t i = root; i >= 0; i = s.a.nodes[i].next)
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k) s.adjoint(i).rate[k] = nan;
}
// Adds the adjoint of the shifts of all islands.
inline void add_shifts(const GroupAdjoint& s) {
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    const int32_t i = s.a.trees[t];
    articulation::IslandTree of = s.tree(i);
    articulation::AdjointMemory<float> memory = s.adjoint(i);
    of.ws.shift = of.rates + articulation::padded_dofs(s.rows(i).dof_count);
    step_vjp_rates(s.all.step, of.tree, s.in, s.how, of.ws, memory);
    articulation::step_vjp_dynamics(of.tree, s.in, s.how, of.ws);
  }
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) {
    if (s.a.chain[place].next == -2) continue;
    find_turning(s, s.row(place));
    IslandNode& node =
        s.a.nodes[s.find_root(articulation::moved_tree(s.all_rows, s.row(place).sides))];
    if (node.solved != -1) continue;
    node.solved = -2;
    const auto root = static_cast<int32_t>(&node - s.a.nodes);
    if (!articulation::solve_shift_adjoint(GroupIsland{{s, root}})) fill_rates(s, root);
  }
  const auto tree_of = [&](int32_t i) { return s.tree(i); };
  const auto memory_of = [&](int32_t i) { return s.adjoint(i); };
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    if (s.row(place).solver.shifted > 0.0f)
      articulation::add_softness_gradient(s.row(place), s.how.dt, tree_of, memory_of);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    articulation::IslandTree of = s.tree(s.a.trees[t]);
    articulation::AdjointMemory<float> memory = s.adjoint(s.a.trees[t]);
    articulation::set_shift_motions(of.tree, s.in, s.how, of.rates, of.ws, memory);
  }
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    if (s.row(place).solver.shifted > 0.0f)
      articulation::add_shift_geometry(s.row(place), s.how.dt, tree_of, memory_of);
}

inline void solve_island_adjoint(const GroupAdjoint& s, int32_t root) {
  if (s.a.nodes[root].solved > 0) return;
  s.a.nodes[root].solved = 1;
  const GroupIsland island = {{s, root}};
  if (articulation::solve_adjoint(island, s.law.cone)) return;
  fill_rates(s, root);
  const float nan = math::bits_float(0x7fc00000);
  island.for_contacts([&](articulation::AdjointContact& row) {
    row.z = row.pull = {nan, nan, nan};
  });
}

inline void add_contact(const GroupAdjoint& s, int32_t place) {
  const articulation::AdjointContact& row = s.row(place);
  if (!articulation::has_geometry(row)) return;
  if (s.all.notes != nullptr)
    s.all.notes[row.contact] =
        articulation::contact_note(row, [&](int32_t i) { return s.tree(i); });
  articulation::add_contact_geometry(
      row, s.how.dt, [&](int32_t i) { return s.tree(i); }, [&](int32_t i) { return s.adjoint(i); });
  if (s.all.materials == nullptr) return;
  s.all.materials[row.contact] = articulation::material_gradient(
      s.law, s.material(row.contact),
      articulation::contact_parts(s.materials(), s.contacts, row.contact), row);
  s.all.shape_of[2 * row.contact] = s.a.shapes.at.shape0[row.contact];
  s.all.shape_of[2 * row.contact + 1] = s.a.shapes.at.shape1[row.contact];
}

inline void finish_adjoint(const GroupAdjoint& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  articulation::AdjointMemory<float> memory = s.adjoint(i);
  if (s.all.joint_friction != nullptr) {
    const articulation::PgsJointFriction<float>* const dry = s.friction(i);
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k) {
      const bool has = s.has_friction(i, k);
      const float push = articulation::friction_push(has, has ? dry[k].impulse : 0.0f,
                                                     has ? dry[k].limit : 0.0f, of.rates[k]);
      s.all.joint_friction[s.rows(i).first_dof + k] += push * memory.scratch[k];
    }
  }
  articulation::step_vjp_inputs(of.tree, s.in, s.how, step_gradient(s.all.step), of.ws, memory);
}

// Handles the islands in the order of their first contacts, as on the host, because islands may
// share kinematic bodies.
NOVAPHY_ROW_KERNEL(articulation_contact_vjp, ArticulationContactVjpArguments) {
  const GroupAdjoint s(a, row);
  const int32_t* const trees = a.of.trees;
  a.status[row] = 0;
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) start_adjoint(s, trees[t]);
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) join_contact(s, place);
  list_trees(s);
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) list_contact(s, place);
  build_rows(s);
  bool shifts = false;
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    if (a.of.chain[place].next != -2 &&
        solve_island_shifts(s,
                            s.find_root(articulation::moved_tree(s.all_rows, s.row(place).sides))))
      shifts = true;
  if (shifts) add_shifts(s);
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    if (a.of.chain[place].next != -2)
      solve_island_adjoint(s,
                           s.find_root(articulation::moved_tree(s.all_rows, s.row(place).sides)));
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t)
    if (s.root(trees[t]) == trees[t]) solve_island_adjoint(s, trees[t]);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
    articulation::IslandTree of = s.tree(trees[t]);
    articulation::AdjointMemory<float> memory = s.adjoint(trees[t]);
    articulation::step_vjp_solve(of.tree, s.how, of.ws, memory);
    articulation::set_contact_motions(of.tree, of.rates, of.ws, memory);
  }
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) add_contact(s, place);
  for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) finish_adjoint(s, trees[t]);
}

struct ArticulationMaterialClearArguments {
  NOVAPHY_ARGUMENTS(Writes<int32_t> shape_of;)
};
NOVAPHY_ROW_KERNEL(articulation_material_clear, ArticulationMaterialClearArguments) {
  a.shape_of[2 * row] = a.shape_of[2 * row + 1] = -1;
}
// Arguments of the sum over contacts, which adds to the gradients by the materials of a shape.
// Null: not requested. `sides` lists the contacts of each shape as 2 contact + side.
struct ArticulationMaterialGradientArguments {
  NOVAPHY_ARGUMENTS(Given<int32_t> begin, sides; Given<articulation::MaterialGradient> materials;
                    Optional<Changed<float>> mu, restitution, ke, kd;)
};
NOVAPHY_ROW_KERNEL(articulation_material_gradient, ArticulationMaterialGradientArguments) {
  for (int32_t k = a.begin[row]; k < a.begin[row + 1]; ++k) {
    const articulation::MaterialGradient& of = a.materials[a.sides[k] / 2];
    const int32_t side = a.sides[k] % 2;
    if (a.mu != nullptr) a.mu[row] += of.mu[side];
    if (a.restitution != nullptr) a.restitution[row] += of.restitution[side];
    if (a.ke != nullptr) a.ke[row] += of.ke[side];
    if (a.kd != nullptr) a.kd[row] += of.kd[side];
  }
}

}  // namespace novaphy
