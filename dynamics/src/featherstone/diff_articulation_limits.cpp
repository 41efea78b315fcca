// Events of joint limits as springs: a limit begins or ends to push (diff_articulation_motion.h).
#include <algorithm>
#include <ranges>

#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

namespace art = articulation;

// Returns the first coordinate of a tree, and the number of its coordinates.
std::pair<int32_t, int32_t> coordinates_of(const Step& s, int32_t tree) {
  const ArticulationRows& of = rows_of_step(s)[tree];
  const auto* const links =
      static_cast<const art::Link*>(s.values[kLinks].tensor.range()->data()) + of.first_link;
  int32_t begin = INT32_MAX, end = 0;
  for (int32_t i = 0; i < of.link_count; ++i) {
    const art::Link& link = links[i];
    begin = std::min(begin, link.coord);
    end = std::max(end, link.coord + link.dofs + (link.dofs > 1 ? 1 : 0));
  }
  return {begin, std::max(end - begin, 0)};
}

namespace {

bool is_of_ball(const Step& s, int32_t tree, int32_t dof) {
  const ArticulationRows& of = rows_of_step(s)[tree];
  const auto* const links =
      static_cast<const art::Link*>(s.values[kLinks].tensor.range()->data()) + of.first_link;
  return std::any_of(links, links + of.link_count,
                     [&](const art::Link& link) { return art::is_ball(link) && link.dof == dof; });
}

// Computes the gradient of the event function g of a limit whose force ends. g is the force of the
// limit at the end of the step F_A, where the state is (`q`, `qd`).
void add_force_gradient(const art::Tree<float>& tree, const art::Link& link,
                        const art::StepInputs<float>& in, const art::StepOptions<float>& options,
                        std::span<const float> qdd, std::span<const float> branch,
                        std::span<const float> q, std::span<const float> qd,
                        art::Workspace<float>& ws, std::span<float> by_q, std::span<float> by_qd,
                        LimitEvent& event) {
  std::vector<float> of_q(q.size()), of_qd(qd.size()), by_limit(qd.size());
  of_q[static_cast<size_t>(link.coord)] = in.limit_ke[link.dof];
  of_qd[static_cast<size_t>(link.dof)] = in.limit_kd[link.dof];
  std::vector<uint64_t> memory(
      static_cast<size_t>(art::adjoint_bytes<float>(tree.link_count, tree.dof_count) / 8 + 1));
  auto adjoint = art::make_adjoint_memory<float>(memory.data(), tree.link_count, tree.dof_count);
  art::StepGradient<float> to{};
  to.q = by_q.data();
  to.qd = by_qd.data();
  (event.side > 0.0f ? to.limit_lower : to.limit_upper) = by_limit.data();
  art::step_vjp(tree, in, options, qdd.data(), branch.data(), q.data(), qd.data(),
                {of_q.data(), of_qd.data(), nullptr, nullptr}, to, ws, adjoint);
  event.by_limit = by_limit[static_cast<size_t>(link.dof)] - in.limit_ke[link.dof];
}

// Adds the event of a dof whose limit pushes in only one of two consecutive steps. `acted`: the
// limit pushed in the first of these steps.
void add_limit_event(const Step& s, int32_t t, int32_t dof, bool acted) {
  const ArticulationArguments in = host_arguments(s);
  const ArticulationRows& of = rows_of_step(s)[t];
  const art::Tree<float> tree = articulation_tree(in, of);
  const art::StepInputs<float> inputs = articulation_inputs(in);
  const art::StepOptions<float> options = articulation_options(in);
  const art::Link* link = tree.links;
  while (link->dof != dof) ++link;
  const std::vector<float>& now = s.motion->branch;
  std::vector<float> branch = now;
  const auto bits = static_cast<int32_t>(now[static_cast<size_t>(dof)]);
  const bool released = (bits & art::kLimitReleased) != 0;
  if (!acted && (bits & art::kOutside) == 0) return;
  // F_A is the step with the dof's branch from before the event.
  int32_t other = bits & ~(art::kOutside | art::kLimitReleased);
  if (acted && released) other |= bits & art::kOutside;
  if (acted && !released) return;  // within the limits again: the force ended earlier
  branch[static_cast<size_t>(dof)] = static_cast<float>(other);
  std::vector<uint64_t> work(
      static_cast<size_t>(art::workspace_bytes<float>(of.link_count, of.dof_count) / 8 + 1));
  auto ws = art::make_workspace<float>(work.data(), of.link_count, of.dof_count);
  if (art::accelerate_again(tree, inputs, options, branch.data(), ws) >= 0) return;
  art::free_rates(tree, inputs, options, ws);
  std::vector<float> qdd(now.size()), q(static_cast<size_t>(s.in(kAt.q).size())), qd(now.size());
  std::copy_n(ws.qdd, of.dof_count, qdd.data() + of.first_dof);
  std::vector<Transformf> body_q(static_cast<size_t>(s.outputs[2].tensor.size() / 7));
  std::vector<SpatialVectorf> body_qd(body_q.size());
  art::finish_step(tree, inputs, options, ws, q.data(), qd.data(), body_q.data(), body_qd.data());

  LimitEvent event;
  event.tree = t;
  event.dof = dof;
  event.side = (bits & art::kBelowLimit) != 0 ? 1.0f : -1.0f;
  std::vector<float> by_q(q.size()), by_qd(qd.size());
  if (acted) {
    add_force_gradient(tree, *link, inputs, options, qdd, branch, q, qd, ws, by_q, by_qd, event);
  } else {
    by_q[static_cast<size_t>(link->coord)] = 1.0f;
    event.by_limit = -1.0f;
  }
  const auto [first, count] = coordinates_of(s, t);
  const float *const q_next = numbers(s.outputs[0].tensor), *const qd_next =
                                                                numbers(s.outputs[1].tensor);
  double rate = 0.0;
  for (int32_t c = first; c < first + count; ++c) {
    const auto i = static_cast<size_t>(c);
    event.jump_q.push_back(q_next[c] - q[i]);
    event.by_q.push_back(by_q[i]);
    rate += double{by_q[i]} * (double{q[i]} - inputs.q[c]);
  }
  for (int32_t k = of.first_dof; k < of.first_dof + of.dof_count; ++k) {
    const auto i = static_cast<size_t>(k);
    event.jump_qd.push_back(qd_next[k] - qd[i]);
    event.by_qd.push_back(by_qd[i]);
    rate += double{by_qd[i]} * (double{qd[i]} - inputs.qd[k]);
  }
  event.rate = static_cast<float>(rate);
  if (event.rate != 0.0f) s.motion->limits.push_back(std::move(event));
}

}  // namespace

void note_limits(const Step& s, const MotionNotes* last) {
  MotionNotes& notes = *s.motion;
  const float* const branch = numbers(s.outputs[5].tensor);
  notes.branch.assign(branch, branch + s.outputs[5].tensor.size());
  if (last == nullptr) return;
  const auto is_outside = [](float number) {
    return (static_cast<int32_t>(number) & art::kOutside) != 0;
  };
  const auto acts = [&](float number) {
    return is_outside(number) && (static_cast<int32_t>(number) & art::kLimitReleased) == 0;
  };
  const std::vector<char>& touched = notes.found.touched;
  for (int32_t t = 0; t < static_cast<int32_t>(s.count); ++t) {
    const bool touches = !touched.empty() && touched[static_cast<size_t>(t)] != 0;
    const ArticulationRows& of = rows_of_step(s)[t];
    const size_t first = notes.limits.size();
    for (int32_t k = of.first_dof; k < of.first_dof + of.dof_count; ++k) {
      const float before = last->branch[static_cast<size_t>(k)];
      const bool acted = acts(before);
      if (acted == acts(notes.branch[static_cast<size_t>(k)])) continue;
      // The force of a limit that pushes again grows from 0, so this change needs no term.
      if (!acted && is_outside(before)) continue;
      const size_t known = notes.limits.size();
      // The limit of a BALL's angle, and limits in a tree with contacts, have no event whose time
      // moves.
      if (touches || is_of_ball(s, t, k))
        ++s.shared->motion.unmoved;
      else
        add_limit_event(s, t, k, acted);
      if (!acted && notes.limits.size() > known) list_limit(s, t, k);
    }
    if (notes.limits.size() > first + 1) ++s.shared->motion.several;
  }
}

void limits_vjp(const Step& s, const ArticulationArguments& in, float* y_q, float* y_qd,
                std::span<const nova::InputGradient> gradients) {
  for (const LimitEvent& event : std::views::reverse(s.motion->limits)) {
    const art::Tree<float> tree = articulation_tree(in, rows_of_step(s)[event.tree]);
    const auto first = coordinates_of(s, event.tree).first;
    double by = 0.0;
    for (size_t i = 0; i < event.by_q.size(); ++i)
      by += double{event.jump_q[i]} * y_q[static_cast<size_t>(first) + i];
    for (size_t i = 0; i < event.by_qd.size(); ++i)
      by += double{event.jump_qd[i]} * y_qd[static_cast<size_t>(tree.first_dof) + i];
    for (size_t i = 0; i < event.by_q.size(); ++i)
      y_q[static_cast<size_t>(first) + i] += static_cast<float>(by / event.rate * event.by_q[i]);
    for (size_t i = 0; i < event.by_qd.size(); ++i)
      y_qd[static_cast<size_t>(tree.first_dof) + i] +=
          static_cast<float>(by / event.rate * event.by_qd[i]);
    add_gradient(gradients[limit_input(event.side)], event.dof, by / event.rate * event.by_limit);
  }
}

void limits_jvp(const Step& s, const ArticulationArguments& in, std::span<const Tensor> moved) {
  for (const LimitEvent& event : s.motion->limits) {
    const art::Tree<float> tree = articulation_tree(in, rows_of_step(s)[event.tree]);
    float* const q = numbers(moved[kAt.q]) + coordinates_of(s, event.tree).first;
    float* const qd = numbers(moved[kAt.qd]) + tree.first_dof;
    double by = event.by_limit * tangent_at(moved[limit_input(event.side)], event.dof);
    for (size_t i = 0; i < event.by_q.size(); ++i) by += double{event.by_q[i]} * q[i];
    for (size_t i = 0; i < event.by_qd.size(); ++i) by += double{event.by_qd[i]} * qd[i];
    for (size_t i = 0; i < event.by_q.size(); ++i)
      q[i] += static_cast<float>(by / event.rate * event.jump_q[i]);
    for (size_t i = 0; i < event.by_qd.size(); ++i)
      qd[i] += static_cast<float>(by / event.rate * event.jump_qd[i]);
  }
}

}  // namespace novaphy::diff::detail
