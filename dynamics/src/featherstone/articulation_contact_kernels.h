// A step of articulations with contacts and dry friction (articulation/islands.h), for devices.
// Articulations that may touch each other are a group, those of a world; a row steps a group.
//
//   articulation_contact_group  the group of each contact, for the lists of contacts by group
//   articulation_contact_step   accelerates, solves the group's islands one by one, integrates
//   articulation_contact_keep   the impulses for the next step
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/islands.h"

namespace novaphy {

// What the sides of contacts are found by.
struct ContactShapes {
  const int32_t *shape0, *shape1;  // {contacts}
  const int32_t* shape_body;       // {shapes}
  const articulation::ContactSide* side_of_body;
  const int32_t* group_of_tree;
  int64_t shapes, bodies;
};
// False: there is no such shape or body.
inline bool contact_sides(const ContactShapes& s, int32_t contact,
                          articulation::ContactSide* sides) {
  bool there = true;
  for (int side = 0; side < 2; ++side) {
    sides[side].tree = sides[side].link = -1;
    const int32_t shape = side == 0 ? s.shape0[contact] : s.shape1[contact];
    const bool is_shape = shape >= 0 && shape < s.shapes;
    const int32_t body = is_shape ? s.shape_body[shape] : -1;
    there = there && is_shape && body >= -1 && body < s.bodies;
    if (body >= 0 && body < s.bodies) sides[side] = s.side_of_body[body];
  }
  return there;
}
struct ArticulationContactGroupArguments {
  ContactShapes shapes;
  const ArticulationRows* rows;
  const int32_t* count;
  int32_t* group;  // -1: the contact moves nothing
  Vec3f* force;
};
NOVAPHY_ROW_KERNEL(articulation_contact_group, 11, ArticulationContactGroupArguments) {
  a.group[row] = -1;
  if (row >= *a.count) return;
  a.force[row] = Vec3f{};
  articulation::ContactSide sides[2];
  int32_t widths[2];
  const bool there = contact_sides(a.shapes, static_cast<int32_t>(row), sides);
  const bool moves = articulation::set_widths(a.rows, sides, widths);
  if (moves)
    a.group[row] = a.shapes.group_of_tree[articulation::moved_tree(a.rows, sides)];
  else if (!there)
    a.group[row] = 0;  // which says so
}

// Of a tree, in a step. Lists end with -1.
struct IslandNode {
  int32_t root;                       // of its island
  int32_t next;                       // tree of the island, ascending
  int32_t joined;                     // what is below is of roots
  int32_t last;                       // tree
  int32_t first_row, last_row, rows;  // its contacts, places in the list of the group
  int32_t unused;
};
// Of a place in the list of a group.
struct ContactLink {
  int32_t next;  // place of the island's next contact
  int32_t kept;  // find_kept
};

struct ArticulationContactStepArguments {
  ArticulationStepArguments step;  // status: also -1 - a contact that the group cannot have
  ContactShapes shapes;
  const int32_t* point_id;
  const Vec3f *point0, *point1, *normal;
  const float *margin0, *margin1;
  articulation::ShapeMaterials materials;
  const float* joint_friction;
  const int32_t *tree_begin, *trees;        // the trees of each group, ascending
  const int32_t *contact_begin, *contacts;  // likewise its contacts
  const int32_t* moved_by;                  // of links: bits of the tree's dofs
  FloatWord erp, slop, cfm, max_depenetration, restitution_threshold, tolerance;
  int64_t compliant, cone, most_sweeps, warm_start;
  const int32_t* kept_begin;  // of each group
  const articulation::KeptContact* kept;
  const float* kept_dt;
  articulation::KeptContact* now;  // a row per place in the lists
  ContactLink* chain;              // likewise
  IslandNode* nodes;
  Vec3f* force;
  int32_t* sweeps;  // the most of an island of the group
  float* residual;
  float* memory;
  int64_t contact_stride;  // numbers of it for a contact
};

// Memory of a tree: its workspace, its rates, and the dry friction of its joints.
inline int64_t island_tree_bytes(int32_t links, int32_t dofs) {
  const int64_t width = articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
  return articulation::workspace_bytes<float>(links, dofs) + width +
         dofs * (static_cast<int64_t>(sizeof(articulation::PgsJointFriction<float>)) + width);
}
// And of a contact of trees with so many dofs, however it is solved.
inline int64_t island_contact_bytes(int32_t dofs) {
  namespace art = articulation;
  const int64_t numbers =
      12 * articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
  const int64_t joined = static_cast<int64_t>(sizeof(art::IslandContact)) + numbers;
  // The bytes of n contacts are at most n times those of one, A of which is {3 n, 3 n}.
  const int64_t coupling = art::kCoupledContacts * 9 * static_cast<int64_t>(sizeof(float));
  const int64_t alone =
      static_cast<int64_t>(sizeof(art::TreeContact<float>) + sizeof(art::TreeContactLink<float>)) +
      art::tree_contact_bytes<float>(1, dofs) + coupling;
  return ((joined > alone ? joined : alone) + 7) / 8 * 8;
}

// A group of one tree works on the stack, if the tree fits, and its contacts if they do too: stacks
// of threads are interleaved, so that those of a warp read together.
inline constexpr int64_t kIslandStack = 12288;
struct LocalIsland {
  alignas(16) unsigned char bytes[kIslandStack];
};

// A group's step.
struct GroupStep {
  const ArticulationContactStepArguments& a;
  unsigned char* const local;  // null: in memory of their own
  const int32_t group;
  const articulation::StepInputs<float> in;
  const articulation::StepOptions<float> how;
  const articulation::ContactRows contacts;
  const articulation::ContactLaw<float> law;
  const float warm_scale;

  explicit GroupStep(const ArticulationContactStepArguments& arguments, unsigned char* stack,
                     int32_t of_group, float scale)
      : a(arguments),
        local(stack),
        group(of_group),
        in(articulation_inputs(a.step.in)),
        how(articulation_options(a.step.in)),
        contacts{0,        a.shapes.shape0, a.shapes.shape1, a.point_id, a.point0,
                 a.point1, a.normal,        a.margin0,       a.margin1,  false},
        law{how.dt,
            a.erp.value,
            a.slop.value,
            a.cfm.value,
            a.max_depenetration.value,
            a.restitution_threshold.value,
            a.compliant != 0,
            a.cone != 0},
        warm_scale(scale) {}

  const ArticulationRows& rows(int32_t tree) const { return a.step.in.rows[tree]; }
  unsigned char* memory(int32_t tree) const {
    return local != nullptr
               ? local
               : reinterpret_cast<unsigned char*>(a.step.workspace + tree * a.step.stride);
  }
  articulation::IslandTree tree(int32_t i) const {
    const ArticulationRows& r = rows(i);
    unsigned char* const at = memory(i);
    return {articulation_tree(a.step.in, r),
            articulation::make_workspace<float>(at, r.link_count, r.dof_count),
            reinterpret_cast<float*>(
                at + articulation::workspace_bytes<float>(r.link_count, r.dof_count)),
            a.step.in.qd + r.first_dof, r.moves != 0};
  }
  articulation::PgsJointFriction<float>* friction(int32_t i) const {
    return reinterpret_cast<articulation::PgsJointFriction<float>*>(
        tree(i).rates + articulation::padded_dofs(rows(i).dof_count));
  }
  bool has_friction(int32_t i, int32_t dof) const {
    return rows(i).moves != 0 && a.joint_friction[rows(i).first_dof + dof] > 0.0f;
  }
  int32_t& root(int32_t i) const { return a.nodes[i].root; }
  int32_t find_root(int32_t i) const {
    return articulation::find_root([&](int32_t t) -> int32_t& { return root(t); }, i);
  }
  // For so many bytes, behind `used` of a tree on the stack.
  unsigned char* island_memory(int64_t used, int64_t bytes) const {
    return local != nullptr && used + bytes <= kIslandStack
               ? local + used
               : reinterpret_cast<unsigned char*>(a.memory +
                                                  a.contact_begin[group] * a.contact_stride);
  }
  const articulation::KeptContact* kept(int32_t place) const {
    const int32_t k = a.chain[place].kept;
    return k < 0 ? nullptr : a.kept + a.kept_begin[group] + k;
  }
  articulation::ContactMaterial<float> material(int32_t contact) const {
    return articulation::contact_material(a.materials, contacts, contact);
  }
};

// The rates of a tree without impulses; it is an island of its own.
inline void start_tree(const GroupStep& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  const ArticulationRows& rows = s.rows(i);
  const int32_t failed = articulation::accelerate(of.tree, s.in, s.how, of.ws);
  s.a.step.status[i] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
  if (failed < 0) articulation::free_rates(of.tree, s.in, s.how, of.ws);
  for (int32_t k = 0; k < articulation::padded_dofs(rows.dof_count); ++k)
    of.rates[k] = failed < 0 && k < rows.dof_count ? of.ws.qd_next[k] : 0.0f;
  IslandNode& node = s.a.nodes[i];
  node.root = node.last = i;
  node.next = node.first_row = node.last_row = -1;
  node.joined = node.rows = 0;
}

// Joins the trees of a contact. One that is not of this group makes a tree fail.
inline void join_contact(const GroupStep& s, int32_t place) {
  const ArticulationContactStepArguments& a = s.a;
  const int32_t contact = a.contacts[place];
  articulation::ContactSide sides[2];
  bool here = contact_sides(a.shapes, contact, sides);
  int32_t mine = a.trees[a.tree_begin[s.group]];
  for (int side = 0; side < 2; ++side) {
    if (sides[side].tree < 0) continue;
    const bool of_group = a.shapes.group_of_tree[sides[side].tree] == s.group;
    here = here && of_group;
    if (of_group) mine = sides[side].tree;
  }
  articulation::KeptContact& now = a.now[place];
  now = articulation::KeptContact{};
  now.shape0 = a.shapes.shape0[contact];
  now.shape1 = a.shapes.shape1[contact];
  a.chain[place].next = here ? -1 : -2;
  a.chain[place].kept = -1;
  if (!here)
    a.step.status[mine] = -1 - contact;
  else if (articulation::moves(a.step.in.rows, sides[0]) &&
           articulation::moves(a.step.in.rows, sides[1]))
    articulation::join_trees([&](int32_t t) -> int32_t& { return s.root(t); }, sides[0].tree,
                             sides[1].tree);
}

// Puts a contact at the end of its island's list.
inline void list_contact(const GroupStep& s, int32_t place, int32_t& next_kept) {
  const ArticulationContactStepArguments& a = s.a;
  if (a.chain[place].next == -2) return;
  const int32_t contact = a.contacts[place];
  articulation::ContactSide sides[2];
  contact_sides(a.shapes, contact, sides);
  const int32_t tree = articulation::moved_tree(a.step.in.rows, sides);
  IslandNode& node = a.nodes[s.find_root(tree)];
  (node.rows == 0 ? node.first_row : a.chain[node.last_row].next) = place;
  node.last_row = place;
  ++node.rows;
  if (articulation::joins_more(sides, s.rows(tree).dof_count)) node.joined = 1;
  if (a.warm_start == 0) return;
  const int32_t begin = a.kept_begin[s.group];
  a.chain[place].kept = articulation::find_kept(a.kept + begin, a.kept_begin[s.group + 1] - begin,
                                                next_kept, s.contacts, contact);
}

inline void take_contact(const GroupStep& s, int32_t place,
                         const articulation::ContactFrame<float>& frame, const float* impulse) {
  const int32_t contact = s.a.contacts[place];
  s.a.now[place] = articulation::kept_contact(s.contacts, contact, frame, impulse);
  s.a.force[contact] = articulation::contact_force(frame, s.a.now[place], s.how.dt);
}

// An island of one tree that touches the world.
inline articulation::IslandResult solve_alone(const GroupStep& s, int32_t root) {
  const ArticulationContactStepArguments& a = s.a;
  const IslandNode& node = a.nodes[root];
  const articulation::IslandTree of = s.tree(root);
  const int32_t dofs = of.tree.dof_count;
  const int64_t used = articulation::workspace_bytes<float>(of.tree.link_count, dofs) +
                       articulation::padded_dofs(dofs) * static_cast<int64_t>(sizeof(float));
  const int64_t bytes =
      node.rows * static_cast<int64_t>(sizeof(articulation::TreeContact<float>) +
                                       sizeof(articulation::TreeContactLink<float>)) +
      articulation::tree_contact_bytes<float>(node.rows, dofs);
  auto* const found =
      reinterpret_cast<articulation::TreeContact<float>*>(s.island_memory(used, bytes));
  auto* const links = reinterpret_cast<articulation::TreeContactLink<float>*>(found + node.rows);
  const articulation::TreeContactMemory<float> m = articulation::make_tree_contact_memory<float>(
      links + node.rows, node.rows, of.tree.dof_count);
  int32_t n = 0;
  for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next, ++n) {
    const int32_t contact = a.contacts[place];
    articulation::ContactSide sides[2];
    contact_sides(a.shapes, contact, sides);
    const int32_t side = sides[0].tree >= 0 ? 0 : 1, link = sides[side].link;
    found[n] = articulation::tree_contact(s.contacts, contact, side,
                                          a.moved_by[s.rows(root).first_link + link],
                                          s.material(contact), s.kept(place), s.warm_scale);
    const articulation::LinkState<float>& at = of.ws.links[link];
    links[n].q = at.q;
    links[n].p = at.p;
    links[n].origin = at.origin;
  }
  const articulation::TreeContactResult<float> result = articulation::solve_tree_contacts(
      of.tree, of.ws, s.law, static_cast<int32_t>(a.most_sweeps), a.tolerance.value, found, links,
      node.rows, of.qd, m, of.ws.qd_next);
  for (int32_t k = 0; k < of.tree.dof_count && a.step.status[root] == 0; ++k)
    if (!articulation::is_finite(of.ws.qd_next[k]))
      a.step.status[root] = 1 + k + s.rows(root).first_dof;
  n = 0;
  for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next, ++n)
    take_contact(s, place, m.rows[n].frame, m.rows[n].impulse);
  return {static_cast<int32_t>(result.sweeps), result.residual};
}

// Any island.
inline articulation::IslandResult solve_joined(const GroupStep& s, int32_t root) {
  const ArticulationContactStepArguments& a = s.a;
  const IslandNode& node = a.nodes[root];
  const auto tree_of = [&](int32_t i) { return s.tree(i); };
  auto* const rows =
      reinterpret_cast<articulation::IslandContact*>(s.island_memory(kIslandStack, 1));
  auto* numbers = reinterpret_cast<float*>(rows + node.rows);
  int32_t n = 0;
  for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next, ++n) {
    articulation::IslandContact& row = rows[n];
    row = articulation::IslandContact{};
    row.contact = a.contacts[place];
    contact_sides(a.shapes, row.contact, row.sides);
    int32_t widths[2];
    articulation::set_widths(a.step.in.rows, row.sides, widths);
    for (int side = 0; side < 2; ++side) row.solver.sides[side].width = widths[side];
    articulation::build_contact(s.contacts, tree_of, numbers, row);
    articulation::set_target(s.law, s.material(row.contact), row);
    numbers += 6 * (widths[0] + widths[1]);
  }
  for (int32_t i = root; i >= 0; i = a.nodes[i].next) {
    const articulation::IslandTree of = s.tree(i);
    articulation::PgsJointFriction<float>* const dry = s.friction(i);
    const int32_t dofs = of.tree.dof_count, width = articulation::padded_dofs(dofs);
    auto* const responses = reinterpret_cast<float*>(dry + dofs);
    for (int32_t k = 0; k < dofs; ++k)
      if (s.has_friction(i, k))
        articulation::build_friction(of, k, a.joint_friction[s.rows(i).first_dof + k] * s.law.dt,
                                     responses + k * width, dry[k]);
  }
  n = 0;
  for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next, ++n)
    if (const articulation::KeptContact* const kept = s.kept(place))
      articulation::start_from_kept(*kept, s.warm_scale, s.law.cone, rows[n]);
  const auto contacts = [&](bool back, const auto& f) {
    for (int32_t k = 0; k < node.rows; ++k) f(rows[back ? node.rows - 1 - k : k].solver);
  };
  const auto friction = [&](const auto& f) {
    for (int32_t i = root; i >= 0; i = a.nodes[i].next) {
      articulation::PgsJointFriction<float>* const dry = s.friction(i);
      for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
        if (s.has_friction(i, k)) f(dry[k]);
    }
  };
  const articulation::IslandResult result = articulation::sweep_island(
      s.law.cone, static_cast<int32_t>(a.most_sweeps), a.tolerance.value, contacts, friction);
  n = 0;
  for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next, ++n)
    take_contact(s, place, rows[n].frame, rows[n].solver.impulse);
  return result;
}

// Where a tree fails, its island does.
inline void solve_island(const GroupStep& s, int32_t root, articulation::IslandResult& worst) {
  const ArticulationContactStepArguments& a = s.a;
  IslandNode& node = a.nodes[root];
  int32_t status = 0;
  bool friction = false;
  for (int32_t i = root; i >= 0; i = a.nodes[i].next) {
    if (status == 0) status = a.step.status[i];
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k) friction = friction || s.has_friction(i, k);
  }
  if (status != 0) {
    const float nan = math::bits_float(0x7fc00000);
    for (int32_t i = root; i >= 0; i = a.nodes[i].next) a.step.status[i] = status;
    for (int32_t place = node.first_row; place >= 0; place = a.chain[place].next)
      a.force[a.contacts[place]] = Vec3f{nan, nan, nan};
    return;
  }
  if (node.rows == 0 && !friction) return;
  if (friction || node.rows > articulation::kMostTreeContacts) node.joined = 1;
  const articulation::IslandResult result =
      node.joined != 0 ? solve_joined(s, root) : solve_alone(s, root);
  if (worst.sweeps < result.sweeps) worst.sweeps = result.sweeps;
  if (worst.residual < result.residual) worst.residual = result.residual;
}

inline void finish_tree(const GroupStep& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  const ArticulationRows& rows = s.rows(i);
  int32_t& status = s.a.step.status[i];
  if (status == 0 && s.a.nodes[s.find_root(i)].joined != 0) {
    const int32_t failed =
        articulation::take_rates(of.rates, of.qd, s.how.dt, rows.dof_count, of.ws);
    if (failed >= 0) status = 1 + failed + rows.first_dof;
  }
  if (status != 0) return write_failure(s.a.step, rows);
  articulation::clamp_rates(of.tree, s.in, of.ws);
  write_step(s.a.step, rows, of.tree, s.in, s.how, of.ws);
}

NOVAPHY_ROW_KERNEL(articulation_contact_step, 83, ArticulationContactStepArguments) {
  const auto group = static_cast<int32_t>(row);
  const float dt = a.step.in.dt.value, kept_dt = a.warm_start != 0 ? *a.kept_dt : 0.0f;
  LocalIsland local;
  const GroupStep s(a, a.step.stride > 0 ? nullptr : local.bytes, group,
                    kept_dt > 0.0f ? dt / kept_dt : 1.0f);
  const int32_t first = a.tree_begin[group], end = a.tree_begin[group + 1];
  const int32_t first_place = a.contact_begin[group], end_place = a.contact_begin[group + 1];
  for (int32_t k = first; k < end; ++k) start_tree(s, a.trees[k]);
  for (int32_t place = first_place; place < end_place; ++place) join_contact(s, place);
  for (int32_t k = first; k < end; ++k) {
    const int32_t i = a.trees[k], root = s.find_root(i);
    if (root == i) continue;
    a.nodes[a.nodes[root].last].next = i;
    a.nodes[root].last = i;
  }
  int32_t next_kept = 0;
  for (int32_t place = first_place; place < end_place; ++place) list_contact(s, place, next_kept);
  articulation::IslandResult worst;
  for (int32_t k = first; k < end; ++k)
    if (s.root(a.trees[k]) == a.trees[k]) solve_island(s, a.trees[k], worst);
  for (int32_t k = first; k < end; ++k) finish_tree(s, a.trees[k]);
  a.sweeps[group] = worst.sweeps;
  a.residual[group] = worst.residual;
}

struct ArticulationContactKeepArguments {
  const int32_t* begin;
  const articulation::KeptContact* now;
  int32_t* kept_begin;
  articulation::KeptContact* kept;
  float* kept_dt;
  FloatWord dt;
  int64_t groups;
};
NOVAPHY_ROW_KERNEL(articulation_contact_keep, 7, ArticulationContactKeepArguments) {
  if (row == 0) *a.kept_dt = a.dt.value;
  if (row <= a.groups) a.kept_begin[row] = a.begin[row];
  if (row < a.begin[a.groups]) a.kept[row] = a.now[row];
}

}  // namespace novaphy
