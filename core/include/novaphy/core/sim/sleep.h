// Sleeping bodies: an island of bodies that has been slow for some time keeps its bits until
// something wakes it. SimState::body_sleep says which bodies sleep, so a copy of a state sleeps
// likewise. Solvers put bodies to sleep, and searches for contacts leave out what sleeps.
//
// A body sleeps while its mark is that of its pose and of the model's arrays, its velocity is zero
// and no force of the state acts on it. So whatever writes one of these wakes the body. Marks of a
// solver in joint coordinates are also those of the coordinates of its FREE joint.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

// An island falls asleep once each of its bodies has been slower than `speed` and `spin` for
// `after`.
struct SleepConfig {
  float speed = 0.01f;  // m/s, of the center of mass
  float spin = 0.05f;   // rad/s
  float after = 0.5f;   // s
  bool operator==(const SleepConfig&) const = default;
};

// ErrorKind::Value, naming `solver`, unless all numbers are finite, speed and spin >= 0, and after
// > 0 and at most kLongestRest.
inline constexpr float kLongestRest = 1000.0f;  // s
NOVAPHY_CORE_API void check_sleep(const char* solver, const SleepConfig& config);

// What the marks of a model's bodies are made with: the versions of its arrays. 0: one of them may
// change unseen, so that no body sleeps.
NOVAPHY_CORE_API uint64_t sleep_stamp(const Model& model);
// The mark of a body that sleeps at this pose, < 0. `joint_q`: the coordinates of its FREE joint
// {7}, of a solver that moves these; null: of one that moves the pose.
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
  Awake,   // moves by forces
  Asleep,  // keeps its bits
  Driven,  // kinematic, with a velocity or a pose that was written
  Still,   // kinematic, at rest
};

// Which bodies of a state sleep. A state on another device than the CPU is not read.
class NOVAPHY_CORE_API SleepingBodies {
 public:
  // False: none sleeps.
  bool find(const Model& model, const SimState& state);
  BodyActivity motion(int32_t body) const { return motion_[static_cast<size_t>(body)]; }
  bool is_asleep(int32_t body) const { return body >= 0 && motion(body) == BodyActivity::Asleep; }
  // Whether a body wakes what it touches.
  bool stirs(int32_t body) const {
    return body >= 0 &&
           (motion(body) == BodyActivity::Awake || motion(body) == BodyActivity::Driven);
  }
  // Behind find(): wakes the island of a body that sleeps, with wake_islands().
  void wake(int32_t body);
  // Wakes all bodies of the islands that were woken, and appends them to `woken`, ascending.
  void wake_islands(std::vector<int32_t>& woken);
  uint64_t stamp() const { return stamp_; }
  // The FREE joint from the world that a body hangs on; -1: none.
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
  std::vector<int32_t> free_joint_;  // of each body
  std::vector<uint8_t> written_;     // of each body: it has a mark that no longer holds
  std::vector<uint8_t> woken_;       // of each first body of an island
  bool any_woken_ = false;
};

}  // namespace novaphy
