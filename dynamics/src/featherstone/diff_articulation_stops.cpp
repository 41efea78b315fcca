// Events of joint limits as constraint rows (articulation/rate_bounds.h): a dof hits a limit in a
// step (diff_articulation_motion.h).
#include <algorithm>
#include <cmath>
#include <limits>

#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

namespace art = articulation;

namespace {

constexpr float kLeastApproach = 1e-3f;  // m/s or rad/s: slower dofs do not hit

struct Stop {
  int32_t tree = 0, dof = 0;
  float side = 1.0f;  // derivative of the gap by the coordinate; -1 for an upper limit
  float gap = 0.0f, before = 0.0f;
  bool bounces = false, is_cut = false;
};

// Returns the limits that push in a step and that the dof approached. A limit that pushed in the
// step before counts only if the dof bounces.
std::vector<Stop> pushing_stops(const Step& s, const MotionNotes* last) {
  std::vector<Stop> found;
  const ArticulationArguments in = host_arguments(s);
  const art::StepInputs<float> inputs = articulation_inputs(in);
  const art::StepOptions<float> options = articulation_options(in);
  const float* const branch = numbers(s.outputs[5].tensor);
  const auto bits_of = [](float x) { return static_cast<int32_t>(x); };
  for (int32_t t = 0; t < static_cast<int32_t>(s.count); ++t) {
    const art::Tree<float> tree = articulation_tree(in, rows_of_step(s)[t]);
    art::for_drives(tree, [&](const art::Link& link, int32_t) {
      const int32_t k = link.dof, bits = bits_of(branch[k]);
      if ((bits & art::kAtStop) == 0) return;
      const bool upper = (bits & art::kVelocityAtUpper) != 0;
      Stop stop{.tree = t, .dof = k, .side = upper ? -1.0f : 1.0f};
      const float q = inputs.q[link.coord];
      stop.gap = upper ? inputs.limit_upper[k] - q : q - inputs.limit_lower[k];
      stop.before = stop.side * inputs.qd[k];
      stop.bounces = (bits & art::kStopBounces) != 0;
      const art::HeldRate<float> held = art::held_rate(inputs, options, k, link.coord, bits);
      stop.is_cut = stop.bounces && (held.upper != 0.0f || held.lower != 0.0f);
      constexpr int32_t kSame = art::kAtStop | art::kVelocityClamped;
      const bool pushed = last != nullptr &&
                          (bits_of(last->branch[static_cast<size_t>(k)]) & kSame) == (bits & kSame);
      if (stop.before < -kLeastApproach && (stop.bounces || !pushed)) found.push_back(stop);
    });
  }
  return found;
}

// Returns the event of a tree's island. If the island has no event, adds one.
ContactEvent& event_of(const Step& s, int32_t tree, ContactEvents& found) {
  for (ContactEvent& event : found.events)
    if (std::ranges::find(event.trees, tree) != event.trees.end()) return event;
  ContactEvent& event = found.events.emplace_back();
  const auto root = [&](int32_t t) {
    return found.root.empty() ? t : found.root[static_cast<size_t>(t)];
  };
  for (int32_t t = 0; t < static_cast<int32_t>(s.count); ++t)
    if (root(t) == root(tree)) event.trees.push_back(t);
  return event;
}

void add_stop(const Step& s, const Stop& stop, ContactEvents& found) {
  ContactEvent& event = event_of(s, stop.tree, found);
  ContactEvent::Group& group = event.groups.emplace_back();
  for_dofs(s, event, [&](size_t, size_t row) {
    group.normal_push.push_back(row == static_cast<size_t>(stop.dof) ? stop.side : 0.0f);
    group.push.push_back(0.0f);
  });
  group.approach = -stop.before;
  group.impulse = 1.0f;
  group.gap = stop.gap;
  group.dof = stop.dof;
  group.side = stop.side;
  group.is_cut = stop.is_cut;
  group.lands = stop.gap > 0.0f && !stop.bounces;
  event.lands = event.lands || group.lands;
  found.limits.push_back(stop.dof);
}

}  // namespace

LiftedLimits::LiftedLimits(const Step& s, std::span<const int32_t> dofs,
                           ArticulationArguments& in) {
  if (dofs.empty()) return;
  trees = &*s.shared->trees;
  trees->use_lanes(false);
  const auto copy = [&](size_t input, std::vector<float>& to, float without) {
    const float* const x = numbers(s.in(input));
    to.assign(x, x + s.in(input).size());
    for (const int32_t k : dofs) to[static_cast<size_t>(k)] = without;
  };
  copy(kAt.limit_lower, lower, -std::numeric_limits<float>::infinity());
  copy(kAt.limit_upper, upper, std::numeric_limits<float>::infinity());
  in.arrays.limit_lower = direct(lower);
  in.arrays.limit_upper = direct(upper);
}

LiftedLimits::~LiftedLimits() {
  if (trees != nullptr) trees->use_lanes(true);
}

void find_stops(const Step& s, const MotionNotes* last, const Smooth& smooth) {
  if (s.options.joint_limits != JointLimits::Row) return;
  std::vector<Stop> stops = pushing_stops(s, last);
  if (stops.empty()) return;
  std::vector<int32_t> dofs;
  for (const Stop& stop : stops) dofs.push_back(stop.dof);
  const std::vector<float> free = smooth(dofs);
  // If the approach is no faster than the speed that forces cause in one step, the dof rests at the
  // limit and does not hit it.
  std::erase_if(stops, [&](const Stop& stop) {
    return !(stop.before < -std::abs(free[static_cast<size_t>(stop.dof)]) * s.dt);
  });
  for (const Stop& stop : stops) add_stop(s, stop, s.motion->found);
}

}  // namespace novaphy::diff::detail
