// The list of events with their times (motion_events.h): begins of contacts and of joint limits.
#include <algorithm>
#include <cmath>

#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

namespace art = articulation;

namespace {

// Returns an event of a tree that begins in a step, with the fields that the step determines.
std::shared_ptr<MotionEvent> new_event(const Step& s, int32_t tree) {
  auto event = std::make_shared<MotionEvent>();
  event->chain = s.motion->chain;
  event->step = s.motion->number;
  event->world = rows_of_step(s)[tree].world;
  event->start = s.in(kAt.q).range()->data();
  event->version = s.in(kAt.q).range()->version();
  return event;
}
MotionEvent::TimeDerivative no_derivative(const Step& s, int32_t tree) {
  const auto [first, count] = coordinates_of(s, tree);
  return {.first = first, .by = std::vector<float>(static_cast<size_t>(count))};
}

// Returns the derivative of an event's time by a joint limit. `side`: as in LimitEvent. `approach`:
// approach speed of the dof.
MotionEvent::TimeDerivative limit_derivative(const Step& s, int32_t dof, float side,
                                             float approach) {
  const Model& m = *s.model;
  return {.of = MotionArray::JointLimit,
          .first = dof,
          .by = {-side / approach},
          .limit = side > 0.0f ? m.joint_limit_lower : m.joint_limit_upper};
}

int32_t joint_of(const Step& s, int32_t dof) {
  const Model& m = *s.model;
  const int32_t* const first_dof = m.joint_qd_start.data();
  return static_cast<int32_t>(std::upper_bound(first_dof, first_dof + m.joint_count(), dof) -
                              first_dof - 1);
}

// Adds a group of contacts that hit to the event list, with derivatives by the coordinates of the
// event's trees.
void list_group(const Step& s, const ArticulationArguments& in, const ContactEvent& event,
                ContactEvent::Group& group) {
  group.listed = new_event(s, event.trees.front());
  MotionEvent& listed = *group.listed;
  listed.shape0 = group.shape0;
  listed.shape1 = group.shape1;
  listed.kind = group.lands ? MotionEventKind::Landing : MotionEventKind::Bounce;
  if (group.dof >= 0) {
    listed.kind = MotionEventKind::Limit;
    listed.joint = joint_of(s, group.dof);
  }
  listed.whole = !group.lands;
  listed.friction = group.friction;
  listed.approach = group.approach / group.impulse;
  listed.set_time(s.motion->time, s.dt, group.gap / group.impulse);
  std::vector<float> covector(static_cast<size_t>(s.in(kAt.qd).size()));
  for_dofs(s, event,
           [&](size_t at, size_t row) { covector[row] = group.normal_push[at] / group.approach; });
  const ArticulationRows* const rows = rows_of_step(s);
  for (const int32_t t : event.trees) {
    MotionEvent::TimeDerivative derivative = no_derivative(s, t);
    art::tangent_to_gradient(articulation_tree(in, rows[t]), in.arrays.q.rows(),
                             covector.data() + rows[t].first_dof, [&](int32_t row, float value) {
                               derivative.by[static_cast<size_t>(row - derivative.first)] = value;
                             });
    listed.derivatives.push_back(std::move(derivative));
  }
  if (group.dof >= 0)
    listed.derivatives.push_back(limit_derivative(s, group.dof, group.side, group.approach));
  s.motion->listed.push_back(group.listed);
}

}  // namespace

std::shared_ptr<const Step> take_before(ArticulationStep::Shared& shared,
                                        const std::shared_ptr<const Step>& step) {
  std::shared_ptr<const Step> before;
  if (const auto at = shared.ends.find(step->in(kAt.q).range()->data()); at != shared.ends.end()) {
    before = at->second.lock();
    shared.ends.erase(at);
  }
  if (before == nullptr)
    std::erase_if(shared.ends, [](const auto& end) { return end.second.expired(); });
  shared.ends[step->outputs[0].tensor.range()->data()] = step;
  return before;
}

void list_events(const Step& s, const ArticulationArguments& in, const Step* before) {
  MotionNotes& notes = *s.motion;
  notes.chain = s.shared->chain;
  if (before != nullptr) {
    MotionNotes& last = *before->motion;
    notes.chain = last.chain;
    notes.number = last.number + 1;
    notes.time = last.time + double{before->dt};
    for (const auto& listed : last.listed) listed->whole = true;
    for (const auto& [event, group] : notes.found.turned) {
      MotionEvent& listed = *last.found.events[event].groups[group].listed;
      if (listed.friction == MotionFriction::Turns) continue;
      listed.friction = MotionFriction::Turns;
      ++s.shared->motion.phased;
    }
  }
  for (ContactEvent& event : notes.found.events)
    for (ContactEvent::Group& group : event.groups) list_group(s, in, event, group);
}

void list_limit(const Step& s, int32_t tree, int32_t dof) {
  const ArticulationArguments in = host_arguments(s);
  const art::StepInputs<float> inputs = articulation_inputs(in);
  const art::Link* link = articulation_tree(in, rows_of_step(s)[tree]).links;
  while (link->dof != dof) ++link;
  const float q = inputs.q[link->coord], rate = inputs.qd[dof];
  const auto listed = new_event(s, tree);
  listed->kind = MotionEventKind::Limit;
  listed->joint = joint_of(s, dof);
  listed->approach = std::abs(rate);
  listed->set_time(s.motion->time, s.dt,
                   rate < 0.0f ? q - inputs.limit_lower[dof] : inputs.limit_upper[dof] - q);
  MotionEvent::TimeDerivative derivative = no_derivative(s, tree);
  derivative.by[static_cast<size_t>(link->coord - derivative.first)] = -1.0f / rate;
  listed->derivatives.push_back(std::move(derivative));
  listed->derivatives.push_back(
      limit_derivative(s, dof, rate < 0.0f ? 1.0f : -1.0f, listed->approach));
  s.motion->listed.push_back(listed);
}

void list_mismatch(const ContactEvent& event, std::span<const double> h_before, double mismatch) {
  double h = 0.0;
  for (const int32_t tree : event.trees) h += h_before[static_cast<size_t>(tree)];
  for (const ContactEvent::Group& group : event.groups) {
    group.listed->h_before = h;
    group.listed->h_after = h - mismatch;
  }
}

}  // namespace novaphy::diff::detail
