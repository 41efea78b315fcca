// The adjoint of a step with contacts, for the active constraint rows (pgs.h, active_rows.h).
//
// With the converged impulses lambda, v' solves M (v' - v) = J^T lambda together with one row per
// active direction:
//   breaking (lambda_n = 0)             no row
//   normal                              J_n v' + beta + cfm lambda_n = 0
//   sticking                            J_t v' = 0
//   sliding                             lambda_t + mu lambda_n t = 0, t = w_t / |w_t|, w_t = J_t v'
//   sliding of a pyramid's tangent      lambda_t -+ mu lambda_n = 0
//   dry friction of a dof that sticks   v'_k = 0; a dof that slides: lambda -+ friction dt = 0
// The derivative of the rows is B J by the velocities and R by the impulses. B is 3 x 3 per
// contact: the identity, or mu lambda_n (1 - t t^T)/|w_t| for a sliding cone. With the gradient g
// of v', the multipliers z of the rows solve
//   (J M^-1 J^T B^T + R^T) z = J M^-1 g,   gradient of M v:  p = M^-1 (g - J^T B^T z)
// B^T z acts like impulses at the contacts: J^T B^T z is subtracted from g, and the adjoint without
// contacts does the remaining work. The gradient by a material parameter a is -z . d(rows)/da, and
// by dry friction +-dt p_k. contact_geometry.h has the gradient by the contact geometry. Source:
// the implicit function theorem.
#pragma once

#include "novaphy/dynamics/articulation/contact_geometry.h"
#include "novaphy/dynamics/articulation/contact_note.h"

namespace novaphy::articulation {

// Shifts (position corrections, pgs.h) are the last part of the step, so the adjoint treats them
// first. With the gradient h of the displacement of coordinates, the multipliers y of the shifting
// rows solve (J M^-1 J^T + softness) y = J M^-1 h, and J^T y is subtracted from h and thus from g.
// With p_h = M^-1 (h - J^T y), the shift p and its multipliers mu, the geometry contributes
//   -p_h . dM p + mu . (dJ of p_h) - y . (dJ of (v' + p) + d beta + d(softness) mu)
// The softness has one part from j . M^-1 j of each side, with the derivative 2 x . dj - x . dM x,
// x = M^-1 j, and one part from the mass m of the trees. Its small part along other axes, 5e-5 of
// the shift, is neglected.

// Solves for the multipliers y of an island. Call this before solve_adjoint. Members of `island`,
// besides those of solve_adjoint:
//   for_shifted(f)       calls f(contact) for the shifting rows, in their order
//   move_gradient(tree)  returns h
template <class Island>
bool solve_shift_adjoint(const Island& island) {
  int64_t n = 0;
  island.for_shifted([&](const AdjointContact&) { ++n; });
  if (n == 0) return true;
  const int64_t width = n + 1;
  double* const system = island.system(n * width);
  if (system == nullptr) return false;
  const auto for_sides = [&](const AdjointContact& at, const auto& f) {
    for (int side = 0; side < 2; ++side)
      if (at.solver.sides[side].width > 0) f(at.solver.sides[side], at.sides[side].tree);
  };
  double* row = system;
  island.for_shifted([&](const AdjointContact& one) {
    double* to = row;
    island.for_shifted([&](const AdjointContact& other) {
      *to = coupling(one.solver, 0, other.solver, 0);
      if (&one == &other) *to += one.solver.softness;
      ++to;
    });
    *to = 0.0;
    for_sides(one, [&](const RowSide<float>& s, int32_t tree) {
      const float* const h = island.move_gradient(tree);
      for (int32_t x = 0; s.response != nullptr && x < island.dofs(tree); ++x)
        *to += double{s.response[x]} * h[x];
    });
    row += width;
  });
  solve_dense(system, n);
  int64_t k = 0;
  island.for_shifted([&](AdjointContact& at) {
    at.shift_z = static_cast<float>(system[k++ * width + n]);
    for_sides(at, [&](const RowSide<float>& s, int32_t tree) {
      float *const h = island.move_gradient(tree), *const g = island.rate_gradient(tree);
      for (int32_t x = 0; x < island.dofs(tree); ++x) {
        h[x] -= s.jacobian[x] * at.shift_z;
        g[x] -= s.jacobian[x] * at.shift_z;
      }
    });
  });
  return true;
}

// Returns the number of values in the linear system of an island. `held`: dofs that stick by dry
// friction.
inline int64_t adjoint_numbers(int64_t contacts, int64_t held) {
  const int64_t n = 3 * contacts + held;
  return n * (n + 1);
}

// Solves for the multipliers z of an island, and subtracts the impulses of contacts and dry
// friction from the gradients of the rates. Members of `island`:
//   for_contacts(f)     calls f(contact) for rows with impulses, in their order
//   for_sticking(f)         calls f(friction, tree) for dofs that stick by dry friction
//   system(numbers)     returns memory, or null; with null the result is false
//   rate_gradient(tree), dofs(tree)
template <class Island>
bool solve_adjoint(const Island& island, bool cone) {
  using Dry = PgsJointFriction<float>;
  int64_t contacts = 0, held = 0;
  island.for_contacts([&](const AdjointContact&) { ++contacts; });
  island.for_sticking([&](const Dry&, int32_t) { ++held; });
  double* const system = island.system(adjoint_numbers(contacts, held));
  if (system == nullptr) return false;
  const int64_t first_held = 3 * contacts, n = first_held + held, width = n + 1;
  for (int64_t k = 0; k < n * width; ++k) system[k] = 0.0;

  double* of_held = system + first_held * width;
  int64_t own = first_held;
  island.for_sticking([&](const Dry& row, int32_t tree) {
    double* other = of_held + first_held;
    island.for_sticking([&](const Dry& to, int32_t other_tree) {
      if (other_tree == tree) *other = row.response[to.dof];
      ++other;
    });
    of_held[own] += kRegularity * of_held[own];
    const float* const g = island.rate_gradient(tree);
    for (int32_t x = 0; x < island.dofs(tree); ++x) of_held[n] += double{row.response[x]} * g[x];
    of_held += width;
    ++own;
  });
  int64_t column = 0;  // column of a contact's normal
  island.for_contacts([&](AdjointContact& at) {
    const PgsContact<float>& other = at.solver;
    const ContactBranch branch = branch_of(other, cone);
    float along[2];
    slip_along(other, branch, along);
    ContactBlocks k;
    set_blocks(other, branch, cone, along, k);
    double* rows = system;
    island.for_contacts([&](const AdjointContact& one) {
      for (int i = 0; i < 3; ++i) {
        double a[3];
        for (int j = 0; j < 3; ++j) a[j] = coupling(one.solver, i, other, j);
        double* const row = rows + i * width + column;
        for (int e = 0; e < 3; ++e) {
          row[e] = (a[0] * k.b[e][0] + a[1] * k.b[e][1]) + a[2] * k.b[e][2];
          if (&one != &at) continue;
          row[e] += k.r[e][i];
          const bool slides = i > 0 && branch.slides[i - 1];
          if (e == i && !slides) row[e] += kRegularity * a[i];
        }
      }
      rows += 3 * width;
    });
    // J M^-1 g: Y times the gradient of the rates.
    for (int i = 0; i < 3; ++i) {
      double* const row = system + (column + i) * width;
      int64_t f = first_held;
      island.for_sticking([&](const Dry& dry, int32_t) {
        double y[3] = {};  // response of the contact's rows for the dof
        for (const RowSide<float>& s : other.sides) {
          if (s.response == nullptr || s.rates != dry.rates) continue;
          for (int j = 0; j < 3; ++j) y[j] += s.response[j * s.width + dry.dof];
        }
        row[f] = y[i];
        system[f * width + column + i] = (y[0] * k.b[i][0] + y[1] * k.b[i][1]) + y[2] * k.b[i][2];
        ++f;
      });
      double sum = 0.0;
      for (int side = 0; side < 2; ++side) {
        const RowSide<float>& s = other.sides[side];
        if (s.response == nullptr) continue;
        const int32_t tree = at.sides[side].tree;
        const float* const g = island.rate_gradient(tree);
        for (int32_t x = 0; x < island.dofs(tree); ++x)
          sum += double{s.response[i * s.width + x]} * g[x];
      }
      at.by_impulse[i] = static_cast<float>(row[n] = sum);
    }
    column += 3;
  });
  solve_dense(system, n);

  column = 0;
  island.for_contacts([&](AdjointContact& at) {
    const ContactBranch branch = branch_of(at.solver, cone);
    float along[2];
    slip_along(at.solver, branch, along);
    ContactBlocks k;
    set_blocks(at.solver, branch, cone, along, k);
    double z[3];
    float pull[3];
    for (int e = 0; e < 3; ++e) z[e] = system[(column + e) * width + n];
    for (int j = 0; j < 3; ++j)
      pull[j] = static_cast<float>((z[0] * k.b[0][j] + z[1] * k.b[1][j]) + z[2] * k.b[2][j]);
    at.pull = {pull[0], pull[1], pull[2]};
    at.z = {static_cast<float>(z[0]), static_cast<float>(z[1]), static_cast<float>(z[2])};
    column += 3;
  });
  int64_t f = first_held;
  island.for_sticking([&](const Dry& dry, int32_t tree) {
    float& g = island.rate_gradient(tree)[dry.dof];
    g -= static_cast<float>(system[f++ * width + n]);
  });
  island.for_contacts([&](const AdjointContact& at) {
    const float pull[3] = {at.pull.x, at.pull.y, at.pull.z};
    for (int side = 0; side < 2; ++side) {
      const RowSide<float>& s = at.solver.sides[side];
      if (s.width == 0) continue;
      const int32_t tree = at.sides[side].tree;
      float* const g = island.rate_gradient(tree);
      for (int r = 0; r < 3; ++r)
        for (int32_t x = 0; x < island.dofs(tree); ++x)
          g[x] -= s.jacobian[r * s.width + x] * pull[r];
    }
  });
  return true;
}

// Adds the derivative of the softness of a shifting row, times -y mu, to the gradients of its
// trees. Call this after solve_shift_adjoint. Overwrites the motions of the links.
template <class TreeOf, class MemoryOf>
void add_softness_gradient(const AdjointContact& row, float dt, const TreeOf& tree_of,
                           const MemoryOf& memory_of) {
  const float weight = -kShiftSoftness * row.shift_z * row.solver.shifted;
  AdjointContact of;
  of.follows = row.follows;
  of.turning = row.turning;
  of.frame = row.frame;
  of.place = row.place;
  of.solver.impulse[0] = 2.0f * dt;
  const bool itself = row.sides[0].tree == row.sides[1].tree;
  for (int side = 0; side < 2; ++side) {
    of.sides[side] = row.sides[side];
    of.cores[side] = row.cores[side];
  }
  for (int side = 0; side < 2; ++side) {
    const ContactSide& at = row.sides[side];
    const RowSide<float>& whole = row.solver.sides[itself ? 0 : side];
    if (at.tree < 0 || whole.response == nullptr) continue;
    const IslandTree on = tree_of(at.tree);
    const Tree<float>& tree = on.tree;
    Workspace<float> ws = on.ws;
    AdjointMemory<float> memory = memory_of(at.tree);
    const int32_t n = tree.dof_count;
    const float mass = row.solver.mass, by_mass = softness_of_mass(mass) / mass;
    const int32_t part = parted_link(tree, ws, row.sides);
    for (int32_t i = 0; mass > 0.0f && (side == 0 || !itself) && i < tree.link_count; ++i)
      if (hangs_on(tree, i, part))
        memory.moved_mass[i] -= row.shift_z * row.solver.shifted * by_mass;
    RowSigns signs{{0.0f, 0.0f}};
    signs.of[side] = RowSigns{}.of[side];
    float *const lambda = memory.scratch, *const x = lambda + 2 * n;
    for (int32_t k = 0; k < n; ++k) x[k] = itself ? 0.0f : whole.response[k];
    if (itself) {
      const Vec3f normal = row.frame.axes[0] * signs.of[side];
      const Vec3f point = side == 0 ? row.place.a : row.place.b;
      for (int32_t k = last_dof(tree, at.link); k >= 0; k = tree.dof_parent[k])
        x[k] = math::dot(normal, math::motion_at(ws.axes[k], point).linear);
      solve(tree, ws, x);
    }
    for (int32_t k = 0; k < n; ++k) lambda[k] = weight * x[k];
    matrix_vjp(tree, ws, memory);
    set_contact_motions(tree, x, ws, memory);
    add_contact_geometry(of, dt, tree_of, memory_of, signs);
  }
}
// Adds the effect of a tree's shifts on the gradient through its mass matrix, and sets the motions
// for add_shift_geometry. Call this after add_softness_gradient. `rates`: the rates with the shifts
// behind them.
inline void set_shift_motions(const Tree<float>& tree, const StepInputs<float>& in,
                              const StepOptions<float>& options, const float* rates,
                              Workspace<float>& ws, AdjointMemory<float>& memory) {
  const int32_t n = tree.dof_count;
  const float* const shift = rates + padded_dofs(n);
  float *const lambda = memory.scratch, *const h = lambda + n, *const x = h + n;
  for (int32_t k = 0; k < n; ++k) {
    lambda[k] = options.dt * h[k];
    x[k] = shift[k] / options.dt;
  }
  solve(tree, ws, lambda);
  matrix_vjp(tree, ws, memory);
  step_vjp_dynamics(tree, in, options, ws);
  for (int32_t k = 0; k < n; ++k) x[k] = rates[k] + shift[k];
  set_contact_motions(tree, x, ws, memory);
}
// Adds the gradients of add_contact_geometry that come from the shift of a row.
template <class TreeOf, class MemoryOf>
void add_shift_geometry(const AdjointContact& row, float dt, const TreeOf& tree_of,
                        const MemoryOf& memory_of) {
  AdjointContact of = row;
  of.solver.impulse[0] = row.solver.shifted;
  of.solver.impulse[1] = of.solver.impulse[2] = 0.0f;
  of.z = of.pull = {row.shift_z, 0.0f, 0.0f};
  of.target.slope = row.target.shift_slope;
  of.target.bounce = of.target.shift_bounce = 0.0f;  // terms of the rates, not of the shifts
  add_contact_geometry(of, dt, tree_of, memory_of);
}
// Returns the ContactNote of a contact that pushes, after solve_adjoint. tree_of(i): an IslandTree.
template <class TreeOf>
ContactNote contact_note(const AdjointContact& row, const TreeOf& tree_of) {
  const int side = row.sides[0].tree >= 0 ? 0 : 1;
  const ContactSide& at = row.sides[side];
  const Vec3f origin = tree_of(at.tree).ws.links[at.link].origin;
  const Vec3f* const axes = row.frame.axes;
  const auto world = [&](const float* x) {
    return axes[0] * x[0] + (axes[1] * x[1] + axes[2] * x[2]);
  };
  return {origin + (side == 0 ? row.place.a : row.place.b), axes[0], world(row.solver.impulse),
          world(row.by_impulse), row.follows || row.turning.is_exact ? 0 : 1};
}
// Returns whether add_contact_geometry has a contribution of the row after the adjoint of the
// rates.
inline bool has_geometry(const AdjointContact& row) {
  return row.solver.impulse[0] > 0.0f ||
         (row.solver.shifted > 0.0f && row.target.shift_bounce > 0.0f);
}

// Returns the gradients -z . d(rows)/da of a contact by its material parameters a.
inline MaterialGradient material_gradient(const ContactLaw<float>& law,
                                          const ContactMaterial<float>& of, const PairParts& parts,
                                          const AdjointContact& row) {
  const PgsContact<float>& c = row.solver;
  const double z[3] = {row.z.x, row.z.y, row.z.z};
  const auto give = [](float* shapes, const float* part, double value) {
    for (int side = 0; side < 2; ++side) shapes[side] = static_cast<float>(part[side] * value);
  };
  MaterialGradient to;
  const ContactBranch branch = branch_of(c, law.cone);
  float along[2];
  slip_along(c, branch, along);
  double by_friction[2];
  rows_by_friction(c, branch, law.cone, along, by_friction);
  give(to.mu, parts.friction, -(z[1] * by_friction[0] + z[2] * by_friction[1]));
  if (row.target.bounce > 0.0f) {
    const float y = row.target.shift_bounce > 0.0f ? row.shift_z : 0.0f;
    give(to.restitution, parts.restitution, -(z[0] + y) * row.before);
  }
  if (!law.compliant) return to;
  const double dt = law.dt, soft = dt * of.stiffness + of.damping;
  const bool spring =
      !(row.place.gap > 0.0f) && !(row.target.bounce > 0.0f) && c.bias > -law.max_depenetration;
  const double gap = spring ? row.place.gap : 0.0, impulse = c.impulse[0];
  give(to.ke, parts.softness, -z[0] * (gap * of.damping - impulse) / (soft * soft));
  give(to.kd, parts.softness, -z[0] * (-gap * of.stiffness - impulse / dt) / (soft * soft));
  return to;
}

// Returns the derivative of a dof's dry-friction impulse by the friction: the sign against the
// slip, or 0 if the dof sticks. `has`: the dof has friction with `impulse` and the bound `limit`.
// Otherwise the result is the derivative for friction that grows from 0.
inline float friction_push(bool has, float impulse, float limit, float rate) {
  if (has) return holds(impulse, limit) ? 0.0f : (impulse < 0.0f ? -1.0f : 1.0f);
  return rate > kLeastSlip ? -1.0f : (rate < -kLeastSlip ? 1.0f : 0.0f);
}

}  // namespace novaphy::articulation
