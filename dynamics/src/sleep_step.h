// SleepStep: the sleep of bodies in a step of a solver (core/sim/sleep.h). Internal.
//
//   begin()          finds the bodies that sleep in the state
//   wake_touched()   wakes bodies that touch moving bodies
//   wake_forced()    wakes bodies under forces other than contact forces, such as joint forces
//   end()            counts the rest time of slow bodies, and puts islands to sleep
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/sleep.h"

namespace novaphy {

// Throws ErrorKind::Runtime, with `step`, if a solver with sleep runs on an active tape.
void check_not_on_tape(const std::optional<SleepConfig>& sleep, const char* step);

class SleepStep {
 public:
  // `in_joints`: the solver moves joint_q and joint_qd of bodies on FREE joints.
  explicit SleepStep(const SleepConfig& config, bool in_joints = false)
      : config_(config), in_joints_(in_joints) {}

  void begin(const Model& model, const SimState& in);
  // Wakes bodies that touch moving bodies. `bodies`: the two bodies of each of the first contacts,
  // one after the other. Two bodies touch if they are nearer than the mean adhesion distance of
  // their shapes, or would be after `ahead` (s) of free fall.
  void wake_touched(const Model& model, const SimState& in, const Contacts& contacts,
                    std::span<const int32_t> bodies, float ahead);
  // Returns whether this step ignores the contacts of the body: the search assumed that the body
  // sleeps and left its contacts out. The step then also omits the weight of the body.
  bool is_afloat(int32_t body) const { return afloat_[static_cast<size_t>(body)] != 0; }
  bool is_asleep(int32_t body) const { return bodies_.is_asleep(body); }
  int32_t free_joint(int32_t body) const { return bodies_.free_joint(body); }
  // Wakes the bodies in `forced` (ascending) and their islands. Forces act on these bodies, so they
  // do not rest.
  void wake_forced(std::span<const int32_t> forced);
  // Counts rest times and puts islands to sleep. Call this after the new poses and velocities of
  // `out` are written. Bodies that fall asleep get zero velocity.
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
  std::vector<uint8_t> touches_;      // per contact
  std::vector<int32_t> root_, rest_;  // per body; rest: rest time, microseconds
};

}  // namespace novaphy
