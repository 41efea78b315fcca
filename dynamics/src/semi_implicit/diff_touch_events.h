// The record of a touch, and the effect of its steps on tangents and gradients (diff_touches.h).
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "novaphy/dynamics/motion_events.h"
#include "novaphy/nova/tape.h"
#include "touch_rows.h"

namespace novaphy::diff::detail {

// The tangent of a side: of the center of mass (or the particle), of the rotation, and of both
// rates.
using Tangent = std::array<Vec3d, 4>;
constexpr size_t kPlace = 0, kTurn = 1, kVelocity = 2, kSpin = 3;
inline double product(const Tangent& a, const Tangent& b) {
  double sum = 0.0;
  for (size_t k = 0; k < 4; ++k) sum += math::dot(a[k], b[k]);
  return sum;
}
inline Tangent scaled(const Tangent& a, double by) {
  return {a[0] * by, a[1] * by, a[2] * by, a[3] * by};
}

// Rows of states, or of their tangents or gradients. Null: no such array.
struct StateRows {
  float *body_q = nullptr, *body_qd = nullptr, *particle_q = nullptr, *particle_qd = nullptr,
        *body_f = nullptr, *particle_f = nullptr;
};

// A side at a state, with the maps between raw rows and tangents.
struct SideFrame {
  TouchSide side;
  Quat<double> turn{};
  Vec3d com{};  // from the origin of the body, world frame
  Tangent tangent(const StateRows& raw) const;
  void add_tangent(const Tangent& t, const StateRows& raw) const;
  // The transposes of these maps.
  Tangent gradient(const StateRows& raw) const;
  void add_gradient(const Tangent& g, const StateRows& raw) const;
};

SideFrame frame_of(const Model& m, const SimState& state, const TouchSide& side);
std::array<Vec3d, 2> rates_of(const SimState& state, const TouchSide& side);

// Returns the linear and angular accelerations of a side by a force and a moment.
std::array<Vec3d, 2> respond(const Model& m, const SideFrame& at, const Vec3d& force,
                             const Vec3d& moment);

// Up to this angle h w, the mean force has the derivative of the motion within a few percent.
constexpr double kSoftAngle = 0.1;
// Up to this angle h w, that also holds for a touch whose friction changes, unless it turns a body.
constexpr double kFrictionAngle = 0.15;
// Friction that removes a larger part of the slip in one step does not approximate the motion.
constexpr double kMostSlipTaken = 0.5;
// A step may meet the gap 0 at any phase. The phase changes the speed after a touch. A damper jumps
// at the gap 0, which changes the speed by up to its effect in one step. A spring changes the speed
// by (h w)^2 / 7. Later touches begin with this error. The constant bounds the error.
constexpr double kMostSpeedOff = 0.04;

enum class TouchFlaw : uint8_t {
  None,
  Several,   // more contacts at once
  OneSided,  // the begin or end of the touch is outside of the steps, or is cut
  Held,      // by joints, elements or adhesion
  Long,      // too many steps
  Rests      // the speed of approach is not above the effect of forces in one step
};

struct TouchEvent {
  int32_t first = 0, second = 0, point = 0;
  // the derivative of the delay with respect to positions and rotations of both sides
  std::array<Tangent, 2> delay_by{};
  double stiff_angle = 0.0;           // h w
  bool turns = false;                 // the force has a moment about a center of mass
  // Friction removes most of the slip in a step. Or friction changes between sticking and slipping
  // in a stiff touch, or in a touch that turns a body.
  bool shakes = false;
  bool rubs = false;  // has friction
  // error of the speed that the phase causes, over this touch and earlier touches of both sides
  double speed_off = 0.0;
  bool slides = false;    // friction slid in the last step
  double approach = 0.0;  // m/s
  std::shared_ptr<MotionEvent> told = {};
  int64_t begin = 0;                // the step of the chain in which the touch begins
  int64_t points = 0, changed = 0;  // code of the points that push, and the step of its last change
  // other contacts of both sides, which rest during this touch
  std::vector<std::weak_ptr<const TouchEvent>> beside;
  int32_t steps = 0;
  TouchFlaw flaw = TouchFlaw::None;
  bool whole = false;  // the end of the touch is known
  bool ended = false;
  bool is_window() const { return whole && flaw == TouchFlaw::None; }

  // Values during one pass over a tape: the delay of a tangent, the mismatch of an adjoint, and the
  // half step that each of them was last computed for.
  double delay = 0.0, mismatch = 0.0;
  int32_t forward_at = -1, backward_at = -1;
};

// A step of a touch.
struct TouchStep {
  std::shared_ptr<TouchEvent> event;
  int32_t number = 0;
  std::array<SideFrame, 2> start, end;
  std::array<Tangent, 2> before{}, after{};  // rates f at the start and the end
  std::array<std::array<Vec3d, 2>, 2> applied{};
};

// A contact within half a step of its begin or end. `event`: a touch that may replace the ramp;
// null: none.
struct TouchRamp {
  TouchRow row;
  std::array<SideFrame, 2> frames;
  std::shared_ptr<TouchEvent> event;
  bool acts() const { return event == nullptr || !event->is_window(); }
};

// Returns the report of a touch whose first row is `row`, in a step that starts at `time` (s) from
// the `frames`.
std::shared_ptr<MotionEvent> tell_touch(const Model& m, const TouchRow& row,
                                        const TouchEvent& event,
                                        const std::array<SideFrame, 2>& frames, double time,
                                        double dt);

// The common data of the two operations of a step.
struct TouchWork {
  std::vector<std::shared_ptr<TouchStep>> steps;
  std::vector<std::shared_ptr<TouchRamp>> ramps;
  // Whether the step has more than the gradient of the code.
  bool acts() const {
    return std::ranges::any_of(steps, [](const auto& s) { return s->event->is_window(); }) ||
           std::ranges::any_of(ramps, [](const auto& r) { return r->acts(); });
  }
};

// The arrays of an operation, in the order of StateRows.
using TouchArrays = std::array<nova::Operand, 6>;
// Records an operation that copies `from` to `to`, and whose derivatives include the work.
// `at_start`: at the start of a step, else after the step.
void record_touches(const std::shared_ptr<const TouchWork>& work, bool at_start,
                    const TouchArrays& from, const TouchArrays& to);

}  // namespace novaphy::diff::detail
