// Labels and counts of the gradients of steps, summed over steps (gradient_info.h), and the events
// of contacts between two steps. Freestanding: shared by host and device kernels.
#pragma once

#include <cstdint>

namespace novaphy {

// If the contact solve misses its law by more than this fraction of the largest impulse, the
// gradient of the step is a surrogate. Between 1e-4 and 1e-3 gradients of piles were up to 28 %
// off.
inline constexpr float kSurrogateResidual = 1e-4f;

// Why a step has no derivative: a law jumps, or the step failed; open_friction.h.
inline constexpr int32_t kLawJumps = 1, kOpenFriction = 2;

inline constexpr int32_t kContactBegan = 0, kContactEnded = 1, kContactTurned = 2;

// A pair of shapes, or a shape and a particle (as kParticle plus its index), with the event of its
// contact. The smallest pair is kept, so that the result does not depend on the order of
// processing.
struct ContactPair {
  static constexpr int32_t kNone = 0x7fffffff, kParticle = 0x40000000;
  int32_t first = kNone, second = kNone, event = kNone;
  bool there() const { return first != kNone; }
};
inline void take_first(const ContactPair& of, ContactPair& to) {
  const bool before = of.first != to.first     ? of.first < to.first
                      : of.second != to.second ? of.second < to.second
                                               : of.event < to.event;
  if (before) to = of;
}

// Counts of a step, or of a part of a step.
struct StepNotes {
  int32_t began = 0, ended = 0, turned = 0;  // counts of contacts; turned: between sticking and
                                             // slipping
  ContactPair event;                         // first pair with an event
  ContactPair held;                          // first pushing pair with a frozen point or normal
  int32_t jumps = 0;                         // kLawJumps and kOpenFriction
  float residual = 0.0f;                     // relative to the largest impulse
};
inline void note_all(const StepNotes& of, StepNotes& to) {
  to.began += of.began;
  to.ended += of.ended;
  to.turned += of.turned;
  take_first(of.event, to.event);
  take_first(of.held, to.held);
  to.jumps |= of.jumps;
  if (to.residual < of.residual) to.residual = of.residual;
}

struct GradientCounts {
  int64_t steps = 0, exact = 0, frozen = 0, surrogate = 0;
  int64_t began = 0, ended = 0, turned = 0;
  int64_t event_step = -1, frozen_step = -1, surrogate_step = -1;  // first step of each kind
  ContactPair event, held;                                         // of event_step and frozen_step
  float residual = 0.0f;                                           // largest residual
  int32_t jumps = 0;                                               // of all surrogate steps
};
inline void note_step(const StepNotes& of, GradientCounts& to) {
  const bool surrogate = of.jumps != 0 || !(of.residual <= kSurrogateResidual);
  if (of.event.there() && to.event_step < 0) {
    to.event_step = to.steps;
    to.event = of.event;
  }
  if (surrogate) {
    if (to.surrogate_step < 0) to.surrogate_step = to.steps;
    to.jumps |= of.jumps;
    ++to.surrogate;
  } else if (of.held.there()) {
    if (to.frozen_step < 0) {
      to.frozen_step = to.steps;
      to.held = of.held;
    }
    ++to.frozen;
  } else {
    ++to.exact;
  }
  to.began += of.began;
  to.ended += of.ended;
  to.turned += of.turned;
  if (to.residual < of.residual) to.residual = of.residual;
  ++to.steps;
}

// Adds the counts of steps that come after the steps of `to`.
inline void note_steps(const GradientCounts& of, GradientCounts& to) {
  const auto first = [&](int64_t step, int64_t& of_all) {
    const bool is_first = step >= 0 && of_all < 0;
    if (is_first) of_all = to.steps + step;
    return is_first;
  };
  if (first(of.event_step, to.event_step)) to.event = of.event;
  if (first(of.frozen_step, to.frozen_step)) to.held = of.held;
  first(of.surrogate_step, to.surrogate_step);
  to.jumps |= of.jumps;
  to.exact += of.exact;
  to.frozen += of.frozen;
  to.surrogate += of.surrogate;
  to.began += of.began;
  to.ended += of.ended;
  to.turned += of.turned;
  if (to.residual < of.residual) to.residual = of.residual;
  to.steps += of.steps;
}

// A contact of a step. `mode`: 0 no impulse, 1 sticks, larger: slips. `held`: whether its point or
// normal is frozen.
struct SeenContact {
  int32_t first = ContactPair::kNone, second = 0, point = 0, mode = 0, held = 0;
};

// Returns the mode of the same contact in a list that is sorted by pairs. `next`: search position,
// initially 0. For contacts in another order the search restarts at 0.
inline int32_t mode_of(const SeenContact* list, int32_t count, int32_t& next,
                       const SeenContact& of) {
  while (next < count && (list[next].first < of.first ||
                          (list[next].first == of.first && list[next].second < of.second)))
    ++next;
  for (int32_t i = next; i < count && list[i].first == of.first && list[i].second == of.second; ++i)
    if (list[i].point == of.point && list[i].mode != 0) return list[i].mode;
  return 0;
}
// Counts the change of a pushing contact's mode since the last step, or the end of a contact.
inline void note_change(const SeenContact& c, int32_t mode, StepNotes& to) {
  if (mode == c.mode) return;
  ++(mode == 0 ? to.began : to.turned);
  take_first({c.first, c.second, mode == 0 ? kContactBegan : kContactTurned}, to.event);
}
inline void note_end(const SeenContact& c, StepNotes& to) {
  ++to.ended;
  take_first({c.first, c.second, kContactEnded}, to.event);
}
// Counts the events between two consecutive steps. Both lists are sorted by pairs.
inline void note_events(const SeenContact* before, int32_t before_count, const SeenContact* now,
                        int32_t now_count, StepNotes& to) {
  int32_t next = 0;
  for (int32_t i = 0; i < now_count; ++i) {
    const SeenContact& c = now[i];
    if (c.mode != 0) note_change(c, mode_of(before, before_count, next, c), to);
  }
  next = 0;
  for (int32_t i = 0; i < before_count; ++i) {
    const SeenContact& c = before[i];
    if (c.mode != 0 && mode_of(now, now_count, next, c) == 0) note_end(c, to);
  }
}

}  // namespace novaphy
