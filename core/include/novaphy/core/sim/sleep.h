// Sleeping bodies. An island of bodies that has been slow for some time falls asleep: its state
// keeps its bits until something wakes the island. SimState::body_sleep marks the sleeping bodies,
// so a copy of a state has the same sleeping bodies. Solvers put bodies to sleep, and contact
// searches skip sleeping bodies.
//
// The mark of a sleeping body is a hash of its pose and of the versions of the model's arrays. A
// body sleeps while its mark is valid, its velocity is zero, and no force of the state acts on it.
// A write to any of these values wakes the body. In a solver with joint coordinates the hash
// includes the coordinates of the body's FREE joint.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// An island falls asleep when each of its bodies has been slower than `speed` and `spin` for the
// time `after`.
struct SleepConfig {
  float speed = 0.01f;  // m/s, of the center of mass
  float spin = 0.05f;   // rad/s
  float after = 0.5f;   // s
  bool operator==(const SleepConfig&) const = default;
};

// Throws ErrorKind::Value, with `solver` in the message, unless all numbers are finite, speed and
// spin are >= 0, and after is in (0, kLongestRest].
inline constexpr float kLongestRest = 1000.0f;  // s
NOVAPHY_CORE_API void check_sleep(const char* solver, const SleepConfig& config);

// Returns the part of the mark that depends on the model: a hash of the versions of its arrays.
// Returns 0 if an array may change without a new version; no body may sleep then.
NOVAPHY_CORE_API uint64_t sleep_stamp(const Model& model);
// Returns the mark (< 0) of a body that sleeps at this pose. `joint_q` {7} are the coordinates of
// its FREE joint, for a solver in joint coordinates. Other solvers pass null.
inline constexpr uint32_t kSleeps = 0x80000000u, kSleepsInJoints = 0x40000000u;
inline int32_t sleep_mark(uint64_t stamp, const Transformf& pose, const float* joint_q = nullptr) {
  uint32_t words[7];
  static_assert(sizeof(words) == sizeof(pose));
  uint64_t mix = stamp;
  for (const void* seven : {static_cast<const void*>(&pose), static_cast<const void*>(joint_q)}) {
    if (seven == nullptr) break;
    std::memcpy(words, seven, sizeof(words));
    for (const uint32_t word : words) {
      mix = (mix ^ word) * 0x9E3779B97F4A7C15u;
      mix ^= mix >> 29;
    }
  }
  const uint32_t kind = joint_q == nullptr ? kSleeps : kSleeps | kSleepsInJoints;
  return static_cast<int32_t>((static_cast<uint32_t>(mix >> 32) & ~(kSleeps | kSleepsInJoints)) |
                              kind);
}
inline bool sleeps_in_joints(int32_t mark) {
  return (static_cast<uint32_t>(mark) & (kSleeps | kSleepsInJoints)) == (kSleeps | kSleepsInJoints);
}

enum class BodyActivity : uint8_t {
  Awake,   // moves under forces
  Asleep,  // sleeps: its state keeps its bits
  Driven,  // kinematic, with a velocity or a newly written pose
  Still,   // kinematic, without velocity
};

// Finds the sleeping bodies of a state. States on other devices than the CPU are not read.
class NOVAPHY_CORE_API SleepingBodies {
 public:
  // Finds the sleeping bodies. Returns false if no body sleeps.
  bool find(const Model& model, const SimState& state);
  BodyActivity motion(int32_t body) const { return motion_[static_cast<size_t>(body)]; }
  bool is_asleep(int32_t body) const { return body >= 0 && motion(body) == BodyActivity::Asleep; }
  // Returns whether a body wakes the sleeping bodies that it touches.
  bool stirs(int32_t body) const {
    return body >= 0 &&
           (motion(body) == BodyActivity::Awake || motion(body) == BodyActivity::Driven);
  }
  // Marks the island of a sleeping body for waking. Call this after find() and before
  // wake_islands().
  void wake(int32_t body);
  // Wakes all bodies of the marked islands, and appends them to `woken` in ascending order.
  void wake_islands(std::vector<int32_t>& woken);
  uint64_t stamp() const { return stamp_; }
  // Returns the FREE joint between the world and a body; -1: none.
  int32_t free_joint(int32_t body) const { return free_joint_[static_cast<size_t>(body)]; }

 private:
  void find_joints(const Model& model);
  void wake_written();
  void look(int64_t begin, int64_t end);

  const Model* model_ = nullptr;
  const SimState* state_ = nullptr;
  uint64_t stamp_ = 0;
  std::vector<BodyActivity> motion_;
  uint64_t joints_stamp_ = 0;
  std::vector<int32_t> free_joint_;  // one per body
  std::vector<uint8_t> written_;     // one per body: whether its mark is no longer valid
  std::vector<uint8_t> woken_;       // one per island, at the index of its first body
  bool any_woken_ = false;
};

}  // namespace novaphy
