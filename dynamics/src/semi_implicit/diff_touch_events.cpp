#include "diff_touch_events.h"

#include <algorithm>

#include "diff_recorded_pair.h"
#include "novaphy/dynamics/semi_implicit/diff_touches.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/spatial.h"
#include "novaphy/nova/op_list.h"

namespace novaphy::diff::detail {
namespace {

using math::cross;
using math::dot;

Vec3d load(const float* a) { return {a[0], a[1], a[2]}; }
void add(float* to, const Vec3d& a) {
  to[0] += static_cast<float>(a.x);
  to[1] += static_cast<float>(a.y);
  to[2] += static_cast<float>(a.z);
}

// turned(): the quaternion product (a, 0) q. turn_of(): the vector part of p times the conjugate of
// q.
Quat<double> turned(const Vec3d& a, const Quat<double>& q) {
  return math::multiply(Quat<double>{a.x, a.y, a.z, 0.0}, q);
}
Vec3d turn_of(const float* p, const Quat<double>& q) {
  const Quat<double> t =
      math::multiply(Quat<double>{p[0], p[1], p[2], p[3]}, Quat<double>{-q.x, -q.y, -q.z, q.w});
  return {t.x, t.y, t.z};
}
void add(float* to, const Quat<double>& q, double by) {
  to[0] += static_cast<float>(q.x * by);
  to[1] += static_cast<float>(q.y * by);
  to[2] += static_cast<float>(q.z * by);
  to[3] += static_cast<float>(q.w * by);
}

float* row(float* all, int32_t i, int32_t width) { return all + int64_t{i} * width; }

}  // namespace

Tangent SideFrame::tangent(const StateRows& raw) const {
  Tangent t{};
  if (side.particle >= 0 && raw.particle_q != nullptr) {
    t[kPosition] = load(row(raw.particle_q, side.particle, 3));
    t[kVelocity] = load(row(raw.particle_qd, side.particle, 3));
  } else if (side.body >= 0 && raw.body_q != nullptr) {
    const float *const q = row(raw.body_q, side.body, 7), *const qd =
                                                              row(raw.body_qd, side.body, 6);
    t[kTurn] = turn_of(q + 3, turn) * 2.0;
    t[kPosition] = load(q) + cross(t[kTurn], com);
    t[kVelocity] = load(qd);
    t[kSpin] = load(qd + 3);
  }
  return t;
}
void SideFrame::add_gradient(const Tangent& g, const StateRows& raw) const {
  if (side.particle >= 0 && raw.particle_q != nullptr) {
    add(row(raw.particle_q, side.particle, 3), g[kPosition]);
    add(row(raw.particle_qd, side.particle, 3), g[kVelocity]);
  } else if (side.body >= 0 && raw.body_q != nullptr) {
    float *const q = row(raw.body_q, side.body, 7), *const qd = row(raw.body_qd, side.body, 6);
    add(q, g[kPosition]);
    add(q + 3, turned(g[kTurn] + cross(com, g[kPosition]), turn), 2.0);
    add(qd, g[kVelocity]);
    add(qd + 3, g[kSpin]);
  }
}
void SideFrame::add_tangent(const Tangent& t, const StateRows& raw) const {
  if (side.particle >= 0 && raw.particle_q != nullptr) {
    add(row(raw.particle_q, side.particle, 3), t[kPosition]);
    add(row(raw.particle_qd, side.particle, 3), t[kVelocity]);
  } else if (side.body >= 0 && raw.body_q != nullptr) {
    float *const q = row(raw.body_q, side.body, 7), *const qd = row(raw.body_qd, side.body, 6);
    add(q, t[kPosition] - cross(t[kTurn], com));
    add(q + 3, turned(t[kTurn], turn), 0.5);
    add(qd, t[kVelocity]);
    add(qd + 3, t[kSpin]);
  }
}
Tangent SideFrame::gradient(const StateRows& raw) const {
  Tangent g{};
  if (side.particle >= 0 && raw.particle_q != nullptr) {
    g[kPosition] = load(row(raw.particle_q, side.particle, 3));
    g[kVelocity] = load(row(raw.particle_qd, side.particle, 3));
  } else if (side.body >= 0 && raw.body_q != nullptr) {
    const float *const q = row(raw.body_q, side.body, 7), *const qd =
                                                              row(raw.body_qd, side.body, 6);
    g[kPosition] = load(q);
    g[kTurn] = turn_of(q + 3, turn) * 0.5 - cross(com, g[kPosition]);
    g[kVelocity] = load(qd);
    g[kSpin] = load(qd + 3);
  }
  return g;
}

namespace {

constexpr double kSign[] = {1.0, -1.0};  // sign of a side in gap and slip

void add_force(const TouchSide& side, const Vec3d& force, const StateRows& to) {
  if (side.particle >= 0 && to.particle_f != nullptr)
    add(row(to.particle_f, side.particle, 3), force);
  if (side.body < 0 || to.body_f == nullptr) return;
  float* const f = row(to.body_f, side.body, 6);
  add(f, force);
  add(f + 3, cross(side.arm, force));
}
Vec3d force_gradient(const TouchSide& side, const StateRows& of) {
  if (side.particle >= 0 && of.particle_f != nullptr)
    return load(row(of.particle_f, side.particle, 3));
  if (side.body < 0 || of.body_f == nullptr) return {};
  const float* const f = row(of.body_f, side.body, 6);
  return load(f) + cross(load(f + 3), side.arm);
}

// Adds the change of the force of a ramp (a contact near its begin or end) for the tangents `x`.
void ramp_jvp(const TouchRamp& ramp, const RecordedPair& pair, const StateRows& x,
              const StateRows& to) {
  double gap = 0.0;
  Vec3d u{};
  for (size_t i = 0; i < 2; ++i) {
    const Tangent t = ramp.frames[i].tangent(x);
    const Vec3d& arm = ramp.row.sides[i].arm;
    gap += kSign[i] * dot(ramp.row.normal, t[kPosition] + cross(t[kTurn], arm));
    u = u + (t[kVelocity] + cross(t[kSpin], arm)) * kSign[i];
  }
  const auto& by = ramp.row.by_velocity;
  const Vec3d force = ramp.row.by_gap * gap + by[0] * u.x + by[1] * u.y + by[2] * u.z;
  if (pair.is_held()) return pair.add(dot(ramp.by_force, force));
  for (size_t i = 0; i < 2; ++i) add_force(ramp.row.sides[i], force * -kSign[i], to);
}
void ramp_vjp(TouchRamp& ramp, const StateRows& of, const StateRows& to) {
  Vec3d force{};
  for (size_t i = 0; i < 2; ++i) force = force + force_gradient(ramp.row.sides[i], of) * -kSign[i];
  if (AdjointRecord::current() != nullptr) ramp.by_force = force;
  const auto& by = ramp.row.by_velocity;
  const Vec3d u = {dot(by[0], force), dot(by[1], force), dot(by[2], force)};
  const Vec3d place = ramp.row.normal * dot(ramp.row.by_gap, force);
  for (size_t i = 0; i < 2; ++i) {
    const Vec3d& arm = ramp.row.sides[i].arm;
    const Vec3d p = place * kSign[i], v = u * kSign[i];
    ramp.frames[i].add_gradient({p, cross(arm, p), v, cross(arm, v)}, to);
  }
}

void start_jvp(const TouchWork& work, const StateRows& in, const StateRows& out) {
  for (const auto& ramp : work.ramps)
    if (ramp->acts()) ramp_jvp(*ramp, {work.of_record, ramp->row.first, ramp->row.second}, in, out);
  for (const auto& step : work.steps) {
    TouchEvent& event = *step->event;
    if (!event.is_window()) continue;
    if (step->number == 0) {
      event.delay = 0.0;
      for (size_t i = 0; i < 2; ++i)
        event.delay += product(event.delay_by[i], step->start[i].tangent(in));
    } else if (event.forward_at != 2 * step->number - 1) {
      event.delay = 0.0;
    }
    event.forward_at = 2 * step->number;
    for (size_t i = 0; i < 2; ++i)
      step->start[i].add_tangent(scaled(step->before[i], event.delay), out);
  }
}
// Returns the rates after a step without the force of a touch, from the rates before the step.
Tangent free_rates(const Tangent& f, double dt) {
  return {f[kPosition] + f[kVelocity] * dt, f[kTurn] + f[kSpin] * dt, f[kVelocity], f[kSpin]};
}
void end_jvp(const TouchWork& work, const StateRows& out) {
  for (const auto& step : work.steps) {
    TouchEvent& event = *step->event;
    if (!event.is_window()) continue;
    if (event.forward_at != 2 * step->number) event.delay = 0.0;
    event.forward_at = 2 * step->number + 1;
    const RecordedPair pair(work.of_record, event.first, event.second);
    for (size_t i = 0; i < 2; ++i) {
      Tangent rates = step->after[i];
      if (pair.is_held()) {
        const Tangent free = free_rates(step->before[i], work.dt);
        pair.add((product(step->costate[i], free) - product(step->costate[i], rates)) *
                 event.delay);
        rates = free;
      }
      step->end[i].add_tangent(scaled(rates, -event.delay), out);
    }
  }
}
void end_vjp(const TouchWork& work, const StateRows& of) {
  for (const auto& step : work.steps) {
    TouchEvent& event = *step->event;
    if (!event.is_window()) continue;
    if (event.backward_at != 2 * (step->number + 1)) event.mismatch = 0.0;
    event.backward_at = 2 * step->number + 1;
    for (size_t i = 0; i < 2; ++i) {
      const Tangent p = step->end[i].gradient(of);
      if (AdjointRecord::current() != nullptr) step->costate[i] = p;
      event.mismatch -= product(step->after[i], p);
    }
  }
}
void start_vjp(const TouchWork& work, const StateRows& of, const StateRows& to) {
  for (const auto& step : work.steps) {
    TouchEvent& event = *step->event;
    if (!event.is_window()) continue;
    if (event.backward_at != 2 * step->number + 1) event.mismatch = 0.0;
    event.backward_at = 2 * step->number;
    double before = 0.0;
    for (size_t i = 0; i < 2; ++i) {
      const double by_side = product(step->before[i], step->start[i].gradient(of));
      event.mismatch += by_side;
      before += by_side;
    }
    if (step->number > 0) continue;
    event.listed->h_before = before;
    event.listed->h_after = event.listed->h_before - event.mismatch;
    for (size_t i = 0; i < 2; ++i)
      step->start[i].add_gradient(scaled(event.delay_by[i], event.mismatch), to);
    event.backward_at = -1;
  }
  for (const auto& ramp : work.ramps)
    if (ramp->acts()) ramp_vjp(*ramp, of, to);
}

// Converts tensors to rows of states. The tensors are in the order of the arrays that exist.
struct RowsOf {
  std::array<bool, 6> there{};
  StateRows of(std::span<const nova::Tensor> all) const {
    std::array<float*, 6> at{};
    size_t next = 0;
    for (size_t i = 0; i < 6; ++i) {
      if (!there[i]) continue;
      const nova::Tensor& t = all[next++];
      at[i] = t.defined() ? static_cast<float*>(t.range()->data()) : nullptr;
    }
    return {at[0], at[1], at[2], at[3], at[4], at[5]};
  }
};

// Returns a copy of `from`, or zeros if `from` is undefined.
nova::Tensor copy_of(const nova::Tensor& like, const nova::Tensor& from) {
  nova::Tensor to(like.shape(), nova::DType::F32, Device::cpu());
  if (from.defined())
    std::copy_n(from.data<float>(), from.size(), static_cast<float*>(to.range()->data()));
  return to;
}

}  // namespace

std::array<Vec3d, 2> respond(const Model& m, const SideFrame& at, const Vec3d& force,
                             const Vec3d& moment) {
  if (!at.side.responds) return {};
  if (at.side.particle >= 0)
    return {force * double{m.particle_inv_mass.data()[at.side.particle]}, {}};
  const auto b = static_cast<size_t>(at.side.body);
  const Vec3d in_body = math::rotate_inverse(at.turn, moment);
  const Mat33f& inverse = m.body_inv_inertia.data()[b];
  const auto row = [&](int k) {
    return double{inverse.m[k][0]} * in_body.x + double{inverse.m[k][1]} * in_body.y +
           double{inverse.m[k][2]} * in_body.z;
  };
  return {force * double{m.body_inv_mass.data()[b]},
          math::rotate(at.turn, Vec3d{row(0), row(1), row(2)})};
}

// Returns whether a backward or jvp holds the times of contacts, because a capture records it.
bool holds_times(const TouchWork& work) {
  if (nova::current_capture() == nullptr) return false;
  require(work.may_hold, ErrorKind::NotImplemented,
          "DiffSemiImplicitSolver: contact_gradient: \"motion\" is not supported by a backward or "
          "jvp inside a ScopedCapture; use \"code\"");
  work.held = true;
  return true;
}

void record_touches(const std::shared_ptr<const TouchWork>& work, bool at_start,
                    const TouchArrays& from, const TouchArrays& to) {
  const auto tensor_of = [](const nova::Operand& o) {
    return nova::Tensor(o.range, {o.rows, o.width}, nova::DType::F32);
  };
  RowsOf rows;
  nova::CustomOp op{.name = at_start ? "touches_begin" : "touches_end",
                    .inputs = {},
                    .outputs = {},
                    .vjp = nullptr};
  for (size_t i = 0; i < 6; ++i) {
    rows.there[i] = from[i].range != nullptr;
    if (!rows.there[i]) continue;
    op.inputs.push_back(tensor_of(from[i]));
    op.outputs.push_back(tensor_of(to[i]));
  }
  const std::vector<nova::Tensor> inputs = op.inputs, outputs = op.outputs;
  op.submits_only = false;
  op.forward = [inputs, outputs] {
    for (size_t i = 0; i < inputs.size(); ++i)
      nova::submit_copy(outputs[i].range(), inputs[i].range());
  };
  op.vjp = [=](std::span<const nova::Tensor> g, std::span<const nova::InputGradient> gradients) {
    if (holds_times(*work)) {
      for (size_t i = 0; i < inputs.size(); ++i)
        if (gradients[i].wanted()) gradients[i].put(g[i]);
      return;
    }
    std::vector<nova::Tensor> of, sum;
    for (size_t i = 0; i < inputs.size(); ++i) of.push_back(copy_of(inputs[i], g[i]));
    for (const nova::Tensor& t : of) sum.push_back(copy_of(t, t));
    if (at_start)
      start_vjp(*work, rows.of(of), rows.of(sum));
    else
      end_vjp(*work, rows.of(of));
    for (size_t i = 0; i < sum.size(); ++i)
      if (gradients[i].wanted()) gradients[i].put(sum[i]);
  };
  op.jvp = [=](std::span<const nova::Tensor> in, std::span<const nova::Tensor> out) {
    if (holds_times(*work)) {
      for (size_t i = 0; i < inputs.size(); ++i)
        if (const nova::InputGradient held{out[i], false}; held.wanted()) held.put(in[i]);
      return;
    }
    std::vector<nova::Tensor> x;
    for (size_t i = 0; i < inputs.size(); ++i) {
      x.push_back(copy_of(inputs[i], in[i]));
      std::copy_n(x[i].data<float>(), x[i].size(), static_cast<float*>(out[i].range()->data()));
    }
    if (at_start)
      start_jvp(*work, rows.of(x), rows.of(out));
    else
      end_jvp(*work, rows.of(out));
  };
  {
    const nova::NoGrad no_grad;
    op.forward();
  }
  nova::Tape::active()->record_custom(std::move(op));
}

}  // namespace novaphy::diff::detail

namespace novaphy::diff {

namespace {

// Largest angle h w (radians of contact oscillation per step) at which the derivative over a whole
// touch is accurate for a touch with a lever arm. Without a lever arm it is accurate at every
// angle.
constexpr double kWindowAngle = 0.3;

}  // namespace

MotionCounts TouchList::counts() const {
  MotionCounts counts;
  counts.of_springs = true;
  counts.ramp_steps = ramp_steps;
  counts.limits = limits;
  const bool holds = std::ranges::any_of(works, [](const auto& work) { return work->held; });
  counts.held = holds ? "inside a ScopedCapture" : held;
  counts.moved = std::ranges::count_if(works, [](const auto& work) { return work->acts(); });
  for (const auto& e : events) {
    if (e->flaw == detail::TouchFlaw::Rests) continue;
    e->listed->whole = true;
    counts.add(e->listed);
    if (e->shakes || (e->is_window() && e->turns && e->stiff_angle > kWindowAngle)) ++counts.stiff;
    if (e->speed_off > detail::kMostSpeedOff) ++counts.rough;
    const bool is_soft = e->stiff_angle <= detail::kSoftAngle && !e->rubs;
    if (!e->beside.empty() && e->is_window()) ++counts.several;
    if (e->shakes || e->is_window() || is_soft) continue;
    ++(e->flaw == detail::TouchFlaw::Several ? counts.several
       : e->flaw == detail::TouchFlaw::Held  ? counts.unmoved
                                             : counts.one_sided);
  }
  return counts;
}
void TouchList::clear() {
  events.clear();
  works.clear();
  ramp_steps = limits = 0;
  held = nullptr;
}

}  // namespace novaphy::diff
