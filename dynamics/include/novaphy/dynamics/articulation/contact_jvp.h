// Tangents of contacts and dry friction for the active constraint rows: the transpose of
// contact_adjoint.h. First, the step runs with dual numbers and constant impulses, which gives the
// derivatives r of the rows. Then the tangents lambda' of the impulses solve (B J M^-1 J^T + R)
// lambda' = -r, with B and R of contact_adjoint.h. Freestanding: shared by host and device kernels.
// Members of the template argument `trees`:
//   tree(i), workspace(i)   tree i with dual numbers, after free_rates
//   turning(contact)        the DualTurning of a contact (moving contact point)
#pragma once

#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/articulation/dual_turning.h"

namespace novaphy::articulation {

// A tree's part of a contact row: J and Y = M^-1 J^T, {3, dofs} each. tree -1: no tree.
struct DualSide {
  int32_t tree = -1, dofs = 0;
  DualFloat *jacobian = nullptr, *response = nullptr;
};
// A contact with dual rows. The base class IslandContact has only these members set: the contact,
// its sides, `follows`, and the widths and impulses of `solver`.
struct DualContact : IslandContact {
  DualSide moved[2];
  NormalTarget<DualFloat> goal;
  DualFloat mu;
  float softness_tangent = 0.0f;
  Vec3f change{};  // tangent of the contact's impulse, world axes
};
inline int64_t dual_contact_numbers(int32_t dofs) { return 12 * static_cast<int64_t>(dofs); }

using DualMaterials = MaterialsOf<DualFloat>;

inline ContactLaw<DualFloat> dual_law(const ContactLaw<float>& f) {
  return {DualFloat(f.dt),
          DualFloat(f.erp),
          DualFloat(f.slop),
          DualFloat(f.cfm),
          DualFloat(f.max_depenetration),
          DualFloat(f.restitution_threshold),
          f.compliant,
          f.cone};
}

// Returns J qd for `qd` (indexed as in the model's arrays). Null qd: J times the new rates.
template <class Trees>
DualFloat dual_slip(const DualContact& row, int r, const Trees& trees, const DualFloat* qd) {
  DualFloat sum(0.0f);
  for (const DualSide& m : row.moved) {
    if (m.tree < 0) continue;
    const DualFloat* const rates =
        qd != nullptr ? qd + trees.tree(m.tree).first_dof : trees.workspace(m.tree).qd_next;
    for (int32_t k = 0; k < m.dofs; ++k) sum = sum + m.jacobian[r * m.dofs + k] * rates[k];
  }
  return sum;
}
// Returns the coupling J_i Y_j of row i of contact a and row j of contact b.
inline double dual_coupling(const DualContact& a, int i, const DualContact& b, int j) {
  double sum = 0.0;
  for (const DualSide& s : a.moved)
    for (const DualSide& t : b.moved)
      for (int32_t k = 0; s.tree >= 0 && s.tree == t.tree && k < s.dofs; ++k)
        sum += double{s.jacobian[i * s.dofs + k].value} * t.response[j * t.dofs + k].value;
  return sum;
}
// Returns the change of a dof's rate per impulse along row j.
inline double dual_response(const DualContact& row, int j, int32_t tree, int32_t dof) {
  double sum = 0.0;
  for (const DualSide& m : row.moved)
    if (m.tree == tree) sum += m.response[j * m.dofs + dof].value;
  return sum;
}
template <class Trees>
void dual_push(const DualContact& row, int r, const DualFloat& impulse, const Trees& trees) {
  for (const DualSide& m : row.moved) {
    if (m.tree < 0) continue;
    DualFloat* const rates = trees.workspace(m.tree).qd_next;
    for (int32_t k = 0; k < m.dofs; ++k) rates[k] = rates[k] + m.response[r * m.dofs + k] * impulse;
  }
}

// Sets the impulse along the axes of the contact frame, and its tangent due to the rotation of the
// axes.
inline void set_impulse(const Vec3f& impulse, const ContactFrame<DualFloat>& frame,
                        DualContact& row) {
  const float along[3] = {impulse.x, impulse.y, impulse.z};
  for (int r = 0; r < 3; ++r) {
    row.solver.impulse[r] = along[r];
    row.frame.axes[r] = value_of(frame.axes[r]);
    row.change = row.change + tangent(frame.axes[r]) * along[r];
  }
}
// Applies the tangent of the impulse along axis r.
template <class Trees>
void change_impulse(DualContact& row, int r, float change, const Trees& trees) {
  dual_push(row, r, DualFloat(0.0f, change), trees);
  row.change = row.change + row.frame.axes[r] * change;
}

// Builds the rows of a contact at the rates without impulses. `numbers`: memory of
// dual_contact_numbers(largest dof count).
template <class Trees>
void build_dual_contact(const ContactRows& c, const Trees& trees, const DualFloat* qd,
                        const ContactLaw<DualFloat>& law, const DualMaterials& of,
                        const Vec3f& impulse, DualFloat* numbers, DualContact& row) {
  const int32_t at = row.contact;
  const DualTurning turning = trees.turning(row);
  const Vec3<DualFloat> normal = turning.is_exact ? turning.normal : constant(c.normal[at]);
  const ContactFrame<DualFloat> frame = contact_frame(normal);
  SurfacePoint<DualFloat> points[2];
  for (int side = 0; side < 2; ++side) {
    const ContactSide& on = row.sides[side];
    const Vec3<DualFloat> core = constant(side == 0 ? c.point0[at] : c.point1[at]),
                          out = normal * DualFloat(side == 0 ? c.margin0[at] : -c.margin1[at]);
    points[side] = world_point(core, out);
    if (on.tree >= 0)
      points[side] = surface_point(trees.workspace(on.tree).links[on.link], core, out);
  }
  for (int side = 0; turning.is_exact && side < 2; ++side)
    set_tangent(turning.moved[side] - tangent(points[side].origin), points[side].at);
  if (row.follows) {
    const int side = row.sides[0].tree >= 0 ? 0 : 1;
    const Vec3f moved = tangent(points[side].at + points[side].origin);
    const Vec3f n = c.normal[at], along = moved - n * math::dot(n, moved);
    set_tangent(along, points[1 - side].at);
  }
  const ContactPlace<DualFloat> place = contact_place(points[0], points[1], normal);
  const bool itself = row.sides[0].tree == row.sides[1].tree;
  for (int side = 0; side < 2; ++side) {
    DualSide& m = row.moved[side];
    m = DualSide{};
    if (row.solver.sides[side].width == 0) continue;
    m.tree = row.sides[side].tree;
    const Tree<DualFloat> tree = trees.tree(m.tree);
    const Workspace<DualFloat> w = trees.workspace(m.tree);
    m.dofs = tree.dof_count;
    m.jacobian = numbers;
    m.response = numbers + 3 * m.dofs;
    numbers += 6 * m.dofs;
    for (int32_t k = 0; k < 6 * m.dofs; ++k) m.jacobian[k] = DualFloat(0.0f);
    add_point_rows(tree, w.axes, row.sides[side].link, side == 0 ? place.a : place.b, frame,
                   DualFloat(side == 0 ? -1.0f : 1.0f), m.dofs, m.jacobian);
    if (itself)
      add_point_rows(tree, w.axes, row.sides[1].link, place.b, frame, DualFloat(1.0f), m.dofs,
                     m.jacobian);
    response_rows(tree, w, itself ? -1 : last_dof(tree, row.sides[side].link), m.dofs, m.jacobian,
                  m.response);
  }
  PgsContact<float>& solver = row.solver;
  const auto product = [&](int i, int j) {
    return static_cast<float>(dual_coupling(row, i, row, j));
  };
  solver.normal = solver.apart = product(0, 0);
  solver.tangent[0] = product(1, 1);
  solver.tangent[1] = product(1, 2);
  solver.tangent[2] = product(2, 2);
  DualFloat apart(0.0f), mass(0.0f);
  for (const DualSide& m : row.moved) {
    for (int32_t k = 0; k < m.dofs; ++k) apart = apart + m.jacobian[k] * m.response[k];
    if (m.tree >= 0)
      mass = mass + parted_mass(trees.tree(m.tree), trees.workspace(m.tree), row.sides);
  }
  solver.mass = mass.value;
  solver.reach = 0.0f;
  for (const DualSide& m : row.moved)
    for (int32_t k = 0; k < m.dofs; ++k) raise(solver.reach, math::abs(m.response[k].value));
  if (itself && row.moved[0].tree >= 0) {
    const int32_t i = row.moved[0].tree;
    const DualFloat shared = shared_in_tree(trees.tree(i), trees.workspace(i), row.sides[0].link,
                                            place.a, normal, row.moved[0].response);
    solver.apart += shared.value;
    apart = apart + shared;
  }
  row.softness_tangent = kShiftSoftness * apart.tangent + softness_of_mass(mass).tangent;
  const int32_t a = c.shape0[at], b = c.shape1[at];
  const PairParts parts = pair_parts(of, a, b, [](const DualFloat& x) { return x.value; });
  const ContactMaterial<DualFloat> material = pair_material(of, parts, a, b);
  row.goal = normal_target(law, material, place.gap, dual_slip(row, 0, trees, qd),
                           dual_slip<Trees>(row, 0, trees, nullptr));
  row.mu = material.friction;
  row.solver.bias = row.goal.bias.value;
  row.solver.shift = row.goal.shift.value;
  row.solver.cfm = row.goal.cfm.value;
  row.solver.friction = row.mu.value;
  set_steps<float>(law.dt.value, row.solver);
  set_impulse(impulse, frame, row);
}

// Applies the impulse of a dof's dry friction, with the bound `limit` = friction dt, and computes
// the response of the rates. Returns whether the dof sticks.
inline bool push_dual_friction(const Tree<DualFloat>& tree, Workspace<DualFloat>& w, int32_t dof,
                               const DualFloat& limit, float value, DualFloat* response) {
  for (int32_t k = 0; k < tree.dof_count; ++k) response[k] = DualFloat(k == dof ? 1.0f : 0.0f);
  solve(tree, w, response);
  DualFloat impulse(value);
  const bool held = holds(value, limit.value);
  if (!held) impulse.tangent = value < 0.0f ? -limit.tangent : limit.tangent;
  for (int32_t k = 0; k < tree.dof_count; ++k) w.qd_next[k] = w.qd_next[k] + response[k] * impulse;
  return held;
}
// Applies the tangent of dry friction to dofs whose friction is 0. `friction`: per dof of the
// model.
inline void push_absent_friction(const Tree<DualFloat>& tree, Workspace<DualFloat>& w,
                                 const DualFloat* friction, float dt) {
  DualFloat* const response = w.rhs;
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    const DualFloat& limit = friction[tree.first_dof + k];
    const float rate = w.qd_next[k].value;
    if (limit.value > 0.0f || limit.tangent == 0.0f || math::abs(rate) <= kLeastSlip) continue;
    for (int32_t x = 0; x < tree.dof_count; ++x)
      response[x] = DualFloat(0.0f, x == k ? (rate > 0.0f ? -dt : dt) * limit.tangent : 0.0f);
    solve(tree, w, response);
    for (int32_t x = 0; x < tree.dof_count; ++x) w.qd_next[x] = w.qd_next[x] + response[x];
  }
}

// Computes the tangents of an island's impulses, after all functions above. Members of `island`:
//   for_contacts(f)  calls f(DualContact) for contacts that push, in their order
//   for_sticking(f)      calls f(tree, dof, response) for dofs that stick by dry friction
//   system(n)        returns memory for n numbers, or null
// Returns false without memory; then nothing has changed.
template <class Trees, class Island>
bool solve_dual_island(const Trees& trees, const Island& island, bool cone) {
  int64_t contacts = 0, n = 0;
  island.for_contacts([&](const DualContact&) { contacts += 3; });
  n = contacts;
  island.for_sticking([&](int32_t, int32_t, const DualFloat*) { ++n; });
  const int64_t width = n + 1;
  double* const system = island.system(n * width);
  if (system == nullptr) return false;
  for (int64_t i = 0; i < n * width; ++i) system[i] = 0.0;
  int64_t at = 0;
  island.for_contacts([&](const DualContact& row) {
    DualFloat w[3];
    for (int r = 0; r < 3; ++r) w[r] = dual_slip<Trees>(row, r, trees, nullptr);
    const float along[2] = {w[1].value, w[2].value};
    const ContactBranch branch = branch_of(row.solver, cone);
    ContactBlocks k;
    set_blocks(row.solver, branch, cone, along, k);
    double by_friction[2];
    rows_by_friction(row.solver, branch, cone, along, by_friction);
    for (int e = 0; e < 3; ++e) {
      double* const to = system + (at + e) * width;
      int64_t column = 0;
      island.for_contacts([&](const DualContact& other) {
        for (int i = 0; i < 3; ++i) {
          double& a = to[column + i];
          for (int j = 0; j < 3; ++j)
            if (k.b[e][j] != 0.0) a += k.b[e][j] * dual_coupling(row, j, other, i);
          if (column != at) continue;
          a += k.r[e][i];
          if (e == i && (i == 0 || !branch.slides[i - 1]))
            a += kRegularity * dual_coupling(row, i, row, i);
        }
        column += 3;
      });
      island.for_sticking([&](int32_t tree, int32_t, const DualFloat* response) {
        for (const DualSide& m : row.moved)
          for (int j = 0; m.tree == tree && j < 3; ++j)
            for (int32_t x = 0; x < m.dofs; ++x)
              to[column] += k.b[e][j] * m.jacobian[j * m.dofs + x].value * response[x].value;
        ++column;
      });
      double change = 0.0;
      for (int j = 0; j < 3; ++j) change += k.b[e][j] * w[j].tangent;
      change += e == 0 ? row.goal.bias.tangent + row.goal.cfm.tangent * row.solver.impulse[0]
                       : by_friction[e - 1] * row.mu.tangent;
      to[n] = -change;
    }
    at += 3;
  });
  island.for_sticking([&](int32_t tree, int32_t dof, const DualFloat*) {
    double* const to = system + at * width;
    int64_t column = 0;
    island.for_contacts([&](const DualContact& other) {
      for (int i = 0; i < 3; ++i) to[column++] = dual_response(other, i, tree, dof);
    });
    island.for_sticking([&](int32_t of, int32_t, const DualFloat* response) {
      if (of == tree) to[column] = response[dof].value;
      ++column;
    });
    to[at] *= 1.0 + kRegularity;
    to[n] = -trees.workspace(tree).qd_next[dof].tangent;
    ++at;
  });
  solve_dense(system, n);
  at = 0;
  island.for_contacts([&](DualContact& row) {
    for (int r = 0; r < 3; ++r)
      change_impulse(row, r, static_cast<float>(system[at++ * width + n]), trees);
  });
  island.for_sticking([&](int32_t tree, int32_t, const DualFloat* response) {
    const DualFloat change(0.0f, static_cast<float>(system[at++ * width + n]));
    DualFloat* const rates = trees.workspace(tree).qd_next;
    for (int32_t k = 0; k < trees.tree(tree).dof_count; ++k)
      rates[k] = rates[k] + response[k] * change;
  });
  return true;
}

// Adds the tangents of an island's shifts (position corrections, pgs.h) to the `bias` of the
// workspaces, which must be zero before. Call this after solve_dual_island. Further members of
// `island`:
//   for_rows(f), for_shifted(f)  call f(DualContact) for all contacts, and for those that shift
template <class Trees, class Island>
bool add_dual_shifts(const Trees& trees, const Island& island) {
  const auto slip_of = [&](const DualContact& row) {
    DualFloat sum = dual_slip<Trees>(row, 0, trees, nullptr);
    for (const DualSide& m : row.moved)
      for (int32_t k = 0; m.tree >= 0 && k < m.dofs; ++k)
        sum = sum + m.jacobian[k] * trees.workspace(m.tree).bias[k];
    return sum;
  };
  const auto push = [&](const DualContact& row, const DualFloat& impulse) {
    for (const DualSide& m : row.moved)
      for (int32_t k = 0; m.tree >= 0 && k < m.dofs; ++k) {
        DualFloat& to = trees.workspace(m.tree).bias[k];
        to = to + m.response[k] * impulse;
      }
  };
  bool overlap = false;
  island.for_rows(
      [&](const DualContact& row) { overlap = overlap || row.solver.shift < row.solver.bias; });
  float moved = kShiftTolerance;
  for (int32_t k = 0; overlap && k < kShiftSweeps && !(moved < kShiftTolerance); ++k) {
    moved = 0.0f;
    island.for_rows([&](DualContact& row) {
      raise(moved, sweep_shift<float>(
                       row.solver, true, [&] { return slip_of(row).value; },
                       [&](float impulse) { push(row, DualFloat(impulse)); }));
    });
  }
  int64_t n = 0, at = 0;
  island.for_shifted([&](const DualContact&) { ++n; });
  if (n == 0) return true;
  const int64_t width = n + 1;
  double* const system = island.system(n * width);
  if (system == nullptr) return false;
  island.for_shifted([&](const DualContact& row) {
    double* const to = system + at++ * width;
    int64_t column = 0;
    island.for_shifted([&](const DualContact& other) {
      to[column] = dual_coupling(row, 0, other, 0);
      if (&row == &other) to[column] += row.solver.softness;
      ++column;
    });
    to[n] = -(double{slip_of(row).tangent} + row.goal.shift.tangent +
              double{row.softness_tangent} * row.solver.shifted);
  });
  solve_dense(system, n);
  at = 0;
  island.for_shifted([&](const DualContact& row) {
    push(row, DualFloat(0.0f, static_cast<float>(system[at++ * width + n])));
  });
  return true;
}

}  // namespace novaphy::articulation
