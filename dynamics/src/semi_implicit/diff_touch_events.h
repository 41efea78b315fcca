// TouchEvent: the data of a touch, and the effect of its steps on tangents and gradients
// (diff_touches.h).
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "novaphy/dynamics/motion_events.h"
#include "novaphy/nova/tape.h"
#include "touch_rows.h"

namespace novaphy::diff::detail {

// The tangent of a side: displacement of the center of mass (or the particle), rotation, and the
// changes of both rates.
using Tangent = std::array<Vec3d, 4>;
constexpr size_t kPosition = 0, kTurn = 1, kVelocity = 2, kSpin = 3;
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

// A side at a state, with the maps between rows of states (seven numbers per pose) and tangents.
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

// Returns the linear and angular accelerations of a side caused by a force and a moment.
std::array<Vec3d, 2> respond(const Model& m, const SideFrame& at, const Vec3d& force,
                             const Vec3d& moment);

// Bounds on the angle h w (step times contact frequency, rad) and related errors. Up to kSoftAngle
// the derivative of the mean force is that of the motion within a few percent.
constexpr double kSoftAngle = 0.1;
// The same bound for a touch whose friction changes, unless the touch rotates a body.
constexpr double kFrictionAngle = 0.15;
// Friction that removes a larger fraction of the slip in one step does not approximate the motion.
constexpr double kMostSlipTaken = 0.5;
// Bound of the relative error of the speed after a touch. The error depends on the phase at which a
// step meets the gap 0. A damper jumps at the gap 0, which changes the speed by up to its effect in
// one step. A spring changes the speed by (h w)^2 / 7. Later touches start with this error.
constexpr double kMostSpeedOff = 0.04;

enum class TouchFlaw : uint8_t {
  None,
  Several,   // several contacts at once
  OneSided,  // begin or end is not among the steps, or is cut
  Held,      // joints, elements or adhesion also act
  Long,      // too many steps
  Rests      // the approach speed is not above the effect of forces in one step
};

struct TouchEvent {
  int32_t first = 0, second = 0, point = 0;
  // derivative of the delay by positions and rotations of both sides
  std::array<Tangent, 2> delay_by{};
  double stiff_angle = 0.0;  // h w
  bool turns = false;        // the force has a moment about a center of mass
  // Friction removes most of the slip in a step. Or friction changes between sticking and slipping
  // in a stiff touch or in a touch that rotates a body.
  bool shakes = false;
  bool rubs = false;  // has friction
  // relative error of the speed by the phase, over this touch and earlier touches of both sides
  double speed_off = 0.0;
  bool slides = false;    // whether friction slid in the last step
  double approach = 0.0;  // m/s
  std::shared_ptr<MotionEvent> listed = {};
  int64_t begin = 0;                // index in the chain of the step in which the touch begins
  int64_t points = 0, changed = 0;  // code of the pushing points, and the step of its last change
  // other contacts of both sides, which are at rest during this touch
  std::vector<std::weak_ptr<const TouchEvent>> beside;
  int32_t steps = 0;
  TouchFlaw flaw = TouchFlaw::None;
  bool whole = false;  // the end of the touch is known
  bool ended = false;
  bool is_window() const { return whole && flaw == TouchFlaw::None; }

  // Values during one pass over a tape: the delay in a tangent and the mismatch in an adjoint, each
  // with the half step for which it was last computed.
  double delay = 0.0, mismatch = 0.0;
  int32_t forward_at = -1, backward_at = -1;
};

// One step of a touch.
struct TouchStep {
  std::shared_ptr<TouchEvent> event;
  int32_t number = 0;
  std::array<SideFrame, 2> start, end;
  std::array<Tangent, 2> before{}, after{};  // rates f at the start and the end
  std::array<std::array<Vec3d, 2>, 2> applied{};
  // The gradient by the state at the end, from the last adjoint with an AdjointRecord.
  std::array<Tangent, 2> costate{};
};

// A "ramp": a contact within half a step of its begin or end, with an averaged force
// (touch_rows.h). `event`: a touch that may replace the ramp; null: none.
struct TouchRamp {
  TouchRow row;
  std::array<SideFrame, 2> frames;
  std::shared_ptr<TouchEvent> event;
  Vec3d by_force{};  // the gradient by the force, from the last adjoint with an AdjointRecord
  bool acts() const { return event == nullptr || !event->is_window(); }
};

// Returns the MotionEvent of a touch whose first row is `row`, in a step that starts at `time` (s)
// with the sides at `frames`.
std::shared_ptr<MotionEvent> list_touch(const Model& m, const TouchRow& row,
                                        const TouchEvent& event,
                                        const std::array<SideFrame, 2>& frames, double time,
                                        double dt);

// The data that both operations of a step (at its start and its end) share.
struct TouchWork {
  std::vector<std::shared_ptr<TouchStep>> steps;
  std::vector<std::shared_ptr<TouchRamp>> ramps;
  const void* of_record = nullptr;  // address of the step in an AdjointRecord
  double dt = 0.0;                  // s
  bool may_hold = false;            // TouchSettings::may_hold
  mutable bool held = false;        // a backward or jvp inside a capture has held the times
  // Returns whether the gradient of the step has a term besides that of the code.
  bool acts() const {
    return std::ranges::any_of(steps, [](const auto& s) { return s->event->is_window(); }) ||
           std::ranges::any_of(ramps, [](const auto& r) { return r->acts(); });
  }
};

// The arrays of an operation, in the order of StateRows.
using TouchArrays = std::array<nova::Operand, 6>;
// Records an operation that copies `from` to `to` and whose derivatives include `work`. `at_start`:
// at the start of a step, else at its end.
void record_touches(const std::shared_ptr<const TouchWork>& work, bool at_start,
                    const TouchArrays& from, const TouchArrays& to);

}  // namespace novaphy::diff::detail
