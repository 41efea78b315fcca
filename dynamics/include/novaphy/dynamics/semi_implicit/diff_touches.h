// Gradients of the motion for penalty contacts: the times at which contacts begin and end move with
// the state. Runs on the host. Compiled into novaphy::dynamics if nova is built.
//
// A touch is a contact of a pair from its first step with a force to its last step with a force. A
// touch is one event if two conditions hold. First, its bodies touch nothing else, except that they
// may rest on the world with the same points during the touch. Second, no joint or element acts on
// its bodies.
//
// A displacement dx of the state delays the begin by dt = -J dq / (J v), with the gradient J of the
// gap. For a step k of the touch, with the derivative D of the code, the tangent becomes
//   dx' = D (dx + f_k dt) - f_k+1 dt
// f_k are the rates of the state, with the forces that are applied in step k. At the begin, and
// after the end, f excludes the force of the touch. The states between the steps have the
// derivatives of the motion too.
//
// The adjoint is the transpose: s = sum over the steps of (D^T p)_k . f_k - p_k+1 . f_k+1, and the
// gradient by q at the begin gets s J / |J v|.
//
// All other contacts have, in the derivative only, a force averaged over a step h (touch_rows.h).
// Where |d| < h |v_n| / 2, the fraction s = 1/2 - d / (h |v_n|) of a step is in contact, so
//   dF = s dF_in - (F_in - 0)/(h |v_n|) dd
// The first method has errors O(h). The errors of the second grow with h w, w^2 = stiffness *
// inverse mass. States do not change. Source: saltation matrices as in diff_articulation_motion.h.
// A hybrid trajectory is sampled, so the fraction of the step replaces the branch.
#pragma once

#include <memory>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

namespace detail {
struct TouchEvent;
struct TouchWork;
}  // namespace detail

// The touches of a range of steps, and the counts of them for gradient labels.
class NOVAPHY_DYNAMICS_API TouchList {
 public:
  MotionCounts counts() const;
  void clear();
  std::vector<std::shared_ptr<detail::TouchEvent>> events;
  // the adjoint data of steps with touches, or with contacts near begin or end
  std::vector<std::shared_ptr<const detail::TouchWork>> works;
  int64_t ramp_steps = 0;
  int64_t limits = 0;  // joint limits that began or ended to push; times stay constant
  const char* held = nullptr;  // MotionCounts::held
};

struct TouchSettings {
  bool bodies = false, particles = false;  // which kinds of objects move
  bool rigid = false, soft = false;        // which kinds of contacts act
  bool jointed = false, elements = false;  // whether the model has joints and elements
  float smoothing = 0.0f;                  // m/s: slip below which friction of bodies is smoothed
  // Whether a backward or jvp inside a capture holds the times. Else it throws.
  bool may_hold = false;
};

// A step on a tape. Its kernels read from() and write to(): separate copies, or the given states.
struct NOVAPHY_DYNAMICS_API TouchedStep {
  TouchedStep(const SimState& in, SimState& out);
  TouchedStep(TouchedStep&&) noexcept;
  ~TouchedStep();
  const SimState& from() const { return moved_in ? *moved_in : *in; }
  SimState& to() const { return moved_out ? *moved_out : *out; }

  const SimState* in;
  SimState* out;
  std::unique_ptr<SimState> moved_in, moved_out;
  nova::Operand forces, body_forces;  // of particles {n, 3}, of bodies {b, 6}
  std::shared_ptr<detail::TouchWork> work;
};

class NOVAPHY_DYNAMICS_API TouchMotion {
 public:
  TouchMotion(const Model& model, const TouchSettings& settings);
  ~TouchMotion();
  TouchMotion(const TouchMotion&) = delete;
  TouchMotion& operator=(const TouchMotion&) = delete;

  // Call begin and end before and after the kernels of a step, on an active tape. Touches that
  // begin are added to both lists. `of_chain` is cleared if the step does not start where the last
  // one ended.
  TouchedStep begin(const Model& model, const SimState& in, SimState& out,
                    const nova::Operand& forces, const nova::Operand& body_forces,
                    const Control* control, const Contacts* contacts, float kf_rate, float dt,
                    TouchList& of_chain, TouchList& of_tape);
  void end(const Model& model, TouchedStep& step);
  // Call hold instead for a step `where` times stay constant. Such a step is one that alternates: it
  // starts where another step ended than the last one, so the contacts before it are not known.
  bool alternates(const SimState& in) const;
  void hold(const SimState& in, const SimState& out, const char* where, TouchList& of_chain,
            TouchList& of_tape);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace novaphy::diff
