// Groups of articulations with their contacts. A group has the trees of one world, which may touch
// each other. The kernels of a step with contacts and of its adjoint share this file. A kernel row
// is a group, which splits into islands (islands.h).
#pragma once

#include "novaphy/core/row_scratch.h"
#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/step_vjp.h"
#include "novaphy/dynamics/articulation/turning_contacts.h"

namespace novaphy {

// The arrays of rigid contacts (core/sim/contacts.h).
struct ContactPlaces {
  NOVAPHY_ARGUMENTS(Given<int32_t> shape0, shape1; Given<Vec3f> point0, point1, normal;
                    Given<float> margin0, margin1;)
};
// The tables that give the two sides of a contact. shape_body {shapes}: the body of each shape.
struct ContactShapes {
  NOVAPHY_ARGUMENTS(Part<ContactPlaces> at; Given<int32_t> shape_body;
                    Given<articulation::ContactSide> side_of_body; Given<int32_t> group_of_tree;
                    Number<int64_t> shapes, bodies;)
};
// Finds the two sides of a contact. Returns false if a shape or body does not exist.
inline bool contact_sides(const ContactShapes& s, int32_t contact,
                          articulation::ContactSide* sides) {
  bool there = true;
  for (int side = 0; side < 2; ++side) {
    sides[side].tree = sides[side].link = -1;
    const int32_t shape = side == 0 ? s.at.shape0[contact] : s.at.shape1[contact];
    const bool is_shape = shape >= 0 && shape < s.shapes;
    const int32_t body = is_shape ? s.shape_body[shape] : -1;
    there = there && is_shape && body >= -1 && body < s.bodies;
    if (body >= 0 && body < s.bodies) sides[side] = s.side_of_body[body];
  }
  return there;
}

// Data of a tree during a step. Values are tree indices or places; -1 ends a list. A place is an
// entry of the group's list of contacts.
struct IslandNode {
  int32_t root;                       // root tree of its island
  int32_t next;                       // next tree of the island in ascending order
  int32_t met;                        // whether a contact touches it although impulses do not move
                                      // it
  int32_t taken;                      // whether TreeSteps steps it
  int32_t coupled;                     // for roots only, with all members below: whether the island
                                      // is coupled
  int32_t last;                       // last tree of the island
  int32_t first_row, last_row, rows;  // its contacts, as places in the list of the group
  int32_t begin;                      // number of contacts in earlier islands of the group
  int32_t solved, failed;
  articulation::IslandResult result;
};
// Data of a place, an entry of the group's list of contacts.
struct ContactLink {
  int32_t next;  // the island's next place; -2: the group cannot have the contact
  int32_t kept;  // find_kept: index of the impulses for the warm start
};

// The arguments of kernels over groups. The trees of each group are in ascending order, and so are
// its contacts. found: as ContactRows::found. contact_stride: memory of a contact, in floats.
struct ContactGroupArguments {
  NOVAPHY_ARGUMENTS(Part<ContactShapes> shapes; Given<float> mu, restitution, ke, kd, mixing;
                    Given<float> joint_friction; Given<int32_t> tree_begin, trees;
                    Given<int32_t> contact_begin, contacts; Given<int32_t> shape_type;
                    Given<Transformf> shape_transform; Given<Vec3f> shape_scale;
                    Optional<Reads<geometry::GeometryView>> views;
                    Optional<Given<int32_t>> view_of_shape;
                    Number<float> erp, slop, cfm, max_depenetration, restitution_threshold;
                    Number<int64_t> compliant, cone, found; Writes<ContactLink> chain;
                    Writes<IslandNode> nodes; Writes<float> memory; Number<int64_t> contact_stride;)
};

// The following functions give offsets and sizes (bytes) in the memory of a tree, in this order:
// workspace, rates with shifts, dry friction of the joints, and data of the adjoint.
inline int64_t tree_rates_offset(int32_t links, int32_t dofs) {
  return articulation::workspace_bytes<float>(links, dofs);
}
// Returns the size of the rates and the shifts of a tree.
inline int64_t tree_rates_bytes(int32_t dofs) {
  return 2 * articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
}
inline int64_t island_tree_bytes(int32_t links, int32_t dofs) {
  const int64_t width = articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
  return tree_rates_offset(links, dofs) + tree_rates_bytes(dofs) +
         dofs * (static_cast<int64_t>(sizeof(articulation::PgsJointFriction<float>)) + width);
}
inline int64_t island_adjoint_bytes(int32_t links, int32_t dofs) {
  return island_tree_bytes(links, dofs) + articulation::adjoint_bytes<float>(links, dofs);
}
// Returns the size of J and Y of a contact, for trees with `dofs` dofs.
inline int64_t contact_row_bytes(int32_t dofs) {
  return 12 * articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
}

// The lists of trees and contacts of a group.
struct GroupLists {
  const ArticulationRows* const all_rows;
  const ContactGroupArguments& a;
  const int32_t group;
  const articulation::ContactRows contacts;
  const articulation::ContactLaw<float> law;

  GroupLists(const ArticulationRows* rows, const ContactGroupArguments& arguments, float dt,
             int64_t row, const int32_t* point_id)
      : all_rows(rows),
        a(arguments),
        group(static_cast<int32_t>(row)),
        contacts{0,
                 a.shapes.at.shape0,
                 a.shapes.at.shape1,
                 point_id,
                 a.shapes.at.point0,
                 a.shapes.at.point1,
                 a.shapes.at.normal,
                 a.shapes.at.margin0,
                 a.shapes.at.margin1,
                 a.found.value != 0},
        law{dt,
            a.erp.value,
            a.slop.value,
            a.cfm.value,
            a.max_depenetration.value,
            a.restitution_threshold.value,
            a.compliant.value != 0,
            a.cone.value != 0} {}

  int32_t first_tree() const { return a.tree_begin[group]; }
  int32_t end_tree() const { return a.tree_begin[group + 1]; }
  int32_t first_place() const { return a.contact_begin[group]; }
  int32_t end_place() const { return a.contact_begin[group + 1]; }
  const ArticulationRows& rows(int32_t tree) const { return all_rows[tree]; }
  bool has_friction(int32_t i, int32_t dof) const {
    return rows(i).moves != 0 && a.joint_friction[rows(i).first_dof + dof] > 0.0f;
  }
  int32_t& root(int32_t i) const { return a.nodes[i].root; }
  int32_t find_root(int32_t i) const {
    return articulation::find_root([&](int32_t t) -> int32_t& { return root(t); }, i);
  }
  // Returns the memory of the contacts of the group.
  unsigned char* island_memory() const {
    return reinterpret_cast<unsigned char*>(a.memory +
                                            a.contact_begin[group] * a.contact_stride.value);
  }
  bool follows(int32_t contact, const articulation::ContactSide* sides) const {
    return articulation::follows_plane(contacts, a.shape_type, contact, sides);
  }
  articulation::TurningShapes turning_shapes() const {
    return {a.shape_type, a.shape_transform, a.shape_scale, a.views, a.view_of_shape};
  }
  // Returns the data for the contact's moving contact point. pose_of(side): pose of a side's body.
  template <class PoseOf>
  articulation::TurningInput<float> turning_input(int32_t contact, const PoseOf& pose_of) const {
    articulation::TurningInput<float> of = {{contacts.shape0[contact], contacts.shape1[contact]},
                                            {contacts.point0[contact], contacts.point1[contact]},
                                            contacts.normal[contact],
                                            {pose_of(0), pose_of(1)}};
    articulation::find_polytopes(turning_shapes(), of);
    return of;
  }
};

// A group with the workspaces and the dynamics of its trees.
struct ContactGroup : GroupLists {
  const ArticulationArguments& step;
  float* const workspace;
  const int64_t stride;
  const articulation::StepInputs<float> in;
  const articulation::StepOptions<float> how;

  ContactGroup(const ArticulationArguments& of_step, const ContactGroupArguments& arguments,
               float* workspaces, int64_t numbers, int64_t row, const int32_t* point_id)
      : GroupLists(of_step.rows, arguments, of_step.dt.value, row, point_id),
        step(of_step),
        workspace(workspaces),
        stride(numbers),
        in(articulation_inputs(of_step)),
        how(articulation_options(of_step)) {}

  unsigned char* memory(int32_t tree) const {
    return reinterpret_cast<unsigned char*>(workspace + tree * stride);
  }
  articulation::IslandTree tree(int32_t i) const {
    const ArticulationRows& r = rows(i);
    unsigned char* const at = memory(i);
    return {articulation_tree(step, r),
            articulation::make_workspace<float>(at, r.link_count, r.dof_count),
            reinterpret_cast<float*>(at + tree_rates_offset(r.link_count, r.dof_count)),
            in.qd + r.first_dof, r.moves != 0};
  }
  articulation::PgsJointFriction<float>* friction(int32_t i) const {
    return reinterpret_cast<articulation::PgsJointFriction<float>*>(
        tree(i).rates + 2 * articulation::padded_dofs(rows(i).dof_count));
  }
  articulation::AdjointMemory<float> adjoint(int32_t i) const {
    const ArticulationRows& r = rows(i);
    return articulation::make_adjoint_memory<float>(
        memory(i) + island_tree_bytes(r.link_count, r.dof_count), r.link_count, r.dof_count);
  }
  // Returns the pose of a side's body, relative to the root's origin of the contact's first tree.
  Transformf pose(const articulation::ContactSide* sides, int side) const {
    const auto link = [&](int of) -> const articulation::LinkState<float>& {
      return tree(sides[of].tree).ws.links[sides[of].link];
    };
    const Vec3f about = link(sides[0].tree >= 0 ? 0 : 1).origin;
    if (sides[side].tree < 0) return {-about, Quatf::identity()};
    return {link(side).p + (link(side).origin - about), link(side).q};
  }
  articulation::TurningInput<float> turning_input(const articulation::IslandContact& row) const {
    return GroupLists::turning_input(row.contact, [&](int side) { return pose(row.sides, side); });
  }
  // Returns whether a contact has a moving contact point. The trees must have the poses at the
  // start of the step.
  bool turns(const articulation::IslandContact& row) const {
    return contacts.found && !row.follows && articulation::pushes(row) &&
           articulation::turn_contact(turning_shapes(), turning_input(row)).is_exact;
  }
  articulation::ShapeMaterials materials() const {
    return {a.mu, a.restitution, a.ke, a.kd, a.mixing};
  }
  articulation::ContactMaterial<float> material(int32_t contact) const {
    return articulation::contact_material(materials(), contacts, contact);
  }
};

// Makes a tree an island of its own.
inline void start_node(const GroupLists& s, int32_t i) {
  IslandNode node{};
  node.root = node.last = i;
  node.next = node.first_row = node.last_row = -1;
  s.a.nodes[i] = node;
}

// Merges the islands of the two trees of a contact. If the contact involves a tree outside of the
// group, returns a tree of the group. Else -1.
inline int32_t join_contact(const GroupLists& s, int32_t place) {
  const ContactGroupArguments& a = s.a;
  articulation::ContactSide sides[2];
  bool here = contact_sides(a.shapes, a.contacts[place], sides);
  int32_t mine = a.trees[a.tree_begin[s.group]];
  for (int side = 0; side < 2; ++side) {
    if (sides[side].tree < 0) continue;
    const bool of_group = a.shapes.group_of_tree[sides[side].tree] == s.group;
    here = here && of_group;
    if (of_group) mine = sides[side].tree;
  }
  a.chain[place].next = here ? -1 : -2;
  a.chain[place].kept = -1;
  if (here && articulation::moves(s.all_rows, sides[0]) &&
      articulation::moves(s.all_rows, sides[1]))
    articulation::join_trees([&](int32_t t) -> int32_t& { return s.root(t); }, sides[0].tree,
                             sides[1].tree);
  return here ? -1 : mine;
}

// Lists the trees of each island after all merges, and sets `root` of each tree to its island's
// root.
inline void list_trees(const GroupLists& s) {
  const ContactGroupArguments& a = s.a;
  for (int32_t k = s.first_tree(); k < s.end_tree(); ++k) {
    const int32_t i = a.trees[k], root = s.find_root(i);
    a.nodes[i].root = root;
    if (root == i) continue;
    a.nodes[a.nodes[root].last].next = i;
    a.nodes[root].last = i;
  }
}

// Appends a contact to the list of its island, and returns the root of the island. -1: no island.
inline int32_t list_contact(const GroupLists& s, int32_t place) {
  const ContactGroupArguments& a = s.a;
  if (a.chain[place].next == -2) return -1;
  articulation::ContactSide sides[2];
  contact_sides(a.shapes, a.contacts[place], sides);
  const int32_t tree = articulation::moved_tree(s.all_rows, sides), root = s.find_root(tree);
  IslandNode& node = a.nodes[root];
  (node.rows == 0 ? node.first_row : a.chain[node.last_row].next) = place;
  node.last_row = place;
  ++node.rows;
  if (articulation::couples_trees(sides, s.rows(tree).dof_count)) node.coupled = 1;
  for (const articulation::ContactSide& side : sides)
    if (side.tree >= 0 && !articulation::moves(s.all_rows, side)) a.nodes[side.tree].met = 1;
  return root;
}

// Sets a contact's sides and widths, and takes its memory from `numbers`, which advances.
inline void place_row(const ContactGroup& s, int32_t contact, float*& numbers,
                      articulation::IslandContact& row) {
  row.contact = contact;
  contact_sides(s.a.shapes, contact, row.sides);
  row.follows = s.follows(contact, row.sides);
  int32_t widths[2];
  articulation::set_widths(s.all_rows, row.sides, widths);
  for (int side = 0; side < 2; ++side) row.solver.sides[side].width = widths[side];
  row.numbers = numbers;
  numbers += 6 * (widths[0] + widths[1]);
}
// Computes J, Y and the divisors of a contact.
inline void build_row(const ContactGroup& s, int32_t contact, float*& numbers,
                      articulation::IslandContact& row) {
  place_row(s, contact, numbers, row);
  articulation::build_contact(
      s.contacts, [&](int32_t i) { return s.tree(i); }, row.numbers, row);
}
inline void build_dry(const ContactGroup& s, int32_t i) {
  const articulation::IslandTree of = s.tree(i);
  articulation::PgsJointFriction<float>* const dry = s.friction(i);
  const int32_t dofs = of.tree.dof_count, width = articulation::padded_dofs(dofs);
  auto* const responses = reinterpret_cast<float*>(dry + dofs);
  for (int32_t k = 0; k < dofs; ++k)
    if (s.has_friction(i, k))
      articulation::build_friction(of, k, s.a.joint_friction[s.rows(i).first_dof + k] * s.law.dt,
                                   responses + k * width, dry[k]);
}

// The contacts of an island that push, and the memory for their linear system, for an adjoint or a
// tangent. `Group`: a GroupLists with a row for each contact. Its arguments (`all`) give the size
// of this memory per contact and per group.
template <class Group>
struct ActiveIsland {
  const Group& s;
  int32_t root;

  template <class F>
  void for_rows(const F& f) const {
    for (int32_t place = s.a.nodes[root].first_row; place >= 0; place = s.a.chain[place].next)
      f(s.row(place));
  }
  template <class F>
  void for_contacts(const F& f) const {
    for_rows([&](auto& row) {
      if (row.solver.impulse[0] > 0.0f) f(row);
    });
  }
  template <class F>
  void for_shifted(const F& f) const {
    for_rows([&](auto& row) {
      if (row.solver.shifted > 0.0f) f(row);
    });
  }
  // Returns the memory of a linear system with `numbers` numbers. Null: the memory is too small,
  // and the group's status gets the required size.
  double* system(int64_t numbers) const {
    const int64_t contacts = s.end_place() - s.first_place();
    const int64_t of_contact = s.all.system_of_contact, of_group = s.all.system_of_group;
    if (numbers > contacts * of_contact + of_group) {
      if (double* const more = thread_numbers(numbers)) return more;
      s.all.status[s.group] = numbers < 0x7ffffffe ? static_cast<int32_t>(1 + numbers) : 0x7fffffff;
      return nullptr;
    }
    return s.all.system + (s.first_place() * of_contact + s.group * of_group);
  }
};

}  // namespace novaphy
