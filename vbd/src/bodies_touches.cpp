// The contacts of particles with rigid bodies (touch_law.h) in a step of SolverVBD.
#include <cmath>

#include "bodies_side.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"

namespace novaphy::vbd {
namespace {

// Number of contacts that a thread takes at a time.
constexpr uint32_t kTouches = 64;
constexpr int64_t kDampingNumber = 11;  // of a contact, see put_contact_numbers

}  // namespace

VbdTouches Bodies::touches() {
  return {.touch = direct(touch_),
          .begin = direct(touches_of_.begins().data()),
          .items = direct(touches_of_.all().data()),
          .numbers = direct(particles_.contact_numbers),
          .x = Untyped(static_cast<const void*>(particles_.x.data())),
          .start = Untyped(static_cast<const void*>(particles_.start.data())),
          .slip = options_.friction_epsilon * dt_,
          .inside = particles_.inside};
}

void Bodies::couple(const Contacts* contacts, const StepParticles& particles) {
  particles_ = particles;
  touch_.clear();
  touched_bodies_.clear();
  near_world_.clear();
  for (size_t k = 0; k < particles.contact_slots.size(); ++k)
    put_touch(*contacts, static_cast<int32_t>(k));
  touches_of_.build(touched_bodies_, model_.body_count());
  for (int32_t body = 0; body < model_.body_count(); ++body) {
    if (touches_of_.items(body).empty() || is_kinematic_.data()[body] != 0) continue;
    pairs_.push_back({body, -1});
    numbers_.push_back(8 * body + 2 * kTouchRow);
  }
  put_graph();
  if (options_.iterations > 0) move_free_bodies();
  place_touches();
}

void Bodies::put_touch(const Contacts& contacts, int32_t contact) {
  const int32_t slot = particles_.contact_slots[static_cast<size_t>(contact)];
  VbdTouch t;
  t.body = model_.shape_body.data()[contacts.soft_contact_shape.data()[slot]];
  t.particle = contacts.soft_contact_particle.data()[slot];
  if (t.body < 0) return near_world_.push_back(t.particle);
  if (is_kinematic_.data()[t.body] == 0) {
    require(!options_.coarse, ErrorKind::NotImplemented,
            "SolverVBD.step: coarse: not supported with contacts of particles and dynamic bodies, "
            "got a contact of particle ",
            t.particle, " and body ", t.body, "; use coarse=None");
    // A damper that jumps as the overlap begins would let a light body gain energy.
    particles_.contact_numbers[static_cast<int64_t>(contact) * kContactFloats + kDampingNumber] =
        0.0f;
  }
  t.contact = contact;
  t.is_fixed = particles_.slots->is_kinematic(t.particle) ? 1.0f : 0.0f;
  const Transformf pose = start_.data()[t.body];
  const Vec3f center = math::transform_point(pose, model_.body_com.data()[t.body]);
  const Vec4f& x = particles_.start[static_cast<size_t>(t.particle)];
  t.point = math::transform_point(pose, contacts.soft_contact_body_pos.data()[slot]);
  t.core = t.point - center;
  t.arm = Vec3f{x.x, x.y, x.z} - center;
  t.drift = math::rotate(pose.q, contacts.soft_contact_body_vel.data()[slot]) * dt_;
  const Vec3f& n = contacts.soft_contact_normal.data()[slot];
  const Vec3f sum = (t.point + t.drift) + n;
  require(std::isfinite(math::dot(sum, sum)), ErrorKind::Value,
          "SolverVBD.step: contacts: soft contact ", slot, " of body ", t.body,
          ": expected a finite point, velocity and normal");
  touch_.push_back(t);
  touched_bodies_.push_back(t.body);
}

// Finds where the particles go in the next iteration of the bodies.
void Bodies::follow_bodies() {
  static const auto& kernel =
      *new Kernel<VbdTouchArguments>(kInChunks<vbd_touch, kTouches>, nullptr);
  run(kernel, static_cast<int64_t>(touch_.size()),
      {.touches = touches(), .motion = direct(motion_), .blocks = direct(particles_.blocks)});
}

void Bodies::place_touches() {
  static const auto& kernel =
      *new Kernel<VbdTouchPlaceArguments>(kInChunks<vbd_touch_place, kTouches>, nullptr);
  run(kernel, static_cast<int64_t>(touch_.size()),
      {.touches = touches(), .motion = direct(motion_)});
}

}  // namespace novaphy::vbd
