// TouchMotion::Impl: the touches (diff_touches.h) that began before a step and have not ended.
#pragma once

#include <algorithm>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "diff_touch_events.h"
#include "novaphy/dynamics/semi_implicit/diff_touches.h"
#include "touch_index.h"

namespace novaphy::diff {

using namespace detail;  // types of touches

struct TouchMotion::Impl {
  Impl(const TouchSettings& s, const Model& m)
      : settings(s), index(m.body_count(), m.particle_count()) {}

  // A touch that has begun and not ended.
  struct Open {
    std::shared_ptr<TouchEvent> event;
    std::shared_ptr<TouchStep> last;  // its last step; null: no derivative over the whole touch
  };

  bool is_held(const TouchSide& side) const {
    if (side.particle >= 0) return settings.elements;
    return side.body >= 0 && jointed[static_cast<size_t>(side.body)];
  }
  // Returns whether another contact of a touch's sides may be at rest: it is with the world, and
  // has its own touch. rests() then checks that the same points push from before the touch to its
  // end.
  bool is_beside(TouchEvent& touch, const std::array<TouchSide, 2>& sides,
                 const TouchRow& row) const {
    for (const TouchSide& y : row.sides)
      if (y.responds && !y.is(sides[0]) && !y.is(sides[1])) return false;
    const auto of = open_of.find(pair_key(row));
    if (of == open_of.end()) return false;
    const auto is_it = [&](const auto& other) { return other.lock() == of->second; };
    if (std::ranges::none_of(touch.beside, is_it)) touch.beside.push_back(of->second);
    return true;
  }
  static bool rests(const TouchEvent& touch) {
    return std::ranges::all_of(touch.beside, [&](const auto& of) {
      const auto other = of.lock();
      return other != nullptr && other->changed < touch.begin;
    });
  }
  // Returns whether the sides of a touch have another contact that is not at rest.
  bool meets_others(TouchEvent& touch, const std::array<TouchSide, 2>& sides) const {
    for (const TouchSide& side : sides) {
      if (!side.responds) continue;
      for (const int32_t at : index.of_side(side)) {
        const TouchRow& row = rows[static_cast<size_t>(at) / 2];
        if (pair_key(touch) != pair_key(row) && !is_beside(touch, sides, row)) return true;
      }
    }
    return !rests(touch);
  }
  void find_changes() {
    for (const Open& o : open) {
      int64_t points = 0;
      for (const int32_t k : index.of_pair(pair_key(*o.event)))
        points += (int64_t{rows[static_cast<size_t>(k)].point} << 8) + 1;
      if (points != o.event->points) o.event->changed = number;
      o.event->points = points;
    }
  }
  std::array<Vec3d, 2> applied(const TouchedStep& step, const TouchSide& side) const {
    const auto load = [](const nova::Operand& of, int64_t at) {
      const float* const f = static_cast<const float*>(of.range->data()) + at;
      return Vec3d{f[0], f[1], f[2]};
    };
    if (side.particle >= 0) return {load(step.forces, int64_t{3} * side.particle), {}};
    if (side.body < 0) return {};
    return {load(step.body_forces, int64_t{6} * side.body),
            load(step.body_forces, int64_t{6} * side.body + 3)};
  }
  bool follows(const SimState& in, float dt) const {
    return at_q == place(in).first && at_version == place(in).second && last_dt == dt;
  }
  // Returns the address of a state's memory, and the version of its contents.
  std::pair<const void*, uint64_t> place(const SimState& s) const {
    const auto of = [](const auto& q, const auto& qd) {
      return std::pair<const void*, uint64_t>(q.range()->data(),
                                              q.range()->version() + qd.range()->version());
    };
    return settings.bodies ? of(s.body_q, s.body_qd) : of(s.particle_q, s.particle_qd);
  }

  // Keeps the end of a step, in place of the end where the step starts.
  void remember(const SimState& in, const SimState& out, uint64_t version) {
    if (ends.erase(place(in).first) == 0)
      std::erase_if(ends, [](const auto& end) { return end.second.memory.expired(); });
    ends[place(out).first] = {settings.bodies ? out.body_q.range() : out.particle_q.range(),
                              version};
  }

  TouchArrays arrays(const StateFields& s, const nova::Operand& body_f,
                     const nova::Operand& particle_f) const {
    TouchArrays all;
    if (settings.bodies) {
      all[0] = nova::operand_of(s.body_q);
      all[1] = nova::operand_of(s.body_qd);
      all[4] = body_f;
    }
    if (settings.particles) {
      all[2] = nova::operand_of(s.particle_q);
      all[3] = nova::operand_of(s.particle_qd);
      all[5] = particle_f;
    }
    return all;
  }

  // Sets `shakes` if friction changes between sticking and slipping in a stiff touch, or in a touch
  // that rotates a body. With several points a change at one may hide a change at another.
  static void watch_friction(const TouchRow& row, bool several, TouchEvent& event) {
    if (!event.turns && event.stiff_angle <= kFrictionAngle) return;
    if (row.slides != event.slides || (several && row.slip_taken > 0.0)) event.shakes = true;
    event.slides = row.slides;
  }

  void begin_touch(const Model& m, const SimState& in, const TouchRow& row, bool follows_last,
                   float dt, TouchList& a, TouchList& b);
  void find_steps(const Model& m, TouchedStep& step, bool follows_last, float dt, TouchList& a,
                  TouchList& b);
  void find_ramps(const Model& m, TouchedStep& step, TouchList& a, TouchList& b);
  void move(const Model& m, TouchedStep& step) const;
  // Returns the number of dofs that have passed a limit since the last step. 0: no last step.
  int64_t find_limits(const Model& m, const SimState& state, bool follows_last);

  TouchSettings settings;
  double& speed_off(const TouchSide& side) {
    return (
        side.body >= 0
            ? off_of_bodies
            : off_of_particles)[static_cast<size_t>(side.body >= 0 ? side.body : side.particle)];
  }

  std::vector<char> jointed;                            // {bodies}: 1 if the body has a joint
  std::vector<char> limit_sides;                        // {dofs}: -1 below, 1 above limits, else 0
  std::vector<double> off_of_bodies, off_of_particles;  // TouchEvent::speed_off
  std::vector<TouchRow> rows;
  TouchIndex index;  // of `rows`
  std::vector<Open> open, closing;
  std::unordered_map<PairKey, std::shared_ptr<TouchEvent>> open_of, closing_of;
  // Ramps (contacts near their begin) of the last step whose touch may still begin.
  std::unordered_multimap<PairKey, std::shared_ptr<TouchRamp>> waiting;
  // The end of the last step of each chain of steps, by its memory.
  struct End {
    std::weak_ptr<const void> memory;
    uint64_t version = kUnknown;
  };
  static constexpr uint64_t kUnknown = ~uint64_t{0};
  std::unordered_map<const void*, End> ends;
  const void* at_q = nullptr;
  uint64_t at_version = 0;
  float last_dt = 0.0f;
  int64_t number = 0, chain = 0;  // of the step, as in MotionEvent
  double time = 0.0;              // s, at its start
  const Control* last_control = nullptr;
};

}  // namespace novaphy::diff
