// Contacts of one tree with the world, by projected Gauss-Seidel (pgs.h).
//
// The velocities along the contact rows are w = J v + A lambda, with A = J M^-1 J^T. For a few
// contacts a sweep updates w, and the rates v are computed once after the sweeps. For more contacts
// a sweep updates v, as in contact_rows.h. The iterates are the same up to rounding.
//
// Every contact has rows over all dofs of the tree, with zeros for dofs that do not move its link.
// SIMD lanes can therefore be trees that touch with different links. A lane with fewer contacts
// than the others gets contacts that move no link and have an arbitrary normal.
#pragma once

#include "novaphy/core/team.h"
#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/articulation/pgs.h"
#include "novaphy/dynamics/articulation/rubbing.h"
#include "novaphy/dynamics/articulation/step.h"

namespace novaphy::articulation {

inline constexpr int32_t kTreeContactDofs = 32;  // largest number of dofs: bits of a branch
// Largest number of contacts for which A is computed. Lanes that are solved together must all have
// more contacts than this, or none of them.
inline constexpr int32_t kCoupledContacts = 8;

// The data of a contact before the step, without pointers.
template <class T>
struct TreeContact {
  Branches<T> moved_by{};      // bit k: dof k moves the link
  T sign{};                    // 1: the tree is side B of the contact, -1: side A
  Vec3<T> normal{};            // from A to B
  Vec3<T> core{};              // m, core point in the frame of the link's body
  Vec3<T> world{};             // m, surface point of the world's side
  T margin{}, world_margin{};  // m, core to surface, along the normal and signed
  ContactMaterial<T> material{};
  T start_normal{};  // N s, initial impulses; the tangential part is in the world frame
  Vec3<T> start_tangent{};
};
// The pose and the origin of the contact's link.
template <class T>
struct TreeContactLink {
  Quat<T> q{};
  Vec3<T> p{}, origin{};
};
template <class T>
struct TreeContactRow : PgsNumbers<T> {
  ContactFrame<T> frame = {};
};

// Memory for the contacts of a tree with n dofs.
template <class T>
struct TreeContactMemory {
  TreeContactRow<T>* rows = nullptr;
  T *jacobian = nullptr, *response = nullptr;  // {contacts, 3, n}
  T* coupling = nullptr;                       // {3 contacts, 3 contacts}: A, column-major
  T* slip = nullptr;                           // {3 contacts}: w
  T* shift = nullptr;                          // {n}: p of pgs.h
};
template <class T>
int64_t tree_contact_bytes(int64_t contacts, int64_t n) {
  const int64_t r = 3 * contacts, coupled = contacts > kCoupledContacts ? 0 : r * r;
  return contacts * static_cast<int64_t>(sizeof(TreeContactRow<T>)) +
         ((2 * r + 1) * n + r + coupled) * static_cast<int64_t>(sizeof(T)) + 8;
}
template <class T>
TreeContactMemory<T> make_tree_contact_memory(void* memory, int64_t contacts, int64_t n) {
  TreeContactMemory<T> m;
  const int64_t r = 3 * contacts;
  m.rows = static_cast<TreeContactRow<T>*>(memory);
  m.jacobian = reinterpret_cast<T*>(m.rows + contacts);
  m.response = m.jacobian + r * n;
  m.shift = m.response + r * n;
  m.slip = m.shift + n;
  m.coupling = m.slip + r;
  return m;
}

// Computes J and Y of a contact at its point.
template <class T>
void tree_contact_rows(const Tree<T>& tree, const Workspace<T>& ws, const TreeContact<T>& contact,
                       const Vec3<T>& at, const ContactFrame<T>& frame, T* jacobian, T* response) {
  const int64_t n = tree.dof_count;
  const T o = T(0.0f);
  T *const j0 = jacobian, *const j1 = j0 + n, *const j2 = j1 + n;
  T *const y0 = response, *const y1 = y0 + n, *const y2 = y1 + n;
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    const auto on = has(contact.moved_by, static_cast<int32_t>(1u << k));
    j0[k] = j1[k] = j2[k] = o;
    if (any(on)) {
      const Vec3<T> v = math::motion_at(ws.axes[k], at).linear * contact.sign;
      j0[k] = select(on, math::dot(frame.axes[0], v), o);
      j1[k] = select(on, math::dot(frame.axes[1], v), o);
      j2[k] = select(on, math::dot(frame.axes[2], v), o);
    }
    y0[k] = j0[k];
    y1[k] = j1[k];
    y2[k] = j2[k];
  }
  if (!is_sparse(tree)) {
    for (int r = 0; r < 3; ++r) solve(tree, ws, response + r * n);
    return;
  }
  for (int32_t k = tree.dof_count; k-- > 0;) {
    if (!any(has(contact.moved_by, static_cast<int32_t>(1u << k)))) continue;
    const T a0 = y0[k], a1 = y1[k], a2 = y2[k];
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j]) {
      const T l = ws.matrix[k * n + j];
      y0[j] = y0[j] - l * a0;
      y1[j] = y1[j] - l * a1;
      y2[j] = y2[j] - l * a2;
    }
    const T inverse = T(1.0f) / ws.matrix[k * n + k];
    y0[k] = a0 * inverse;
    y1[k] = a1 * inverse;
    y2[k] = a2 * inverse;
  }
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    T a0 = y0[k], a1 = y1[k], a2 = y2[k];
    for (int32_t j = tree.dof_parent[k]; j >= 0; j = tree.dof_parent[j]) {
      const T l = ws.matrix[k * n + j];
      a0 = a0 - l * y0[j];
      a1 = a1 - l * y1[j];
      a2 = a2 - l * y2[j];
    }
    y0[k] = a0;
    y1[k] = a1;
    y2[k] = a2;
  }
}

// The 3 x 3 block J_c Y_d of A, for two contacts c and d.
template <class T>
struct Coupling {
  T a[3][3];
};
template <class T>
Coupling<T> coupling(const Tree<T>& tree, const TreeContact<T>* contacts, int32_t c, int32_t d,
                     const TreeContactMemory<T>& m) {
  const int64_t n = tree.dof_count;
  const T *const j = m.jacobian + 3 * n * c, *const y = m.response + 3 * n * d;
  Coupling<T> of;
  for (auto& row : of.a)
    for (T& x : row) x = T(0.0f);
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    if (!any(has(contacts[c].moved_by, static_cast<int32_t>(1u << k)))) continue;
    for (int r = 0; r < 3; ++r)
      for (int s = 0; s < 3; ++s) of.a[r][s] = of.a[r][s] + j[r * n + k] * y[s * n + k];
  }
  return of;
}

template <class T, class Team>
void set_rubbing_steps(const Team& team, const Tree<T>& tree, const TreeContact<T>* contacts,
                       int32_t count, const TreeContactMemory<T>& m) {
  team.wait();
  for (int32_t c = team.rank; c < count; c += team.size) {
    const Coupling<T> own = coupling(tree, contacts, c, c, m);
    m.rows[c].normal_step = rubbing_step<T>(m.rows[c], own.a[0][1], own.a[0][2]);
  }
}

template <class T>
struct TreeContactResult {
  T sweeps{}, residual{}, largest{};  // as for IslandResult
};

// Computes the frame, J, Y, the slip and the target of contact c. `qd`: the tree's rates before the
// step. `v`: its rates without impulses.
template <class T>
void build_tree_contact(const Tree<T>& tree, const Workspace<T>& ws, const ContactLaw<T>& law,
                        const TreeContact<T>& contact, const TreeContactLink<T>& link, int32_t c,
                        const T* qd, const T* v, const TreeContactMemory<T>& m) {
  const int64_t n = tree.dof_count;
  const T o = T(0.0f);
  const Vec3<T> none = {o, o, o};
  TreeContactRow<T>& row = m.rows[c];
  const Vec3<T> mine =
      (link.p + math::rotate(link.q, contact.core)) + contact.normal * contact.margin;
  const Vec3<T> other = contact.world + contact.normal * contact.world_margin;
  // Points from the tree's side to the world's side; the sign turns this into A to B.
  const Vec3<T> apart = (none - link.origin) + (other - mine);
  const T gap = math::dot(apart, contact.normal) * (o - contact.sign);
  row.frame = contact_frame(contact.normal);
  T* const jacobian = m.jacobian + 3 * n * c;
  tree_contact_rows(tree, ws, contact, mine + apart * T(0.5f), row.frame, jacobian,
                    m.response + 3 * n * c);
  T before = o;
  for (int r = 0; r < 3; ++r) m.slip[3 * c + r] = o;
  for (int32_t k = 0; k < tree.dof_count; ++k) {
    if (!any(has(contact.moved_by, static_cast<int32_t>(1u << k)))) continue;
    before = before + jacobian[k] * qd[k];
    for (int r = 0; r < 3; ++r) m.slip[3 * c + r] = m.slip[3 * c + r] + jacobian[r * n + k] * v[k];
  }
  const NormalTarget<T> target = normal_target(law, contact.material, gap, before, m.slip[3 * c]);
  row.bias = target.bias;
  row.shift = target.shift;
  row.cfm = target.cfm;
  row.friction = contact.material.friction;
}

// Computes the steps and the first impulses of contact c, after build_tree_contact of all contacts.
template <class T>
void start_tree_contact(const Tree<T>& tree, const ContactLaw<T>& law,
                        const TreeContact<T>* contacts, int32_t count, int32_t c, const T& mass,
                        const TreeContactMemory<T>& m) {
  const int64_t n = tree.dof_count, rows = 3 * count;
  const T o = T(0.0f);
  TreeContactRow<T>& row = m.rows[c];
  const Coupling<T> own = coupling(tree, contacts, c, c, m);
  for (int r = 0; count <= kCoupledContacts && r < 3; ++r)
    for (int t = 0; t < 3; ++t) m.coupling[(3 * c + t) * rows + (3 * c + r)] = own.a[r][t];
  row.normal = row.apart = own.a[0][0];
  row.mass = mass;
  row.shifted = o;
  row.tangent[0] = own.a[1][1];
  row.tangent[1] = own.a[1][2];
  row.tangent[2] = own.a[2][2];
  row.reach = largest(m.response + 3 * n * c, n, o);
  set_steps<T>(law.dt, row);
  start_from<T>(row, law.cone, contacts[c].start_normal,
                math::dot(contacts[c].start_tangent, row.frame.axes[1]),
                math::dot(contacts[c].start_tangent, row.frame.axes[2]));
}

// Builds all contacts of a tree and the blocks of A, which the threads of a team share.
template <class T, class Team>
void build_tree_contacts(const Team& team, const Tree<T>& tree, const Workspace<T>& ws,
                         const ContactLaw<T>& law, const TreeContact<T>* contacts,
                         const TreeContactLink<T>* links, int32_t count, const T* qd, const T* v,
                         const TreeContactMemory<T>& m) {
  const int64_t rows = 3 * count;
  for (int32_t c = team.rank; c < count; c += team.size)
    build_tree_contact(tree, ws, law, contacts[c], links[c], c, qd, v, m);
  team.wait();
  const T mass = hanging_mass(tree, ws, -1);
  int32_t block = 0;
  for (int32_t c = 0; c < count; ++c) {
    for (int32_t b = 0; count <= kCoupledContacts && b < c; ++b) {
      if (block++ % team.size != team.rank) continue;
      const Coupling<T> of = coupling(tree, contacts, b, c, m);
      for (int r = 0; r < 3; ++r)
        for (int t = 0; t < 3; ++t) {
          m.coupling[(3 * c + t) * rows + (3 * b + r)] = of.a[r][t];
          m.coupling[(3 * b + r) * rows + (3 * c + t)] = of.a[r][t];
        }
    }
    if (block++ % team.size == team.rank)
      start_tree_contact(tree, law, contacts, count, c, mass, m);
  }
  team.wait();
}

// Computes the rates v of the tree in place, from the rates without impulses. `contacts` and
// `links`: {count}. `qd`: the tree's rates before the step. Impulses and shifts remain in the
// memory. The threads of a team share contacts, blocks of A and entries of sums. Every thread of
// the team computes the impulses of each contact, from the same numbers.
template <class T, class Team>
TreeContactResult<T> solve_tree_contacts(const Team& team, const Tree<T>& tree,
                                         const Workspace<T>& ws, const ContactLaw<T>& law,
                                         int32_t most_sweeps, const T& tolerance,
                                         const TreeContact<T>* contacts,
                                         const TreeContactLink<T>* links, int32_t count,
                                         const T* qd, const TreeContactMemory<T>& m, T* v) {
  const int64_t n = tree.dof_count, rows = 3 * count;
  const bool coupled = count <= kCoupledContacts;
  const T o = T(0.0f);
  build_tree_contacts(team, tree, ws, law, contacts, links, count, qd, v, m);
  const auto push = [&](int64_t row, const T& impulse) {
    const T* const column = coupled ? m.coupling + row * rows : m.response + row * n;
    T* const to = coupled ? m.slip : v;
    const int64_t count_to = coupled ? rows : n;
    for (int64_t r = team.rank; r < count_to; r += team.size) to[r] = to[r] + column[r] * impulse;
  };
  const auto slip_now = [&](int64_t row) {
    if (coupled) return m.slip[row];
    const T* const j = m.jacobian + row * n;
    T s0 = o, s1 = o;
    int64_t k = 0;
    for (; k + 1 < n; k += 2) {
      s0 = s0 + j[k] * v[k];
      s1 = s1 + j[k + 1] * v[k + 1];
    }
    if (k < n) s0 = s0 + j[k] * v[k];
    return s0 + s1;
  };
  // Other threads change the slips before and after.
  const auto slip_of = [&](int64_t row) {
    team.wait();
    const T slip = slip_now(row);
    team.wait();
    return slip;
  };
  for (int32_t c = 0; c < count; ++c)
    for (int32_t r = 0; r < 3; ++r)
      if (!all(m.rows[c].impulse[r] == o)) push(3 * c + r, m.rows[c].impulse[r]);

  TreeContactResult<T> result{o, o, o};
  auto active = o < T(1.0f);
  int32_t sweeps = 0;
  do {
    T worst = o;
    for (int32_t i = 0; i < count; ++i) {
      const int32_t c = sweeps % 2 != 0 ? count - 1 - i : i;
      team.wait();
      auto&& row = team.own(m.rows[c]);
      const T moved = sweep_contact<T>(
          row, law.cone, active, [&](int32_t r) { return slip_of(3 * c + r); },
          [&](int32_t r, const T& impulse) { push(3 * c + r, impulse); });
      for (int r = 0; r < 3; ++r) team.put(row.impulse[r], m.rows[c].impulse[r]);
      worst = select(moved > worst, moved, worst);
    }
    if (renews_rubbing(++sweeps)) set_rubbing_steps(team, tree, contacts, count, m);
    result.sweeps = select(active, T(static_cast<float>(sweeps)), result.sweeps);
    result.residual = select(active, worst, result.residual);
    active = both(active, negate(worst < tolerance));
  } while (sweeps < most_sweeps && any(active));
  team.wait();

  const auto add = [&](int64_t row, const T& impulse, T* to) {
    if (all(impulse == o)) return;
    const T* const y = m.response + row * n;
    for (int64_t k = team.rank; k < n; k += team.size) to[k] = to[k] + y[k] * impulse;
  };
  for (int32_t c = 0; coupled && c < count; ++c)
    for (int32_t r = 0; r < 3; ++r) add(3 * c + r, m.rows[c].impulse[r], v);
  for (int64_t k = team.rank; k < n; k += team.size)
    v[k] = v[k] + o;  // -0 becomes +0, as in sums over several terms

  for (int32_t c = 0; c < count; ++c) {
    const T size = m.rows[c].normal * m.rows[c].impulse[0];
    result.largest = select(size > result.largest, size, result.largest);
  }
  for (int64_t k = team.rank; k < n; k += team.size) m.shift[k] = o;
  active = o < o;
  for (int32_t c = 0; c < count; ++c) active = either(active, m.rows[c].shift < m.rows[c].bias);
  for (int32_t sweep = 0; sweep < kShiftSweeps && any(active); ++sweep) {
    T worst = o;
    for (int32_t c = 0; c < count; ++c) {
      team.wait();
      auto&& row = team.own(m.rows[c]);
      const T moved = sweep_shift<T>(
          row, active,
          [&] {
            T w = slip_now(3 * c);
            for (int64_t k = 0; !coupled && k < n; ++k)
              w = w + m.jacobian[3 * c * n + k] * m.shift[k];
            team.wait();
            return w;
          },
          [&](const T& impulse) {
            if (coupled)
              push(3 * c, impulse);
            else
              add(3 * c, impulse, m.shift);
          });
      team.put(row.shifted, m.rows[c].shifted);
      worst = select(moved > worst, moved, worst);
    }
    active = both(active, negate(worst < T(kShiftTolerance)));
  }
  team.wait();
  for (int32_t c = 0; coupled && c < count; ++c) add(3 * c, m.rows[c].shifted, m.shift);
  team.wait();
  return result;
}

// Returns a mask of the SIMD lanes that have contacts.
template <class T>
auto touching(const TreeContact<T>* contacts, int32_t count) {
  auto touches = T(1.0f) < T(0.0f);
  for (int32_t c = 0; c < count; ++c) touches = either(touches, has(contacts[c].moved_by, -1));
  return touches;
}
// Computes accelerations from the rates after the contacts, in qd_next, and calls renew_branches
// for the lanes with contacts.
template <class T>
bool renew_tree(const Tree<T>& tree, const StepInputs<T>& in, const StepOptions<T>& options,
                const TreeContact<T>* contacts, int32_t count, const TreeContactMemory<T>& m,
                int32_t round, Workspace<T>& ws) {
  const int64_t n = tree.dof_count;
  const T o = T(0.0f);
  const auto touches = touching(contacts, count);
  for (int64_t k = 0; k < n; ++k) {
    const T qdd = (ws.qd_next[k] - in.qd[tree.first_dof + k]) / options.dt;
    ws.qdd[k] = select(touches, qdd, ws.qdd[k]);
    ws.given[k] = o;
  }
  const bool holds = any(holds_rates(tree, ws));
  for (int64_t row = 0; holds && row < 3 * count; ++row)
    for (int64_t k = 0; k < n; ++k)
      ws.given[k] = ws.given[k] + m.jacobian[row * n + k] * m.rows[row / 3].impulse[row % 3];
  return renew_branches(tree, in, options, touches, round, ws);
}

}  // namespace novaphy::articulation
