#include "sleep_step.h"

#include <algorithm>
#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/math/functions.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

constexpr int64_t kChunk = 1024;  // bodies per thread
constexpr float kPerSecond = 1.0e6f;

}  // namespace

void check_not_on_tape(const std::optional<SleepConfig>& sleep, const char* step) {
  if (!sleep) return;
  const LaunchRecorder* const recorder = launch_recorder();
  require(recorder == nullptr || !recorder->has_tape(), ErrorKind::Runtime, step,
          " on an active Tape: sleep: expected None, since what sleeps has no gradient; make the "
          "solver without it, or step inside nova.no_grad()");
}

void SleepStep::begin(const Model& model, const SimState& in) {
  any_ = bodies_.find(model, in);
  const auto count = static_cast<size_t>(model.body_count());
  afloat_.assign(count, 0);
  forced_.assign(count, 0);
  sides_ = {};
  touches_.clear();
}

void SleepStep::find_touching(const Model& m, const SimState& in, const Contacts& c, float ahead) {
  const Transformf* const q = in.body_q.data();
  const SpatialVectorf* const qd = in.body_qd.data();
  const Vec3f *const point0 = c.rigid_contact_point0.data(),
                     *const point1 = c.rigid_contact_point1.data(),
                     *const normal = c.rigid_contact_normal.data(), *const com = m.body_com.data();
  const float *const margin0 = c.rigid_contact_margin0.data(),
                     *const margin1 = c.rigid_contact_margin1.data(),
                     *const ka = m.shape_material_ka.data();
  const int32_t *const shape0 = c.rigid_contact_shape0.data(), *const shape1 =
                                                                   c.rigid_contact_shape1.data();
  float fall = 0.0f;  // m, allowance for the free fall of both bodies
  for (int32_t w = 0; w < m.world_count(); ++w)
    fall = std::max(fall, 2.0f * math::length(m.gravity.data()[w]) * ahead * ahead);
  struct At {
    Vec3f place, velocity;
  };
  const auto at = [&](int32_t body, const Vec3f& point) {
    if (body < 0) return At{point, {}};
    const Vec3f place = math::transform_point(q[body], point);
    const Vec3f arm = place - math::transform_point(q[body], com[body]);
    return At{place, qd[body].linear + math::cross(qd[body].angular, arm)};
  };
  touches_.resize(sides_.size() / 2);
  for_chunks(
      static_cast<int64_t>(touches_.size()), kChunk, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t row = begin; row < end; ++row) {
          const auto k = static_cast<size_t>(row);
          const At a = at(sides_[2 * k], point0[k]), b = at(sides_[2 * k + 1], point1[k]);
          const float gap = math::dot(normal[k], b.place - a.place) - (margin0[k] + margin1[k]);
          const float closing = math::dot(normal[k], a.velocity - b.velocity);
          const float reach =
              0.5f * (ka[shape0[k]] + ka[shape1[k]]) + (math::max(closing, 0.0f) * ahead + fall);
          // The comparison is that of rigid_contact_law, so that a NaN counts as a touch.
          touches_[k] = gap >= reach ? 0 : 1;
        }
      });
}

void SleepStep::wake_touched(const Model& model, const SimState& in, const Contacts& contacts,
                             std::span<const int32_t> bodies, float ahead) {
  sides_ = bodies;
  find_touching(model, in, contacts, ahead);
  for (bool more = any_; more;) {
    for (size_t row = 0; row < touches_.size(); ++row) {
      if (touches_[row] == 0) continue;
      const int32_t a = bodies[2 * row], b = bodies[2 * row + 1];
      if (bodies_.is_asleep(a) && bodies_.stirs(b)) bodies_.wake(a);
      if (bodies_.is_asleep(b) && bodies_.stirs(a)) bodies_.wake(b);
    }
    woken_.clear();
    bodies_.wake_islands(woken_);
    more = !woken_.empty();
  }
}

void SleepStep::wake_forced(std::span<const int32_t> forced) {
  for (const int32_t b : forced) {
    forced_[static_cast<size_t>(b)] = 1;
    if (bodies_.is_asleep(b)) bodies_.wake(b);
  }
  woken_.clear();
  bodies_.wake_islands(woken_);
  for (const int32_t b : woken_) afloat_[static_cast<size_t>(b)] = 1;
}

// Returns the coordinates of the body's FREE joint. Null: the solver moves poses.
const float* SleepStep::joint_q(const Model& model, const SimState& state, int32_t body) const {
  if (!in_joints_) return nullptr;
  const int32_t joint = bodies_.free_joint(body);
  return joint < 0 ? nullptr : state.joint_q.data() + model.joint_q_start.data()[joint];
}

int32_t SleepStep::find_root(int32_t body) {
  while (root_[static_cast<size_t>(body)] != body) {
    int32_t& up = root_[static_cast<size_t>(body)];
    up = root_[static_cast<size_t>(up)];
    body = up;
  }
  return body;
}

// Counts the rest time of bodies. Returns whether a body has been slow for long enough to sleep.
bool SleepStep::count_rest(const Model& model, const SimState& in, SimState& out, float dt) {
  const Vec2i* const before = in.body_sleep.data();
  const Transformf* const q = out.body_q.data();
  const SpatialVectorf *const qd = out.body_qd.data(), *const f = in.body_f.data();
  Vec2i* const after = out.body_sleep.mutable_data();
  const auto step = static_cast<int32_t>(std::max(1.0f, std::round(dt * kPerSecond)));
  const auto most = static_cast<int32_t>(config_.after * kPerSecond);
  const auto is_slow = [&](const SpatialVectorf& v) {
    return math::dot(v.linear, v.linear) < config_.speed * config_.speed &&
           math::dot(v.angular, v.angular) < config_.spin * config_.spin;
  };
  const auto is_zero = [](const SpatialVectorf& v) {
    return math::dot(v.linear, v.linear) == 0.0f && math::dot(v.angular, v.angular) == 0.0f;
  };
  const uint64_t stamp = bodies_.stamp();
  for_chunks(model.body_count(), kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t b = begin; b < end; ++b) {
      const auto at = static_cast<size_t>(b);
      const BodyActivity motion = bodies_.motion(static_cast<int32_t>(b));
      rest_[at] = -1;
      if (motion == BodyActivity::Asleep) {
        after[b] = before[b];
      } else if (motion != BodyActivity::Awake) {
        const float* const of_joint = joint_q(model, out, static_cast<int32_t>(b));
        after[b] = {stamp != 0 && is_zero(qd[b]) ? sleep_mark(stamp, q[b], of_joint) : 0, -1};
      } else {
        const bool rests = is_slow(qd[b]) && forced_[at] == 0 && is_zero(f[b]);
        rest_[at] = rests ? std::min(std::max(before[b].x, 0), most) + step : 0;
        after[b] = {rest_[at], -1};
      }
    }
  });
  return stamp != 0 &&
         std::any_of(rest_.begin(), rest_.end(), [&](int32_t us) { return us >= most; });
}

// Merges bodies that touch into islands. The rest time of a root becomes the shortest in its
// island.
void SleepStep::find_islands(const Model& model) {
  for (int32_t b = 0; b < model.body_count(); ++b) root_[static_cast<size_t>(b)] = b;
  const auto is_free = [&](int32_t b) {
    return b >= 0 && bodies_.motion(b) == BodyActivity::Awake;
  };
  for (size_t row = 0; row < touches_.size(); ++row) {
    if (touches_[row] == 0) continue;
    const int32_t a = sides_[2 * row], b = sides_[2 * row + 1];
    if (is_free(a) && is_free(b)) {
      const int32_t x = find_root(a), y = find_root(b);
      root_[static_cast<size_t>(std::max(x, y))] = std::min(x, y);
    } else if (is_free(a) || is_free(b)) {
      const int32_t other = is_free(a) ? b : a;
      if (bodies_.stirs(other)) rest_[static_cast<size_t>(is_free(a) ? a : b)] = 0;
    }
  }
  for (int32_t b = 0; b < model.body_count(); ++b) {
    if (rest_[static_cast<size_t>(b)] < 0) continue;
    int32_t& least = rest_[static_cast<size_t>(find_root(b))];
    least = std::min(least, rest_[static_cast<size_t>(b)]);
  }
}

void SleepStep::end(const Model& model, const SimState& in, SimState& out, float dt) {
  const auto count = static_cast<size_t>(model.body_count());
  root_.resize(count);
  rest_.resize(count);
  if (!count_rest(model, in, out, dt)) return;
  find_islands(model);
  const auto most = static_cast<int32_t>(config_.after * kPerSecond);
  Vec2i* const after = out.body_sleep.mutable_data();
  SpatialVectorf* const qd = out.body_qd.mutable_data();
  const Transformf* const q = out.body_q.data();
  for (int32_t b = 0; b < model.body_count(); ++b) {
    if (rest_[static_cast<size_t>(b)] < 0) continue;
    const int32_t root = find_root(b);
    if (rest_[static_cast<size_t>(root)] < most) continue;
    after[b] = {sleep_mark(bodies_.stamp(), q[b], joint_q(model, out, b)), root};
    qd[b] = {};
    if (in_joints_) {
      float* const rates =
          out.joint_qd.mutable_data() + model.joint_qd_start.data()[bodies_.free_joint(b)];
      std::fill(rates, rates + 6, 0.0f);
    }
  }
}

}  // namespace novaphy
