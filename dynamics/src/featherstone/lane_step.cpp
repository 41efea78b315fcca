// The step of several trees at once, one per SIMD lane. Compiled once for each instruction set
// (dynamics/CMakeLists.txt).
#include "lane_step.h"

#include "lanes.h"
#include "novaphy/dynamics/articulation/step_vjp.h"
#include "novaphy/dynamics/articulation/tree_contacts.h"

namespace novaphy::articulation::NOVAPHY_LEVEL {
namespace {

typedef float Row __attribute__((vector_size(16)));
NOVAPHY_LANE_FN void transpose(Row (&r)[4]) {
  const Row a = __builtin_shufflevector(r[0], r[1], 0, 4, 1, 5);
  const Row b = __builtin_shufflevector(r[2], r[3], 0, 4, 1, 5);
  const Row c = __builtin_shufflevector(r[0], r[1], 2, 6, 3, 7);
  const Row d = __builtin_shufflevector(r[2], r[3], 2, 6, 3, 7);
  r[0] = __builtin_shufflevector(a, b, 0, 1, 4, 5);
  r[1] = __builtin_shufflevector(a, b, 2, 3, 6, 7);
  r[2] = __builtin_shufflevector(c, d, 0, 1, 4, 5);
  r[3] = __builtin_shufflevector(c, d, 2, 3, 6, 7);
}

// Reads `n` rows of `width` numbers for each lane, from the row first[lane] on.
void gather(const float* from, const int32_t* first, int32_t width, int32_t n, Lanes* to) {
  float* const out = reinterpret_cast<float*>(to);
  if (n < 4) {
    for (int32_t i = 0; i < n; ++i)
      for (int32_t l = 0; l < LANES; ++l)
        out[i * LANES + l] = from[static_cast<int64_t>(first[l]) * width + i];
    return;
  }
  for (int32_t l = 0; l < LANES; l += 4) {
    const float* rows[4];
    for (int32_t k = 0; k < 4; ++k) rows[k] = from + static_cast<int64_t>(first[l + k]) * width;
    for (int32_t at = 0; at < n; at += 4) {
      const int32_t i = at + 4 <= n ? at : n - 4;
      Row r[4];
      for (int32_t k = 0; k < 4; ++k) __builtin_memcpy(&r[k], rows[k] + i, sizeof(Row));
      transpose(r);
      for (int32_t k = 0; k < 4; ++k)
        __builtin_memcpy(out + (i + k) * LANES + l, &r[k], sizeof(Row));
    }
  }
}
void scatter(const Lanes* from, const int32_t* first, int32_t width, int32_t n, int32_t used,
             float* to) {
  const float* const in = reinterpret_cast<const float*>(from);
  if (n < 4) {
    for (int32_t i = 0; i < n; ++i)
      for (int32_t l = 0; l < used; ++l)
        to[static_cast<int64_t>(first[l]) * width + i] = in[i * LANES + l];
    return;
  }
  for (int32_t l = 0; l < used; l += 4) {
    const int32_t lanes = used - l < 4 ? used - l : 4;
    for (int32_t at = 0; at < n; at += 4) {
      const int32_t i = at + 4 <= n ? at : n - 4;
      Row r[4];
      for (int32_t k = 0; k < 4; ++k)
        __builtin_memcpy(&r[k], in + (i + k) * LANES + l, sizeof(Row));
      transpose(r);
      for (int32_t k = 0; k < lanes; ++k)
        __builtin_memcpy(to + static_cast<int64_t>(first[l + k]) * width + i, &r[k], sizeof(Row));
    }
  }
}

// Adds numbers of each of the `used` lanes to the rows, from the row first[lane] on.
void scatter_sum(const Lanes* from, const int32_t* first, int32_t width, int32_t n, int32_t used,
                 float* to) {
  const float* const in = reinterpret_cast<const float*>(from);
  const int32_t whole = n / 4 * 4;
  for (int32_t l = 0; l < used; l += 4) {
    const int32_t lanes = used - l < 4 ? used - l : 4;
    for (int32_t i = 0; i < whole; i += 4) {
      Row r[4];
      for (int32_t k = 0; k < 4; ++k)
        __builtin_memcpy(&r[k], in + (i + k) * LANES + l, sizeof(Row));
      transpose(r);
      for (int32_t k = 0; k < lanes; ++k) {
        float* const place = to + static_cast<int64_t>(first[l + k]) * width + i;
        Row sum;
        __builtin_memcpy(&sum, place, sizeof(Row));
        sum = sum + r[k];
        __builtin_memcpy(place, &sum, sizeof(Row));
      }
    }
  }
  for (int32_t i = whole; i < n; ++i)
    for (int32_t l = 0; l < used; ++l)
      to[static_cast<int64_t>(first[l]) * width + i] += in[i * LANES + l];
}

// Returns the size in numbers of the memory besides the workspace and the contacts.
int64_t state_numbers(const TreeShape& s) {
  int64_t numbers = s.coords + s.dofs + (7 + 6) * s.bodies;  // the next state
  for (int32_t k = 0; k < s.changing_count; ++k) {
    const StepRow of = kStepRows.at[s.changing[k]];
    numbers += of.width * s.count(of.of);
  }
  return numbers;
}
int64_t memory(const TreeShape& s, int32_t contacts) {
  return state_numbers(s) * static_cast<int64_t>(sizeof(Lanes)) +
         workspace_bytes<Lanes>(s.links, s.dofs) + 64 +
         contacts * static_cast<int64_t>(sizeof(TreeContactLink<Lanes>)) +
         tree_contact_bytes<Lanes>(contacts, s.dofs) + 64;
}

// Reads the frames of the links in contact.
void gather_links(const LaneStepArguments& a, const Workspace<Lanes>& ws,
                  TreeContactLink<Lanes>* to) {
  for (int32_t c = 0; c < a.contact_count; ++c)
    for (int32_t l = 0; l < LANES; ++l) {
      const LinkState<Lanes>& s = ws.links[a.contact_links[c * LANES + l]];
      TreeContactLink<Lanes>& link = to[c];
      link.q.x.v[l] = s.q.x.v[l];
      link.q.y.v[l] = s.q.y.v[l];
      link.q.z.v[l] = s.q.z.v[l];
      link.q.w.v[l] = s.q.w.v[l];
      link.p.x.v[l] = s.p.x.v[l];
      link.p.y.v[l] = s.p.y.v[l];
      link.p.z.v[l] = s.p.z.v[l];
      link.origin.x.v[l] = s.origin.x.v[l];
      link.origin.y.v[l] = s.origin.y.v[l];
      link.origin.z.v[l] = s.origin.z.v[l];
    }
}

// Returns the first row of each lane {lanes} in arrays that trees do not share.
const int32_t* first_rows(const LaneStepArguments& a, RowOf what) {
  return what == RowOf::Coord ? a.coord : what == RowOf::Dof ? a.dof : a.body;
}

// Reads the arrays of a step into memory from `next` on, and advances `next`.
StepInputs<Lanes> gather_inputs(const LaneStepArguments& a, Lanes*& next) {
  const TreeShape& s = a.shape;
  const Lanes* arrays[kStepArrays];
  for (size_t i = 0; i < kStepArrays; ++i)
    arrays[i] = reinterpret_cast<const Lanes*>(a.constants) + s.constant[i];
  for (int32_t k = 0; k < s.changing_count; ++k) {
    const int32_t i = s.changing[k];
    const StepRow of = kStepRows.at[i];
    const int32_t numbers = of.width * s.count(of.of);
    gather(a.in[i], first_rows(a, of.of), of.width, numbers, next);
    arrays[i] = next;
    next += numbers;
  }
  StepInputs<Lanes> in = {};
  point_arrays(in, arrays);
  in.target_mode = s.target_mode;
  return in;
}
Tree<Lanes> make_tree(const TreeShape& s, const StepInputs<Lanes>& in) {
  Tree<Lanes> tree;
  tree.link_count = s.links;
  tree.dof_count = s.dofs;
  tree.joints_in_a_row = s.joints_in_a_row;
  tree.links = s.link_rows;
  tree.dof_parent = s.dof_parent;
  set_arrays(in, 0, tree);
  return tree;
}

[[gnu::flatten]] int32_t accelerate_lanes(const Tree<Lanes>& tree, const StepInputs<Lanes>& in,
                                          const StepOptions<Lanes>& options, Mask alone,
                                          Workspace<Lanes>& ws) {
  return accelerate(tree, in, options, alone, ws);
}
[[gnu::flatten]] void finish_lanes(const Tree<Lanes>& tree, const StepInputs<Lanes>& in,
                                   const StepOptions<Lanes>& options, Workspace<Lanes>& ws,
                                   Lanes* q, Lanes* qd, Transform<Lanes>* body_q,
                                   SpatialVector<Lanes>* body_qd) {
  finish_step(tree, in, options, ws, q, qd, body_q, body_qd);
}
[[gnu::flatten]] bool renew_lanes(const Tree<Lanes>& tree, const StepInputs<Lanes>& in,
                                  const StepOptions<Lanes>& options,
                                  const TreeContact<Lanes>* contacts, int32_t count,
                                  const TreeContactMemory<Lanes>& m, int32_t round,
                                  Workspace<Lanes>& ws) {
  return renew_tree(tree, in, options, contacts, count, m, round, ws);
}
[[gnu::flatten]] int32_t solve_accelerations_of_lanes(const Tree<Lanes>& tree,
                                                      const StepInputs<Lanes>& in,
                                                      const StepOptions<Lanes>& options,
                                                      Workspace<Lanes>& ws) {
  return solve_accelerations(tree, in, options, ws);
}
[[gnu::flatten]] TreeContactResult<Lanes> solve_lanes(
    const Tree<Lanes>& tree, const Workspace<Lanes>& ws, const ContactLaw<Lanes>& law,
    const LaneStepArguments& a, const TreeContactLink<Lanes>* links, const Lanes* qd,
    const TreeContactMemory<Lanes>& m) {
  return solve_tree_contacts(Alone{}, tree, ws, law, a.most_sweeps, Lanes(a.tolerance),
                             static_cast<const TreeContact<Lanes>*>(a.contacts), links,
                             a.contact_count, qd, m, ws.qd_next);
}

bool run(const LaneStepArguments& a) {
  const TreeShape& s = a.shape;
  auto* next = static_cast<Lanes*>(a.memory);
  const auto take = [&](int64_t n) {
    Lanes* const mine = next;
    next += n;
    return mine;
  };
  const StepInputs<Lanes> in = gather_inputs(a, next);
  const Tree<Lanes> tree = make_tree(s, in);
  Lanes *const q_next = take(s.coords), *const qd_next = take(s.dofs);
  Lanes *const body_q = take(7 * s.bodies), *const body_qd = take(6 * s.bodies);
  const StepOptions<Lanes> options = options_as<Lanes>(a.options);
  Workspace<Lanes> ws = make_workspace<Lanes>(next, s.links, s.dofs);
  const auto* const contacts = static_cast<const TreeContact<Lanes>*>(a.contacts);
  const Mask alone = negate(touching(contacts, a.contact_count));
  if (accelerate_lanes(tree, in, options, alone, ws) >= 0) return false;
  free_rates(tree, in, options, ws);
  if (a.contact_count > 0) {
    auto* const links = reinterpret_cast<TreeContactLink<Lanes>*>(ws.branch + s.dofs);
    gather_links(a, ws, links);
    const TreeContactMemory<Lanes> m =
        make_tree_contact_memory<Lanes>(links + a.contact_count, a.contact_count, s.dofs);
    const ContactLaw<Lanes> law = {Lanes(a.options.dt),
                                   Lanes(a.erp),
                                   Lanes(a.slop),
                                   Lanes(a.cfm),
                                   Lanes(a.max_depenetration),
                                   Lanes(a.restitution_threshold),
                                   a.compliant,
                                   a.cone};
    TreeContactResult<Lanes> result;
    for (int32_t round = 0;; ++round) {
      result = solve_lanes(tree, ws, law, a, links, in.qd, m);
      ws.shift = m.shift;
      if (first_not_finite(ws, s.dofs) >= 0) return false;
      if (!renew_lanes(tree, in, options, contacts, a.contact_count, m, round, ws)) break;
      if (solve_accelerations_of_lanes(tree, in, options, ws) >= 0) return false;
      free_rates(tree, in, options, ws);
    }
    for (int32_t c = 0; c < a.contact_count; ++c)
      for (int32_t r = 0; r < 3; ++r) store(a.impulses + (3 * c + r) * LANES, m.rows[c].impulse[r]);
    store(a.sweeps, result.sweeps);
    store(a.residual, result.residual);
    store(a.largest, result.largest);
  }
  if (a.qdd != nullptr) {
    scatter(ws.qdd, a.dof, 1, s.dofs, a.used, a.qdd);
    for (int32_t k = 0; k < s.dofs; ++k) ws.rhs[k] = to_number(ws.branch[k]);
    scatter(ws.rhs, a.dof, 1, s.dofs, a.used, a.branch);
  }
  finish_lanes(tree, in, options, ws, q_next, qd_next, reinterpret_cast<Transform<Lanes>*>(body_q),
               reinterpret_cast<SpatialVector<Lanes>*>(body_qd));
  scatter(q_next, a.coord, 1, s.coords, a.used, a.q_next);
  scatter(qd_next, a.dof, 1, s.dofs, a.used, a.qd_next);
  scatter(body_q, a.body, 7, 7 * s.bodies, a.used, a.body_q);
  scatter(body_qd, a.body, 6, 6 * s.bodies, a.used, a.body_qd);
  return true;
}

bool step(const LaneStepArguments& a) {
  const bool done = run(a);
#if defined(__AVX__)
  _mm256_zeroupper();  // avoids the AVX-SSE transition penalty in later code
#endif
  return done;
}

using G = StepGradient<Lanes>;

int64_t vjp_memory(const TreeShape& s) {
  const int64_t gradients = 2 * s.coords + 13 * s.dofs + 19 * s.bodies + 3;
  const int64_t more = 2 * s.coords + 4 * s.dofs + 13 * s.bodies;
  return (state_numbers(s) + gradients + more) * static_cast<int64_t>(sizeof(Lanes)) +
         workspace_bytes<Lanes>(s.links, s.dofs) + adjoint_bytes<Lanes>(s.links, s.dofs) + 192;
}

[[gnu::flatten]] void vjp_lanes(const Tree<Lanes>& tree, const StepInputs<Lanes>& in,
                                const StepOptions<Lanes>& options, const Lanes* qdd,
                                const Lanes* branch, const Lanes* q_next, const Lanes* qd_next,
                                const StepOutputGradient<Lanes>& out, const G& g,
                                Workspace<Lanes>& ws, AdjointMemory<Lanes>& memory) {
  step_vjp_rates(tree, in, options, qdd, branch, q_next, qd_next, out, ws, memory);
  step_vjp_dynamics(tree, in, options, ws);
  step_vjp_solve(tree, options, ws, memory);
  step_vjp_inputs(tree, in, options, g, ws, memory);
}

void run_vjp(const LaneVjpArguments& v) {
  const LaneStepArguments& a = v.step;
  const TreeShape& s = a.shape;
  auto* next = static_cast<Lanes*>(a.memory);
  const auto take = [&](const float* from, const int32_t* first, int32_t width, int32_t rows) {
    if (from == nullptr) return static_cast<Lanes*>(nullptr);
    Lanes* const mine = next;
    next += static_cast<int64_t>(width) * rows;
    gather(from, first, width, width * rows, mine);
    return mine;
  };
  const auto dofs = [&](const float* from) { return take(from, a.dof, 1, s.dofs); };
  const auto coords = [&](const float* from) { return take(from, a.coord, 1, s.coords); };
  const StepInputs<Lanes> in = gather_inputs(a, next);
  const Tree<Lanes> tree = make_tree(s, in);
  const StepOptions<Lanes> options = options_as<Lanes>(a.options);
  const Lanes *const qdd = dofs(v.qdd), *const branch = dofs(v.branch);
  const Lanes *const q_next = coords(v.q_next), *const qd_next = dofs(v.qd_next);
  const Lanes *const out_q = coords(v.out_q), *const out_qd = dofs(v.out_qd);
  const Lanes *const out_body_q = take(v.out_body_q, a.body, 7, s.bodies), *const out_body_qd =
                                                                               take(v.out_body_qd,
                                                                                    a.body, 6,
                                                                                    s.bodies);
  const StepOutputGradient<Lanes> out = {
      out_q, out_qd, reinterpret_cast<const Transform<Lanes>*>(out_body_q),
      reinterpret_cast<const SpatialVector<Lanes>*>(out_body_qd)};
  Lanes* to[kGradientArrays] = {};
  for (size_t i = 0; i < kGradientArrays; ++i) {
    if (v.gradient[i] == nullptr) continue;
    to[i] = next;
    next += kStepRows.at[i].width * s.count(kStepRows.at[i].of);
  }
  G g = {};
  point_gradient_arrays(g, to);
  Workspace<Lanes> ws = make_workspace<Lanes>(next, s.links, s.dofs);
  AdjointMemory<Lanes> memory = make_adjoint_memory<Lanes>(ws.branch + s.dofs, s.links, s.dofs);
  vjp_lanes(tree, in, options, qdd, branch, q_next, qd_next, out, g, ws, memory);
  for (size_t i = 0; i < kGradientArrays; ++i) {
    if (to[i] == nullptr) continue;
    const StepRow of = kStepRows.at[i];
    (v.add >> i & 1 ? scatter_sum : scatter)(to[i], first_rows(a, of.of), of.width,
                                             of.width * s.count(of.of), a.used, v.gradient[i]);
  }
}
void vjp(const LaneVjpArguments& v) {
  run_vjp(v);
#if defined(__AVX__)
  _mm256_zeroupper();
#endif
}

}  // namespace

int64_t islands_memory(const LaneIslands& a);  // lane_islands.cpp
void sweep_islands(const LaneIslands& a);
extern const LaneLevel kLevel;
const LaneLevel kLevel = {NOVAPHY_LEVEL_NAME, LANES, memory,         step,
                          vjp_memory,         vjp,   islands_memory, sweep_islands};

}  // namespace novaphy::articulation::NOVAPHY_LEVEL
