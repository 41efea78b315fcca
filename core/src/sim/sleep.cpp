#include "novaphy/core/sim/sleep.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy {
namespace {

constexpr int64_t kChunk = 4096;  // bodies

// Returns false for NaN.
bool is_zero(const SpatialVectorf& v) {
  const Vec3f &a = v.linear, &b = v.angular;
  return a.x == 0.0f && a.y == 0.0f && a.z == 0.0f && b.x == 0.0f && b.y == 0.0f && b.z == 0.0f;
}

bool is_still(const float* rates) {
  return std::all_of(rates, rates + 6, [](float rate) { return rate == 0.0f; });
}

}  // namespace

void check_sleep(const char* solver, const SleepConfig& config) {
  const auto check = [&](const char* name, float value, bool is_good, const char* expected) {
    require(is_good, ErrorKind::Value, solver, ": sleep.", name, ": expected a finite number ",
            expected, ", got ", value);
  };
  for (const auto& [name, value] :
       {std::pair{"speed", config.speed}, std::pair{"spin", config.spin}})
    check(name, value, std::isfinite(value) && value >= 0.0f, ">= 0");
  check("after", config.after, config.after > 0.0f && config.after <= kLongestRest,
        "> 0 and at most 1000 s");
}

uint64_t sleep_stamp(const Model& model) {
  uint64_t stamp = 1;
  bool is_seen = true;
  ModelFields::visit(model, [&](const FieldInfo&, const Array& array) {
    if (array.rows() == 0) return;
    is_seen = is_seen && !array.range()->writable_export();
    stamp = (stamp ^ (array.version() + (array.range()->exports() << 40))) * 0x9E3779B97F4A7C15u;
    stamp ^= stamp >> 31;
  });
  return is_seen ? stamp | 1 : 0;
}

void SleepingBodies::look(int64_t begin, int64_t end) {
  const Vec2i* const sleep = state_->body_sleep.data();
  const Transformf* const q = state_->body_q.data();
  const SpatialVectorf *const qd = state_->body_qd.data(), *const f = state_->body_f.data();
  const int32_t* const flags = model_->body_flags.data();
  const int32_t *const q_start = model_->joint_q_start.data(), *const qd_start =
                                                                   model_->joint_qd_start.data();
  const float *const all_q = state_->joint_q.data(), *const all_qd = state_->joint_qd.data();
  for (int64_t b = begin; b < end; ++b) {
    const auto at = static_cast<size_t>(b);
    const bool is_marked = sleep[b].x < 0;
    const int32_t joint = sleeps_in_joints(sleep[b].x) ? free_joint_[at] : -1;
    const float* const joint_q = joint < 0 ? nullptr : all_q + q_start[joint];
    const bool holds = is_marked && stamp_ != 0 && sleep[b].x == sleep_mark(stamp_, q[b], joint_q);
    const bool rests = is_zero(qd[b]) && (joint < 0 || is_still(all_qd + qd_start[joint]));
    if (has_flag(flags[b], BodyFlags::KINEMATIC)) {
      written_[at] = is_marked && !holds ? 1 : 0;
      motion_[at] = rests && written_[at] == 0 ? BodyActivity::Still : BodyActivity::Driven;
    } else {
      const bool sleeps = holds && rests && is_zero(f[b]);
      written_[at] = is_marked && !sleeps ? 1 : 0;
      motion_[at] = sleeps ? BodyActivity::Asleep : BodyActivity::Awake;
    }
  }
}

void SleepingBodies::find_joints(const Model& model) {
  if (joints_stamp_ == stamp_ && stamp_ != 0) return;
  free_joint_.assign(static_cast<size_t>(model.body_count()), -1);
  const int32_t *const type = model.joint_type.data(), *const parent = model.joint_parent.data(),
                       *const child = model.joint_child.data();
  for (int32_t j = 0; j < model.joint_count(); ++j)
    if (type[j] == static_cast<int32_t>(JointType::FREE) && parent[j] < 0 && child[j] >= 0 &&
        child[j] < model.body_count())
      free_joint_[static_cast<size_t>(child[j])] = j;
  joints_stamp_ = stamp_;
}

bool SleepingBodies::find(const Model& model, const SimState& state) {
  model_ = &model;
  state_ = &state;
  const auto count = static_cast<size_t>(model.body_count());
  motion_.assign(count, BodyActivity::Awake);
  written_.assign(count, 0);
  woken_.assign(count, 0);
  any_woken_ = false;
  if (count == 0 || !state.device().is_cpu()) return false;
  stamp_ = sleep_stamp(model);
  find_joints(model);
  for_chunks(model.body_count(), kChunk,
             [&](int64_t begin, int64_t end, int64_t) { look(begin, end); });
  if (std::find(motion_.begin(), motion_.end(), BodyActivity::Asleep) == motion_.end())
    return false;
  wake_written();
  std::vector<int32_t> woken;
  if (any_woken_) wake_islands(woken);
  for (const BodyActivity motion : motion_)
    if (motion == BodyActivity::Asleep) return true;
  return false;
}

// Wakes the islands of bodies that were written. For a kinematic body that was written, all bodies
// of its world are woken, because the bodies that touched its old pose are not known.
void SleepingBodies::wake_written() {
  const int32_t* const world = model_->body_world.data();
  std::vector<uint8_t> in_world;  // index 0: objects of all worlds
  for (size_t b = 0; b < written_.size(); ++b) {
    if (written_[b] == 0) continue;
    if (motion_[b] != BodyActivity::Driven) {
      wake(static_cast<int32_t>(b));
      continue;
    }
    in_world.resize(static_cast<size_t>(model_->world_count()) + 1, 0);
    in_world[static_cast<size_t>(world[b] + 1)] = 1;
  }
  if (in_world.empty()) return;
  for (size_t b = 0; b < written_.size(); ++b)
    if (in_world[0] != 0 || world[b] < 0 || in_world[static_cast<size_t>(world[b] + 1)] != 0)
      wake(static_cast<int32_t>(b));
}

void SleepingBodies::wake(int32_t body) {
  const int32_t island = state_->body_sleep.data()[body].y;
  woken_[static_cast<size_t>(island >= 0 && island < model_->body_count() ? island : body)] = 1;
  any_woken_ = true;
}

void SleepingBodies::wake_islands(std::vector<int32_t>& woken) {
  if (!any_woken_) return;
  const Vec2i* const sleep = state_->body_sleep.data();
  const int32_t count = model_->body_count();
  for (int32_t b = 0; b < count; ++b) {
    if (motion(b) != BodyActivity::Asleep) continue;
    const int32_t island = sleep[b].y >= 0 && sleep[b].y < count ? sleep[b].y : b;
    if (woken_[static_cast<size_t>(island)] == 0) continue;
    motion_[static_cast<size_t>(b)] = BodyActivity::Awake;
    woken.push_back(b);
  }
  any_woken_ = false;
}

}  // namespace novaphy
