#include "novaphy/dynamics/gradient_info.h"

#include <algorithm>
#include <cmath>
#include <string_view>
#include <tuple>

namespace novaphy {
namespace {

std::string pair_text(const ContactPair& pair) {
  const std::string shape = std::to_string(pair.first);
  if (pair.second >= ContactPair::kParticle)
    return "particle " + std::to_string(pair.second - ContactPair::kParticle) + " and shape " +
           shape;
  return "shapes " + shape + " and " + std::to_string(pair.second);
}
std::string some(int64_t count, int64_t of) {
  return std::to_string(count) + " of " + std::to_string(of) + " steps";
}

// Events of one tree that are fewer steps apart may occur in the other order.
constexpr double kApart = 3.0;

bool are_apart(const MotionCounts& m) { return m.of_springs || m.least_separation >= kApart; }
// Returns the number of events that the end of the steps cuts, or (not with springs) that a small
// move of the start puts behind the end.
int64_t last_events(const MotionCounts& m) {
  return std::ranges::count_if(m.events, [&](const auto& e) {
    if (!e->whole || m.of_springs) return !e->whole;
    const double at = static_cast<double>(e->step) + double{e->phase};
    return e->chain == m.chain && static_cast<double>(m.chain_steps) - at < kApart;
  });
}
bool is_of_the_motion(const MotionCounts& m) {
  return m.several == 0 && m.unmoved == 0 && m.one_sided == 0 && m.stiff == 0 && m.rough == 0 &&
         m.phased == 0 && m.searched == 0 && m.inexact == 0 && m.limits == 0 && are_apart(m) &&
         last_events(m) == 0;
}
std::string motion_of_springs(const MotionCounts& m) {
  std::string text = " The times at which contacts begin and end move with the state.";
  if (m.several + m.unmoved + m.one_sided + m.stiff + m.rough == 0) return text;
  text += " Short touches of these kinds may have a gradient of any length:";
  const auto add = [&text](int64_t count, const char* what) {
    if (count > 0)
      text += (text.back() == ':' ? " " : "; ") + (what + (" (" + std::to_string(count) + ")"));
  };
  add(m.several, "several contacts at once");
  add(m.unmoved, "bodies that joints, elements or adhesion hold");
  add(m.stiff,
      "a body that turns within ten steps or while friction changes between sticking and slipping, "
      "or whose friction takes half of the slip in a step");
  add(m.rough, "a speed that depends on the phase of the steps by 4 %, earlier touches included");
  add(m.one_sided, "a begin or end outside of the steps, or cut by a written state");
  return text + ".";
}
// Returns the reasons why the gradient may differ from that of the motion.
std::string doubts(const MotionCounts& m) {
  std::string text;
  if (m.unmoved > 0)
    text += " " + std::to_string(m.unmoved) +
            " limits of joints, in bodies that touch something, may have a gradient of any length.";
  if (m.several > 0)
    text += " In " + std::to_string(m.several) +
            " steps several pairs hit at once, or several points of a pair. The gradient is then "
            "that of the motion only if their impacts do not depend on each other.";
  if (m.phased > 0)
    text += " The friction of " + std::to_string(m.phased) +
            " landings turns. Their states depend on where in its step the contact begins.";
  if (m.several == 0 && !are_apart(m))
    text += " Two events of one tree are " + std::to_string(m.least_separation) +
            " steps apart, and may come in the other order.";
  if (m.searched > 0)
    text += " In " + std::to_string(m.searched) +
            " steps contacts hold whose normal a search finds. 1 / dt amplifies its error.";
  if (last_events(m) > 0)
    text += std::ranges::all_of(m.events, [](const auto& e) { return e->whole; })
                ? " An event is within three steps of the end of the steps."
                : " A landing is cut by the end of the steps.";
  if (m.inexact > 0) text += " Overlaps are those of the motion only with pgs_slop=0, pgs_erp=1.";
  return text;
}
// Returns a text about limits of joints whose event times do not move with the state.
std::string held_limits(const MotionCounts* m) {
  const int64_t count = m == nullptr ? 0 : m->of_springs ? m->limits : m->unmoved;
  if (count == 0) return {};
  return " The limits of joints began or ended to push " + std::to_string(count) +
         " times. These times do not move with the state, so the gradient of the motion may have "
         "another length and sign.";
}
constexpr const char* kOther = " The gradient of the motion may have another length and sign.";
std::string motion_of(const MotionCounts* m) {
  if (m == nullptr) return kOther;
  std::string text;
  if (m->held == nullptr || m->moved > 0)
    text = m->of_springs ? motion_of_springs(*m) + held_limits(m)
                         : " The times at which contacts begin move with the state." + doubts(*m);
  if (m->held == nullptr) return text;
  return text + " Times stay constant in steps " + m->held +
         ", where contact_gradient \"motion\" is not supported." + kOther;
}

// Returns the number of steps whose gradient is not that of the code and may differ from that of
// the motion.
int64_t unclaimed_steps(const MotionCounts* motion) {
  return motion != nullptr && !is_of_the_motion(*motion) ? motion->moved : 0;
}

std::string why_surrogate(const GradientCounts& c) {
  if ((c.jumps & kLawJumps) != 0) return "a contact law jumps or a step failed";
  if ((c.jumps & kOpenFriction) != 0)
    return "dependent contacts slide in different directions, and the law leaves the push of each "
           "point open";
  return "contacts have not converged (" + std::to_string(c.residual) + " of the largest impulse)";
}

// Returns sentences on the worst steps, without the last full stop.
std::string worst_steps(const GradientCounts& c, bool implicit, bool has_unclaimed) {
  if (c.surrogate > 0)
    return some(c.surrogate, c.steps) + " are a surrogate (the first is step " +
           std::to_string(c.surrogate_step) + "), because " + why_surrogate(c) +
           ". Gradients through these steps may have any length and sign";
  if (c.frozen > 0)
    return some(c.frozen, c.steps) +
           " hold points or normals of contacts that push (first in step " +
           std::to_string(c.frozen_step) + ", " + pair_text(c.held) +
           "). Gradients by poses, velocities, masses and materials may be wrong, also in sign";
  return std::string(has_unclaimed ? "Apart from these events, all steps" : "All steps") +
         " are differentiated exactly as " + (implicit ? "their solutions" : "the code runs them");
}

std::string reason_of(const GradientCounts& c, bool implicit, const MotionCounts* motion,
                      int64_t events) {
  if (c.steps == 0) return "No step has been taken since the last clear_gradient_info.";
  std::string text;
  const int64_t unclaimed = unclaimed_steps(motion);
  if (unclaimed > 0)
    text = some(unclaimed, c.steps) +
           " have events whose times move with the state. The gradient is not that of the code, "
           "and may differ from that of the motion. ";
  text += worst_steps(c, implicit, unclaimed > 0);
  if (events == 0)
    return text + (c.surrogate + c.frozen > 0 ? "." : ", and no contact changed.") +
           (unclaimed > 0 && !motion->of_springs ? doubts(*motion) : held_limits(motion));
  static constexpr const char* kWhat[] = {"begins", "ends",
                                          "changes between sticking and slipping"};
  return text + ". Contacts changed " + std::to_string(events) + " times (first in step " +
         std::to_string(c.event_step) + ": that of " + pair_text(c.event) + " " +
         kWhat[c.event.event] + ")." + motion_of(motion);
}

}  // namespace

GradientInfo gradient_info(const GradientCounts& c, bool implicit, const MotionCounts* motion) {
  GradientInfo info;
  const int64_t unclaimed = unclaimed_steps(motion);
  info.label = c.surrogate > 0 || unclaimed > 0 ? "surrogate"
               : c.frozen > 0                   ? "frozen"
               : implicit                       ? "implicit"
               : motion != nullptr && motion->held == nullptr && is_of_the_motion(*motion)
                   ? "exact of the motion"
                   : "exact of the code";
  info.steps = c.steps;
  const int64_t less = std::min(unclaimed, c.exact);
  info.exact_steps = c.exact - less;
  info.frozen_steps = c.frozen;
  info.surrogate_steps = c.surrogate + less;
  info.began = c.began;
  info.ended = c.ended;
  info.turned = c.turned;
  info.events = c.began + c.ended + c.turned;
  if (motion != nullptr) {
    info.several = motion->several;
    info.one_sided = motion->one_sided;
    info.ramp_steps = motion->ramp_steps;
    info.landings = motion->landings;
    info.phased = motion->phased;
    info.searched = motion->searched;
    info.one_sided += last_events(*motion);
    info.least_approach = motion->least_approach;
    info.least_separation = motion->least_separation;
    info.event_list = motion->events;
    sort_by_time(info.event_list);
  }
  if (motion != nullptr && motion->drift != nullptr && motion->drift->steps > 0) {
    const AdjointDrift& drift = *motion->drift;
    info.h_drift = drift.largest > 0.0 ? drift.most / drift.largest : 0.0;
    info.h_step = drift.step;
    info.h_skipped = drift.skipped;
  }
  info.residual = c.residual;
  info.reason = reason_of(c, implicit, motion, info.events);
  return info;
}

GradientInfo worst_of(std::span<const GradientInfo> all) {
  static constexpr std::string_view kLabels[] = {"exact of the motion", "exact of the code",
                                                 "implicit", "frozen", "surrogate"};
  const auto rank = [](const GradientInfo& of) {
    return std::ranges::find(kLabels, of.label) - std::begin(kLabels);
  };
  GradientInfo sum = *std::ranges::max_element(all, {}, rank);
  sum.steps = sum.exact_steps = sum.frozen_steps = sum.surrogate_steps = 0;
  sum.several = sum.one_sided = sum.ramp_steps = sum.landings = sum.phased = sum.lost_events = 0;
  sum.searched = 0;
  sum.h_skipped = 0;
  sum.event_list.clear();
  sum.events = sum.began = sum.ended = sum.turned = 0;
  for (const GradientInfo& of : all) {
    sum.steps += of.steps;
    sum.exact_steps += of.exact_steps;
    sum.frozen_steps += of.frozen_steps;
    sum.surrogate_steps += of.surrogate_steps;
    sum.events += of.events;
    sum.began += of.began;
    sum.ended += of.ended;
    sum.turned += of.turned;
    sum.several += of.several;
    sum.one_sided += of.one_sided;
    sum.ramp_steps += of.ramp_steps;
    sum.landings += of.landings;
    sum.phased += of.phased;
    sum.searched += of.searched;
    sum.lost_events += of.lost_events;
    sum.least_approach = std::min(sum.least_approach, of.least_approach);
    sum.least_separation = std::min(sum.least_separation, of.least_separation);
    sum.steps_per_contact = std::min(sum.steps_per_contact, of.steps_per_contact);
    sum.event_list.insert(sum.event_list.end(), of.event_list.begin(), of.event_list.end());
    sum.residual = std::max(sum.residual, of.residual);
    sum.h_skipped += of.h_skipped;
    if (!(of.h_drift > sum.h_drift) && !std::isnan(sum.h_drift)) continue;
    sum.h_drift = of.h_drift;
    sum.h_step = of.h_step;
  }
  sort_by_time(sum.event_list);
  return sum;
}

namespace {
bool share(const MotionEvent& a, const MotionEvent& b) {
  return std::ranges::any_of(a.derivatives, [&](const MotionEvent::TimeDerivative& x) {
    return std::ranges::any_of(b.derivatives, [&](const MotionEvent::TimeDerivative& y) {
      return x.of == y.of && x.first == y.first;
    });
  });
}
}  // namespace

void sort_by_time(MotionEvents& events) {
  const auto key = [](const MotionEvent& e) {
    return std::tuple(e.time, e.world, e.shape0, e.shape1, e.particle, e.joint);
  };
  std::sort(events.begin(), events.end(),
            [&](const auto& a, const auto& b) { return key(*a) < key(*b); });
}

void MotionCounts::add(const std::shared_ptr<MotionEvent>& event) {
  const auto at = [](const MotionEvent& e) {
    return static_cast<double>(e.step) + double{e.phase};
  };
  least_approach = std::min(least_approach, event->approach);
  landings += event->kind == MotionEventKind::Landing ? 1 : 0;
  for (size_t i = events.size(); i > 0; --i) {
    const MotionEvent& before = *events[i - 1];
    const auto steps = static_cast<double>(event->step - before.step);
    if (before.chain != event->chain || steps > least_separation + 1.0) break;
    if (share(before, *event))
      least_separation = std::min(least_separation, std::abs(at(*event) - at(before)));
  }
  events.push_back(event);
}

}  // namespace novaphy
