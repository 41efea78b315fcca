#include "diff_articulation_motion.h"

#include <algorithm>
#include <cmath>

#include "diff_articulation_duals.h"

namespace novaphy::diff::detail {
namespace {

namespace art = articulation;
using art::DualFloat;

// A subset of the contacts that a step keeps.
struct SomeContacts {
  std::vector<int32_t> shape0, shape1;
  std::vector<Vec3f> point0, point1, normal;
  std::vector<float> margin0, margin1;
  template <class Keep>
  SomeContacts(const art::ContactRows& c, const Keep& keep) {
    for (int32_t i = 0; i < c.count; ++i) {
      if (!keep(i)) continue;
      shape0.push_back(c.shape0[i]);
      shape1.push_back(c.shape1[i]);
      point0.push_back(c.point0[i]);
      point1.push_back(c.point1[i]);
      normal.push_back(c.normal[i]);
      margin0.push_back(c.margin0[i]);
      margin1.push_back(c.margin1[i]);
    }
  }
  art::ContactRows rows() const {
    return {static_cast<int32_t>(shape0.size()),
            shape0.data(),
            shape1.data(),
            nullptr,
            point0.data(),
            point1.data(),
            normal.data(),
            margin0.data(),
            margin1.data()};
  }
};

// Returns the accelerations {dofs} of a step from in.q and in.qd with contacts. NaN: the step
// fails.
std::vector<float> accelerations(const Step& s, const ArticulationArguments& in,
                                 const art::ContactRows& contacts) {
  const Unrecorded unrecorded(true);
  ArticulationStep::Shared& shared = *s.shared;
  const auto copy_of = [](const Tensor& t) {
    return std::vector<float>(static_cast<size_t>(t.size()));
  };
  std::array<std::vector<float>, 6> out;
  for (size_t i = 0; i < out.size(); ++i) out[i] = copy_of(s.outputs[i].tensor);
  std::vector<int32_t> status(static_cast<size_t>(s.count));
  const ArticulationStepArguments a = {.in = in,
                                       .q_next = direct(out[0]),
                                       .qd_next = direct(out[1]),
                                       .body_q = Untyped(out[2].data()),
                                       .body_qd = Untyped(out[3].data()),
                                       .qdd = direct(out[4]),
                                       .branch = direct(out[5]),
                                       .status = direct(status),
                                       .workspace = Untyped(nullptr),
                                       .stride = 0};
  if (s.contacts.defined() && (contacts.count > 0 || s.dry)) {
    ContactRecord record = {.dry = s.dry, .records = true};
    shared.contacts.step(a, contact_arguments(contacts), s.options, record, &*shared.trees);
  } else {
    shared.trees->step(a, *s.model, shared.all, s.options, nullptr, true);
  }
  const bool failed = std::any_of(status.begin(), status.end(), [](int32_t i) { return i != 0; });
  std::vector<float> qdd(out[1].size());
  for (size_t k = 0; k < qdd.size(); ++k)
    qdd[k] = failed ? std::nanf("") : (out[1][k] - in.arrays.qd[k]) / s.dt;
  return qdd;
}

// Returns the accelerations {dofs} without the contacts that hit in the step, and without the
// limits of the dofs `limits`.
std::vector<float> smooth_accelerations(const Step& s, ArticulationArguments in,
                                        std::span<const int32_t> limits) {
  const LiftedLimits lifted(s, limits, in);
  if (!s.contacts.defined()) return accelerations(s, in, {});
  const std::vector<int32_t>& hits = s.motion->found.hits;
  const SomeContacts others(contact_rows_of(s), [&](int32_t i) {
    return !std::binary_search(hits.begin(), hits.end(), i);
  });
  return accelerations(s, in, others.rows());
}

bool same_controls(const Step& a, const Step& b) {
  for (const int32_t m : {kAt.joint_f, kAt.body_f, kAt.target_q, kAt.target_qd})
    if (a.in(m).range()->data() != b.in(m).range()->data()) return false;
  return true;
}

// Returns the accelerations {dofs} at the end of the chain's last step. Contacts that push in the
// step continue to push.
std::vector<float> last_accelerations(const Step& s) {
  ArticulationArguments in = host_arguments(s);
  in.arrays.q = direct(numbers(s.outputs[0].tensor));
  in.arrays.qd = direct(numbers(s.outputs[1].tensor));
  if (!s.contacts.defined()) return accelerations(s, in, {});
  const KeptContacts kept = kept_contacts(s);
  const SomeContacts pushing(contact_rows_of(s),
                             [&](int32_t i) { return kept.impulses[i].x > 0.0f; });
  return accelerations(s, in, pushing.rows());
}

// The accelerations in f after a step, and for each tree whether an event continues after the step.
struct EndOfStep {
  std::vector<float> qdd;    // {dofs}
  std::vector<char> inside;  // {trees}: 1 if an event continues
  std::shared_ptr<MotionNotes> next;
  explicit EndOfStep(const Step& s) : next(s.motion->next.lock()) {
    const auto trees = static_cast<size_t>(s.count);
    inside.assign(trees, 0);
    if (next == nullptr) {
      qdd = last_accelerations(s);
      return;
    }
    qdd = next->smooth;
    if (!next->inside.empty()) inside = next->inside;
    const ArticulationRows* const rows = rows_of_step(s);
    for (size_t t = 0; t < trees && !next->after.empty(); ++t)
      for (int32_t k = rows[t].first_dof;
           inside[t] == 0 && k < rows[t].first_dof + rows[t].dof_count; ++k)
        qdd[static_cast<size_t>(k)] = next->after[static_cast<size_t>(k)];
  }
};

}  // namespace

void note_motion(const std::shared_ptr<const Step>& step,
                 const std::shared_ptr<const Step>& before) {
  const Step& s = *step;
  MotionNotes& notes = *s.motion;
  const ArticulationArguments in = host_arguments(s);
  const float* const qd_next = numbers(s.outputs[1].tensor);
  const auto dofs = static_cast<size_t>(s.in(kAt.qd).size());
  MotionNotes* const last = before ? before->motion.get() : nullptr;
  bool follows = false;  // an earlier event ends at the start of this step, or continues
  find_stops(s, last,
             [&](std::span<const int32_t> limits) { return smooth_accelerations(s, in, limits); });
  list_events(s, in, before.get());
  if (last != nullptr) {
    last->next = s.motion;
    follows = last->in_contact();
    std::vector<char> inside(static_cast<size_t>(s.count));
    for (const ContactEvent& event : last->found.events)
      for (const int32_t tree : event.trees)
        if (event.lands) inside[static_cast<size_t>(tree)] = 1;
    if (std::any_of(inside.begin(), inside.end(), [](char i) { return i != 0; }))
      notes.inside = inside;
    if (follows) notes.controls = last->stands_in_event() ? last->controls : before;
  }
  const std::vector<ContactEvent>& events = notes.found.events;
  if (std::ranges::any_of(events, &ContactEvent::has_several)) ++s.shared->motion.several;
  if (holds_searched(s, in)) ++s.shared->motion.searched;
  if (notes.found.hits.empty() && notes.found.limits.empty()) {
    notes.smooth.resize(dofs);
    for (size_t k = 0; k < dofs; ++k) notes.smooth[k] = (qd_next[k] - in.arrays.qd[k]) / s.dt;
  } else {
    notes.smooth = smooth_accelerations(s, in, notes.found.limits);
  }
  note_limits(s, last);
  if (!follows || same_controls(s, *notes.controls)) return;
  ArticulationArguments held = in;
  const ArticulationArguments of = host_arguments(*notes.controls);
  held.arrays.joint_f = of.arrays.joint_f;
  held.arrays.body_f = of.arrays.body_f;
  held.arrays.target_q = of.arrays.target_q;
  held.arrays.target_qd = of.arrays.target_qd;
  notes.after = smooth_accelerations(s, held, notes.found.limits);
}

bool holds_times(const Step& s) {
  if (nova::current_capture() == nullptr) return false;
  require(s.shared->is_auto(), ErrorKind::NotImplemented, kName,
          ": contact_gradient: \"motion\" is not supported by a backward or jvp inside a "
          "ScopedCapture; use \"code\"");
  s.shared->motion.held = "inside a ScopedCapture";
  return true;
}

void motion_vjp(const Step& s, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients, const Adjoint& run) {
  MotionNotes& notes = *s.motion;
  if (!moves_by(gradients)) return run(gradients);
  if (!notes.concerned()) return drift_vjp(s, outputs, gradients, run);
  std::vector<nova::InputGradient> all(gradients.begin(), gradients.end());
  for (const size_t i : {kAt.q, kAt.qd}) all[i] = own_gradient(s, i);
  run(all);
  float *const y_q = numbers(all[kAt.q].grad), *const y_qd = numbers(all[kAt.qd].grad);

  const EndOfStep end(s);
  const ArticulationArguments in = host_arguments(s);
  const art::StepInputs<float> inputs = articulation_inputs(in);
  const ArticulationRows* const rows = rows_of_step(s);
  const float *const q_next = numbers(s.outputs[0].tensor), *const qd_next =
                                                                numbers(s.outputs[1].tensor);
  const art::StepOutputGradient<float> out = {
      numbers(outputs[0]), numbers(outputs[1]),
      reinterpret_cast<const Transformf*>(numbers(outputs[2])),
      reinterpret_cast<const SpatialVectorf*>(numbers(outputs[3]))};
  const auto dofs = static_cast<size_t>(s.in(kAt.qd).size());
  std::vector<float> p_q(dofs), correction(dofs), tangent(dofs);
  std::vector<float> mismatch(static_cast<size_t>(s.count));
  std::vector<double> h_before(mismatch.size());
  for (size_t t = 0; t < mismatch.size(); ++t) {
    const ArticulationRows& of = rows[t];
    const art::Tree<float> tree = articulation_tree(in, of);
    std::vector<uint64_t> work(
        static_cast<size_t>(art::workspace_bytes<float>(of.link_count, of.dof_count) / 8 + 1));
    std::vector<uint64_t> memory(
        static_cast<size_t>(art::adjoint_bytes<float>(of.link_count, of.dof_count) / 8 + 1));
    auto ws = art::make_workspace<float>(work.data(), of.link_count, of.dof_count);
    auto adjoint = art::make_adjoint_memory<float>(memory.data(), of.link_count, of.dof_count);
    art::step_vjp_end(tree, inputs, q_next, qd_next, out, ws, adjoint);
    art::gradient_to_tangent(tree, inputs.q, y_q, tangent.data() + of.first_dof);
    double sum = end.inside[t] != 0 && !end.next->mismatch.empty() ? end.next->mismatch[t] : 0.0;
    for (int32_t k = 0; k < of.dof_count; ++k) {
      const auto row = static_cast<size_t>(of.first_dof + k);
      p_q[row] = adjoint.tangent[k];
      const double of_flow =
          double{tangent[row]} * in.arrays.qd[row] + double{y_qd[row]} * notes.smooth[row];
      h_before[t] += of_flow;
      sum += of_flow;
      sum -= double{adjoint.tangent[k]} * qd_next[row] + double{adjoint.rate[k]} * end.qdd[row];
    }
    mismatch[t] = static_cast<float>(sum);
  }
  if (end.next) end.next->mismatch.clear();
  delays_vjp(s, mismatch, h_before, p_q, correction, gradients);
  for (size_t t = 0; t < mismatch.size(); ++t) {
    const ArticulationRows& of = rows[t];
    double back = 0.0;
    for (int32_t k = of.first_dof; k < of.first_dof + of.dof_count; ++k)
      back += double{correction[static_cast<size_t>(k)]} * in.arrays.qd[k];
    mismatch[t] += static_cast<float>(back);
    art::tangent_to_gradient(articulation_tree(in, of), inputs.q, correction.data() + of.first_dof,
                             [&](int32_t row, float value) { y_q[row] += value; });
  }
  notes.mismatch = std::move(mismatch);
  limits_vjp(s, in, y_q, y_qd, gradients);
  for (const size_t i : {kAt.q, kAt.qd}) give_gradient(all[i], gradients[i]);
}

namespace {

// Adds to coordinates (four numbers per quaternion), rates and poses the displacement by the motion
// f = (qd, qdd) in the times `dt` {trees} (s).
void move_on(const Step& s, const float* q, const float* qd, const float* qdd,
             std::span<const float> dt, float* q_to, float* qd_to, Transformf* body_q,
             SpatialVectorf* body_qd) {
  std::vector<Tensor> none(kInputs);
  std::vector<std::vector<DualFloat>> arrays;
  const auto take = [&](const Tensor& values, const Tensor&) {
    std::vector<DualFloat>& to = arrays.emplace_back(static_cast<size_t>(values.size()));
    const float* const x = values.data<float>();
    for (size_t i = 0; i < to.size(); ++i) to[i] = {x[i], 0.0f};
    return Untyped(to.data());
  };
  const ArticulationArgumentsOf<DualFloat> a = in_memory(dual_arguments(s, nullptr, none, take));
  const ArticulationRows* const rows = rows_of_step(s);
  const auto coordinates = static_cast<size_t>(s.in(kAt.q).size());
  const auto dofs = static_cast<size_t>(s.in(kAt.qd).size());
  std::vector<DualFloat> x(coordinates), moved(coordinates), v(dofs), faster(dofs);
  for (size_t i = 0; i < coordinates; ++i) x[i] = {q[i], 0.0f};
  for (size_t t = 0; t < dt.size(); ++t) {
    if (dt[t] == 0.0f) continue;
    const ArticulationRows& of = rows[t];
    const art::Tree<DualFloat> tree = articulation_tree(a, of);
    for (int32_t k = of.first_dof; k < of.first_dof + of.dof_count; ++k) {
      v[static_cast<size_t>(k)] = {qd[k], 0.0f};
      faster[static_cast<size_t>(k)] = {qd[k], qdd[k] * dt[t]};
      if (qd_to != nullptr) qd_to[k] += qdd[k] * dt[t];
    }
    art::integrate_coordinates(tree, x.data(), v.data() + of.first_dof, DualFloat{0.0f, dt[t]},
                               moved.data());
    art::follow(tree, moved.data(), faster.data());
    for (int32_t i = 0; i < of.link_count; ++i) {
      const art::Link& link = tree.links[i];
      for (int32_t c = link.coord; c < link.coord + link.dofs + (link.dofs > 1 ? 1 : 0); ++c)
        if (q_to != nullptr) q_to[c] += moved[static_cast<size_t>(c)].tangent;
    }
    if (body_q == nullptr && body_qd == nullptr) continue;
    std::vector<uint64_t> work(
        static_cast<size_t>(art::workspace_bytes<DualFloat>(of.link_count, of.dof_count) / 8 + 1));
    auto ws = art::make_workspace<DualFloat>(work.data(), of.link_count, of.dof_count);
    art::link_frames(tree, moved.data(), ws);
    art::link_motions(tree, faster.data() + of.first_dof, ws);
    for (int32_t i = 0; i < of.link_count; ++i) {
      const int32_t body = tree.links[i].body;
      if (body < 0) continue;
      Transform<DualFloat> pose;
      SpatialVector<DualFloat> twist;
      art::write_body(0, ws.links[i], &pose, &twist);
      const auto add = [](float* to, const DualFloat* from, int n) {
        for (int k = 0; k < n; ++k) to[k] += from[k].tangent;
      };
      if (body_q != nullptr) add(&body_q[body].p.x, &pose.p.x, 7);
      if (body_qd != nullptr) add(&body_qd[body].linear.x, &twist.linear.x, 6);
    }
  }
}

}  // namespace

void motion_jvp(const Step& s, std::span<const Tensor> inputs, std::span<const Tensor> outputs,
                const Tangent& run) {
  MotionNotes& notes = *s.motion;
  if (!notes.concerned()) return run(inputs);
  const ArticulationArguments in = host_arguments(s);
  const auto trees = static_cast<size_t>(s.count), dofs = static_cast<size_t>(s.in(kAt.qd).size());
  const auto copy_of = [](const Tensor& like, const Tensor& from) {
    Tensor to(like.shape(), nova::DType::F32, Device::cpu());
    float* const x = numbers(to);
    for (int64_t i = 0; i < to.size(); ++i) x[i] = from.defined() ? numbers(from)[i] : 0.0f;
    return to;
  };
  std::vector<Tensor> moved(inputs.begin(), inputs.end());
  moved[kAt.q] = copy_of(s.in(kAt.q), inputs[kAt.q]);
  moved[kAt.qd] = copy_of(s.in(kAt.qd), inputs[kAt.qd]);
  std::vector<float> delay(trees), jump(dofs);  // jump: tangents of the new coordinates
  delays_jvp(s, in, moved, delay, jump);
  move_on(s, in.arrays.q, in.arrays.qd, notes.smooth.data(), delay, numbers(moved[kAt.q]),
          numbers(moved[kAt.qd]), nullptr, nullptr);
  limits_jvp(s, in, moved);
  run(moved);

  const EndOfStep end(s);
  record_delays(s, in, delay, jump, end.qdd, end.inside);
  std::vector<float> back(trees);
  std::vector<float> waiting(trees);
  for (size_t t = 0; t < trees; ++t) {
    const float total = delay[t] + (notes.delay.empty() ? 0.0f : notes.delay[t]);
    (end.inside[t] != 0 ? waiting : back)[t] = end.inside[t] != 0 ? total : -total;
  }
  notes.delay.clear();
  if (end.next) end.next->delay = waiting;
  const auto poses = [&](size_t i) { return i < outputs.size() ? numbers(outputs[i]) : nullptr; };
  float *const q_to = poses(0), *const qd_to = poses(1);
  auto* const body_q = reinterpret_cast<Transformf*>(poses(2));
  auto* const body_qd = reinterpret_cast<SpatialVectorf*>(poses(3));
  const float *const q_next = numbers(s.outputs[0].tensor), *const qd_next =
                                                                numbers(s.outputs[1].tensor);
  move_on(s, q_next, qd_next, end.qdd.data(), back, q_to, qd_to, body_q, body_qd);
  // If several groups hit at once, each has its own delay: a motion with the rates `jump` for 1 s.
  if (std::any_of(jump.begin(), jump.end(), [](float x) { return x != 0.0f; })) {
    const std::vector<float> none(dofs), once(trees, 1.0f);
    move_on(s, q_next, jump.data(), none.data(), once, q_to, nullptr, body_q, nullptr);
  }
}

}  // namespace novaphy::diff::detail
