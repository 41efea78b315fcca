// Internal: the sleep of bodies in a step of a solver (core/sim/sleep.h).
//
//   begin()          who sleeps in the state
//   wake_touched()   by contacts with what moves
//   wake_forced()    by forces that a search for contacts does not know, such as those of joints
//   end()            how long bodies have been slow, and which islands fall asleep
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/sleep.h"

namespace novaphy {

// ErrorKind::Runtime, naming `step`, for a solver with sleep on an active tape.
void check_not_on_tape(const std::optional<SleepConfig>& sleep, const char* step);

class SleepStep {
 public:
  // `in_joints`: the solver moves joint_q and joint_qd, of bodies on FREE joints.
  explicit SleepStep(const SleepConfig& config, bool in_joints = false)
      : config_(config), in_joints_(in_joints) {}

  void begin(const Model& model, const SimState& in);
  // `bodies`: of the two sides of each of the first contacts. Those touch that are nearer than the
  // mean adhesion of their shapes, or would be after `ahead` (s) of free fall.
  void wake_touched(const Model& model, const SimState& in, const Contacts& contacts,
                    std::span<const int32_t> bodies, float ahead);
  // Whether contacts of the body have no say in this step: a search that took it to sleep has left
  // them out. What carries the body is then as large as its weight.
  bool is_afloat(int32_t body) const { return afloat_[static_cast<size_t>(body)] != 0; }
  bool is_asleep(int32_t body) const { return bodies_.is_asleep(body); }
  int32_t free_joint(int32_t body) const { return bodies_.free_joint(body); }
  // Wakes the bodies of `forced`, ascending, and their islands. Others act on a body that is awake,
  // which then is not at rest.
  void wake_forced(std::span<const int32_t> forced);
  // Behind the new poses and velocities of `out`, of which those that fall asleep get zero.
  void end(const Model& model, const SimState& in, SimState& out, float dt);

 private:
  void find_touching(const Model& model, const SimState& in, const Contacts& contacts, float ahead);
  const float* joint_q(const Model& model, const SimState& state, int32_t body) const;
  int32_t find_root(int32_t body);
  bool count_rest(const Model& model, const SimState& in, SimState& out, float dt);
  void find_islands(const Model& model);

  SleepConfig config_;
  bool in_joints_;
  SleepingBodies bodies_;
  bool any_ = false;
  std::vector<uint8_t> afloat_, forced_;
  std::vector<int32_t> woken_;
  std::span<const int32_t> sides_;
  std::vector<uint8_t> touches_;      // of each contact
  std::vector<int32_t> root_, rest_;  // of each body; rest: us
};

}  // namespace novaphy
