// Kernels for actuators that push bodies (articulation/body_actuation.h) and for fluid forces
// (articulation/fluid.h). A kernel row is an articulation. The kernels add wrenches to body_f, and
// compute the adjoint and the tangent.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/body_actuation.h"
#include "novaphy/dynamics/articulation/fluid.h"
#include "novaphy/dynamics/articulation/kinematics_vjp.h"

namespace novaphy {

using articulation::DualFloat;
inline constexpr int32_t kPushingInputs = articulation::kActuatorInputs - articulation::kActuated;

// The arguments. The actuators of articulation i are order[first[i]] to order[first[i + 1] - 1].
// pushed: three links of the articulation per actuator, in the order of PushedBody; -1: the world.
// in: the inputs from kControl on. fluid: the arrays of fluid_place; null: no fluid. stride: floats
// of the workspace per articulation.
template <class T>
struct BodyActuationOf {
  NOVAPHY_ARGUMENTS(Given<ArticulationRows> rows; Given<articulation::Link> links;
                    Given<int32_t> first, order, pushed, axes, state;
                    Given<Transformf> frame, reference; Each<Given<float>, kPushingInputs> in;
                    Each<Given<float>, articulation::kFluidInputs> fluid; Given<Quatf> fluid_frame;
                    Given<T> q, qd; Given<Transform<T>> X_p, X_c; Given<Vec3<T>> axis, com;
                    Changed<float> workspace; Number<int64_t> stride;)
};

template <class T>
int64_t body_actuation_bytes(int64_t links, int64_t dofs) {
  return links * static_cast<int64_t>(sizeof(articulation::LinkState<T>) + sizeof(Vec3f)) +
         dofs * static_cast<int64_t>(sizeof(SpatialVector<T>) + 2 * sizeof(float));
}

// The links of an articulation at the start of a step.
template <class T>
struct PushedTree {
  articulation::Tree<T> tree;
  articulation::Workspace<T> ws;
  float* rest;  // unused memory behind the workspace

  PushedTree(const BodyActuationOf<T>& a, int64_t row) {
    const ArticulationRows& rows = a.rows[row];
    tree.link_count = rows.link_count;
    tree.dof_count = rows.dof_count;
    tree.links = a.links + rows.first_link;
    tree.first_dof = rows.first_dof;
    tree.X_p = a.X_p;
    tree.X_c = a.X_c;
    tree.axis = a.axis;
    tree.com = a.com;
    float* const memory = a.workspace + row * a.stride.value;
    ws.links = reinterpret_cast<articulation::LinkState<T>*>(memory);
    ws.axes = reinterpret_cast<SpatialVector<T>*>(ws.links + rows.link_count);
    rest = reinterpret_cast<float*>(ws.axes + rows.dof_count);
    const T *const q = a.q, *const qd = a.qd;
    articulation::link_frames(tree, q, ws);
    articulation::link_motions(tree, qd + rows.first_dof, ws);
  }
  int32_t body(int32_t link) const { return tree.links[link].body; }
  articulation::PushedBody at(int32_t link) const {
    if (link < 0) return {};
    const articulation::LinkState<T>& s = ws.links[link];
    return articulation::pushed_body<T>({s.origin + s.p, s.q}, math::motion_at(s.v, s.com),
                                        tree.com[body(link)]);
  }
};

// Calls put(link, wrench) for each body that the actuator pushes. number(input, row, k) returns
// number k in a row of an input. Inputs are counted as in ActuationInput.
template <class T, class Number, class Put>
void push(const BodyActuationOf<T>& a, const articulation::PushedBody (&bodies)[3],
          int32_t actuator, const Number& number, const Put& put) {
  const DualFloat input = articulation::actuator_input(actuator, a.state[actuator], number);
  articulation::push_bodies(bodies, a.frame[actuator], a.reference[actuator], a.axes[actuator],
                            actuator, input, number,
                            [&](int32_t which, const SpatialVector<DualFloat>& wrench) {
                              const int32_t link = a.pushed[3 * actuator + which];
                              if (link >= 0) put(link, wrench);
                            });
}
// Returns the number of an input at the index `at` of its array.
template <class T>
float pushing_number(const BodyActuationOf<T>& a, int32_t input, int32_t at) {
  return a.in[input - articulation::kActuated][at];
}

template <class T, class Number, class Put>
void push_all(const BodyActuationOf<T>& a, int64_t row, const PushedTree<T>& tree,
              const Number& number, const Put& put) {
  for (int32_t i = a.first[row]; i < a.first[row + 1]; ++i) {
    const int32_t k = a.order[i];
    const int32_t* const links = a.pushed + 3 * k;
    const articulation::PushedBody bodies[3] = {tree.at(links[0]), tree.at(links[1]),
                                                tree.at(links[2])};
    push(a, bodies, k, number, put);
  }
}

// Calls put(body, wrench) with the fluid's wrench on each body. number(place) returns the number at
// a place of the fluid's arrays.
template <class T, class Number, class Put>
void drag_all(const BodyActuationOf<T>& a, int64_t row, const PushedTree<T>& tree,
              const Number& number, const Put& put) {
  for (int32_t i = 0; a.fluid[0] != nullptr && i < tree.tree.link_count; ++i) {
    const int32_t body = tree.body(i);
    if (body < 0) continue;
    T numbers[articulation::kFluidNumbers];
    for (int32_t k = 0; k < articulation::kFluidNumbers; ++k)
      numbers[k] = number(articulation::fluid_place(k, a.rows[row].world, body));
    const articulation::LinkState<T>& s = tree.ws.links[i];
    put(body, articulation::fluid_wrench<T>(s.q, math::motion_at(s.v, s.com), numbers,
                                            a.fluid_frame[body]));
  }
}
inline SpatialVectorf tangent_of(const SpatialVector<DualFloat>& w) {
  return {{w.linear.x.tangent, w.linear.y.tangent, w.linear.z.tangent},
          {w.angular.x.tangent, w.angular.y.tangent, w.angular.z.tangent}};
}

struct BodyActuationArguments {
  NOVAPHY_ARGUMENTS(Part<BodyActuationOf<float>> in; Given<SpatialVectorf> body_f;
                    Changed<SpatialVectorf> out;)
};
NOVAPHY_ROW_KERNEL(body_actuation, BodyActuationArguments) {
  const PushedTree<float> tree(a.in, row);
  for (int32_t i = 0; i < tree.tree.link_count; ++i)
    if (tree.body(i) >= 0) a.out[tree.body(i)] = a.body_f[tree.body(i)];
  push_all(
      a.in, row, tree,
      [&](int32_t input, int32_t of, int32_t k) {
        return DualFloat(
            pushing_number(a.in, input, of * articulation::numbers_of_input(input) + k));
      },
      [&](int32_t link, const SpatialVector<DualFloat>& w) {
        SpatialVectorf& to = a.out[tree.body(link)];
        to = to + SpatialVectorf{{w.linear.x.value, w.linear.y.value, w.linear.z.value},
                                 {w.angular.x.value, w.angular.y.value, w.angular.z.value}};
      });
  drag_all(
      a.in, row, tree,
      [&](const articulation::FluidPlace& from) { return a.in.fluid[from.input][from.at]; },
      [&](int32_t body, const SpatialVectorf& w) { a.out[body] = a.out[body] + w; });
}

// The arguments of the tangent. Null tangents are zero.
struct BodyActuationJvpArguments {
  NOVAPHY_ARGUMENTS(Part<BodyActuationOf<DualFloat>> in; Each<Given<float>, kPushingInputs> tangent;
                    Each<Given<float>, articulation::kFluidInputs> fluid;
                    Given<SpatialVectorf> body_f; Changed<SpatialVectorf> out;)
};
NOVAPHY_ROW_KERNEL(body_actuation_jvp, BodyActuationJvpArguments) {
  const PushedTree<DualFloat> tree(a.in, row);
  for (int32_t i = 0; i < tree.tree.link_count; ++i)
    if (tree.body(i) >= 0)
      a.out[tree.body(i)] = a.body_f != nullptr ? a.body_f[tree.body(i)] : SpatialVectorf{};
  push_all(
      a.in, row, tree,
      [&](int32_t input, int32_t of, int32_t k) {
        const int32_t at = of * articulation::numbers_of_input(input) + k;
        const float* const t = a.tangent[input - articulation::kActuated];
        return DualFloat(pushing_number(a.in, input, at), t != nullptr ? t[at] : 0.0f);
      },
      [&](int32_t link, const SpatialVector<DualFloat>& w) {
        SpatialVectorf& to = a.out[tree.body(link)];
        to = to + tangent_of(w);
      });
  drag_all(
      a.in, row, tree,
      [&](const articulation::FluidPlace& from) {
        const float* const t = a.fluid[from.input];
        return DualFloat(a.in.fluid[from.input][from.at], t != nullptr ? t[from.at] : 0.0f);
      },
      [&](int32_t body, const SpatialVector<DualFloat>& w) {
        a.out[body] = a.out[body] + tangent_of(w);
      });
}

// The arguments of the adjoint, which adds to the gradients of the inputs. Null: not requested.
// out: the gradient of the result. poses, motions: scratch memory {bodies}. A kernel row has
// `trees` articulations. If gradients by arrays of worlds are requested, one row has all
// articulations, so that the order of the sums is fixed.
struct BodyActuationVjpArguments {
  NOVAPHY_ARGUMENTS(Part<BodyActuationOf<float>> in; Given<SpatialVectorf> out;
                    Each<Changed<float>, kPushingInputs> gradient;
                    Each<Changed<float>, articulation::kFluidInputs> fluid; Changed<float> q, qd;
                    Changed<Vec3f> com; Changed<SpatialVectorf> body_f; Changed<Transformf> poses;
                    Changed<SpatialVectorf> motions; Number<int64_t> trees;)
};
inline float dot_tangent(const SpatialVectorf& g, const SpatialVector<DualFloat>& w) {
  return (g.linear.x * w.linear.x.tangent + g.linear.y * w.linear.y.tangent) +
         (g.linear.z * w.linear.z.tangent + g.angular.x * w.angular.x.tangent) +
         (g.angular.y * w.angular.y.tangent + g.angular.z * w.angular.z.tangent);
}
// Adds the gradient by the pose and the velocity of a body, in the order of number_of.
inline void add_to_body(const BodyActuationVjpArguments& a, int32_t body, const float* g) {
  Transformf& pose = a.poses[body];
  pose = {pose.p + Vec3f{g[0], g[1], g[2]},
          {pose.q.x + g[3], pose.q.y + g[4], pose.q.z + g[5], pose.q.w + g[6]}};
  a.motions[body] = a.motions[body] + SpatialVectorf{{g[7], g[8], g[9]}, {g[10], g[11], g[12]}};
}
// Adds the gradients by the inputs of the fluid force, one number of a body at a time.
inline void drag_gradient(const BodyActuationVjpArguments& a, int64_t row,
                          const PushedTree<float>& tree) {
  constexpr int32_t kFirst = 3, kOfBody = 13;  // in number_of: rotation, velocity, angular velocity
  for (int32_t i = 0; a.in.fluid[0] != nullptr && i < tree.tree.link_count; ++i) {
    const int32_t body = tree.body(i);
    if (body < 0) continue;
    articulation::PushedBody at = tree.at(i);
    DualFloat numbers[articulation::kFluidNumbers];
    float of_body[kOfBody] = {};
    const auto place = [&](int32_t k) {
      return articulation::fluid_place(k, a.in.rows[row].world, body);
    };
    for (int32_t k = 0; k < articulation::kFluidNumbers; ++k)
      numbers[k] = DualFloat(a.in.fluid[place(k).input][place(k).at]);
    for (int32_t k = kFirst; k < kOfBody + articulation::kFluidNumbers; ++k) {
      const bool is_of_body = k < kOfBody;
      DualFloat& along = is_of_body ? articulation::number_of(at, k) : numbers[k - kOfBody];
      along.tangent = 1.0f;
      const float sum =
          dot_tangent(a.out[body], articulation::fluid_wrench<DualFloat>(
                                       at.pose.q, at.motion, numbers, a.in.fluid_frame[body]));
      along.tangent = 0.0f;
      if (is_of_body) {
        of_body[k] = sum;
      } else if (const auto to = place(k - kOfBody); a.fluid[to.input] != nullptr) {
        a.fluid[to.input][to.at] += sum;
      }
    }
    add_to_body(a, body, of_body);
  }
}
// Adds the gradients by the inputs of one actuator, one number at a time.
inline void push_gradient(const BodyActuationVjpArguments& a, const PushedTree<float>& tree,
                          int32_t actuator, Vec3f* com) {
  const int32_t* const links = a.in.pushed + 3 * actuator;
  articulation::PushedBody bodies[3] = {tree.at(links[0]), tree.at(links[1]), tree.at(links[2])};
  int32_t of_input = -1, of_number = 0;
  const auto directional = [&] {
    float sum = 0.0f;
    push(
        a.in, bodies, actuator,
        [&](int32_t input, int32_t of, int32_t k) {
          const int32_t at = of * articulation::numbers_of_input(input) + k;
          return DualFloat(pushing_number(a.in, input, at),
                           input == of_input && k == of_number ? 1.0f : 0.0f);
        },
        [&](int32_t link, const SpatialVector<DualFloat>& w) {
          sum += dot_tangent(a.out[tree.body(link)], w);
        });
    return sum;
  };
  for (int32_t i = 0; i < kPushingInputs + articulation::kPushed; ++i) {
    const bool is_input = i < kPushingInputs;
    of_input = is_input ? articulation::kActuated + i : -1;
    const int32_t which = i - kPushingInputs;
    const int32_t row = of_input == articulation::kActivation ? a.in.state[actuator] : actuator;
    float* to = nullptr;
    if (is_input) to = a.gradient[i];
    int32_t count = 0;
    if (to != nullptr && row >= 0) count = articulation::numbers_of_input(of_input);
    if (!is_input && links[which] >= 0) count = articulation::kPushedNumbers;
    float of_body[articulation::kPushedNumbers];
    for (of_number = 0; of_number < count; ++of_number) {
      if (!is_input) articulation::number_of(bodies[which], of_number).tangent = 1.0f;
      const float sum = directional();
      if (is_input)
        to[row * count + of_number] += sum;
      else
        of_body[of_number] = sum;
      if (!is_input) articulation::number_of(bodies[which], of_number).tangent = 0.0f;
    }
    if (is_input || count == 0) continue;
    const float* const g = of_body;
    add_to_body(a, tree.body(links[which]), g);
    com[links[which]] = com[links[which]] + Vec3f{g[13], g[14], g[15]};
  }
}
inline void body_gradient(const BodyActuationVjpArguments& a, int64_t row) {
  PushedTree<float> at(a.in, row);
  const articulation::Tree<float>& tree = at.tree;
  float *const q = at.rest, *const qd = q + tree.dof_count;
  Vec3f* const com = reinterpret_cast<Vec3f*>(qd + tree.dof_count);
  for (int32_t i = 0; i < tree.link_count; ++i) {
    const int32_t body = at.body(i);
    if (body < 0) continue;
    a.poses[body] = Transformf{};
    a.poses[body].q.w = 0.0f;
    a.motions[body] = SpatialVectorf{};
    if (a.body_f != nullptr) a.body_f[body] = a.body_f[body] + a.out[body];
  }
  for (int32_t i = 0; i < tree.link_count; ++i) com[i] = Vec3f{};
  for (int32_t i = a.in.first[row]; i < a.in.first[row + 1]; ++i)
    push_gradient(a, at, a.in.order[i], com);
  drag_gradient(a, row, at);
  const auto add_com = [&] {
    for (int32_t i = 0; a.com != nullptr && i < tree.link_count; ++i)
      if (at.body(i) >= 0) a.com[at.body(i)] = a.com[at.body(i)] + com[i];
  };
  add_com();  // first the gradient through the arms, then that through the kinematics
  const Transformf* const poses = a.poses;
  const SpatialVectorf* const motions = a.motions;
  articulation::KinematicsGradient<float> g{q, qd, com};
  articulation::kinematics_vjp(tree, a.in.qd + tree.first_dof, poses, motions, at.ws, g);
  add_com();
  for (int32_t k = 0; a.qd != nullptr && k < tree.dof_count; ++k) a.qd[tree.first_dof + k] += qd[k];
  const float* const at_q = a.in.q;
  if (a.q != nullptr)
    articulation::tangent_to_gradient(tree, at_q, q,
                                      [&](int32_t to, float value) { a.q[to] += value; });
}
NOVAPHY_ROW_KERNEL(body_actuation_vjp, BodyActuationVjpArguments) {
  const int64_t first = row * a.trees.value;
  for (int64_t k = 0; k < a.trees.value; ++k) body_gradient(a, first + k);
}

}  // namespace novaphy
