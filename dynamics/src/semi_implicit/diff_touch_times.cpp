// Poses of the sides of touches, and the list of events with their times (motion_events.h).
#include <algorithm>

#include "diff_touch_events.h"
#include "novaphy/math/spatial.h"

namespace novaphy::diff::detail {

namespace {
Vec3d wide(const Vec3f& a) { return {a.x, a.y, a.z}; }
}  // namespace

SideFrame frame_of(const Model& m, const SimState& s, const TouchSide& side) {
  SideFrame f{.side = side};
  if (side.body < 0) return f;
  const Quatf& q = s.body_q.data()[side.body].q;
  f.turn = {q.x, q.y, q.z, q.w};
  f.com = wide(math::rotate(q, m.body_com.data()[side.body]));
  return f;
}
std::array<Vec3d, 2> rates_of(const SimState& s, const TouchSide& side) {
  if (side.particle >= 0) return {wide(s.particle_qd.data()[side.particle]), {}};
  if (side.body < 0) return {};
  const SpatialVectorf& v = s.body_qd.data()[side.body];
  return {wide(v.linear), wide(v.angular)};
}

std::shared_ptr<MotionEvent> list_touch(const Model& m, const TouchRow& row,
                                        const TouchEvent& event,
                                        const std::array<SideFrame, 2>& frames, double time,
                                        double dt) {
  auto listed = std::make_shared<MotionEvent>();
  listed->kind = MotionEventKind::Spring;
  listed->shape0 = row.first;
  listed->world = m.shape_world.data()[row.first];
  if (row.second >= ContactPair::kParticle) {
    listed->particle = row.second - ContactPair::kParticle;
    listed->world = std::max(listed->world, m.particle_world.data()[listed->particle]);
  } else {
    listed->shape1 = row.second;
    listed->world = std::max(listed->world, m.shape_world.data()[row.second]);
  }
  listed->world = std::max(listed->world, 0);
  if (event.rubs) listed->friction = row.slides ? MotionFriction::Slides : MotionFriction::Sticks;
  listed->approach = static_cast<float>(event.approach);
  // The gap is already closed, so the touch begins in the step before this one.
  listed->set_time(time, dt, row.gap);
  listed->phase = static_cast<float>(std::clamp(1.0 + row.gap / (event.approach * dt), 0.0, 1.0));
  for (size_t i = 0; i < 2; ++i) {
    SideFrame of = frames[i];
    if (!of.side.exists()) continue;
    const bool is_body = of.side.body >= 0;
    int32_t& number = is_body ? of.side.body : of.side.particle;
    MotionEvent::TimeDerivative derivative{
        is_body ? MotionArray::BodyQ : MotionArray::ParticleQ, 0, {}};
    derivative.by.resize(is_body ? 7 : 3);
    derivative.first = int64_t{number} * static_cast<int64_t>(derivative.by.size());
    number = 0;  // row within the arrays of this side alone
    std::array<float, 6> rates{};
    of.add_gradient(event.delay_by[i],
                    is_body ? StateRows{derivative.by.data(), rates.data()}
                            : StateRows{nullptr, nullptr, derivative.by.data(), rates.data()});
    listed->derivatives.push_back(std::move(derivative));
  }
  return listed;
}

}  // namespace novaphy::diff::detail
