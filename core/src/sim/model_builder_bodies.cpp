// Rigid bodies of a ModelBuilder.
#include <cmath>
#include <limits>

#include "builder_checks.h"
#include "mass_properties.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/warning.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

Vec3f to_float(const Vec3<double>& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

}  // namespace

int32_t ModelBuilder::add_body(const BodyArgs& args) {
  check_sizes();
  const int32_t body = append_body("add_body", args, false);
  const std::string& label = bodies_.back().label;
  const int32_t joint =
      append_joint("add_body", JointType::FREE, -1, body, {.label = label + "_free_joint"});
  add_articulation(std::span(&joint, 1), label);
  bodies_.back().added_at = body_q.back();
  return body;
}

int32_t ModelBuilder::add_link(const BodyArgs& args) { return append_body("add_link", args, true); }

int32_t ModelBuilder::append_body(std::string_view name, const BodyArgs& args, bool is_link) {
  const Transformf pose = detail::checked_pose(name, args.xform);
  detail::check_finite({name, "com"}, args.com);
  detail::check_mass({name, "mass"}, args.mass);
  detail::check_finite({name, "gravcomp"}, args.gravcomp);
  if (args.fluid_frame) detail::checked_pose(name, {{}, *args.fluid_frame});
  if (args.inertia) {
    detail::check_inertia({name, "inertia"}, *args.inertia, {balance_inertia, bound_inertia});
    require(args.mass > 0.0f, ErrorKind::Value, name,
            ": mass: expected a number > 0 with an inertia, got ", args.mass);
  }
  require(body_count() < std::numeric_limits<int32_t>::max(), ErrorKind::Value, name,
          ": expected at most ", std::numeric_limits<int32_t>::max(), " bodies");
  const int32_t index = body_count();
  body_q.push_back(pose);
  body_qd.push_back({});
  bodies_.push_back({.com = args.com,
                     .mass = args.mass,
                     .inertia = args.inertia.value_or(Mat33f{}),
                     .lock_inertia = args.lock_inertia,
                     .is_kinematic = args.is_kinematic,
                     .is_link = is_link,
                     .world = current_world_,
                     .label = args.label.empty() ? "body_" + std::to_string(index) : args.label,
                     .gravcomp = args.gravcomp,
                     .fluid_frame = args.fluid_frame});
  return index;
}

detail::MassProperties ModelBuilder::base_mass(const Body& body) {
  detail::MassProperties base{body.mass, {body.com.x, body.com.y, body.com.z}, {}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) base.inertia.m[i][j] = body.inertia.m[i][j];
  return base;
}

std::vector<detail::MassProperties> ModelBuilder::exact_body_masses() const {
  std::vector<detail::MassProperties> bodies;
  for (const Body& body : bodies_) bodies.push_back(base_mass(body));
  for (const Shape& shape : shapes_) {
    if (shape.body < 0 || bodies_[static_cast<size_t>(shape.body)].lock_inertia) continue;
    detail::MassProperties& body = bodies[static_cast<size_t>(shape.body)];
    body = detail::combined(
        body, detail::moved(
                  detail::shape_mass("finalize", shape.type, shape.scale, shape.cfg, shape.solid),
                  shape.xform));
  }
  return bodies;
}

ModelBuilder::BodyMasses ModelBuilder::body_masses() const {
  BodyMasses masses;
  for (const detail::MassProperties& body : exact_body_masses()) {
    masses.mass.push_back(static_cast<float>(body.mass));
    masses.com.push_back(to_float(body.com));
    Mat33f inertia;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) inertia.m[i][j] = static_cast<float>(body.inertia.m[i][j]);
    masses.inertia.push_back(inertia);
  }
  return masses;
}

void ModelBuilder::mend_bodies(BodyMasses& masses) const {
  constexpr std::string_view name = "finalize";
  if (bound_mass) detail::check_positive({name, "bound_mass"}, *bound_mass);
  if (bound_inertia) detail::check_positive({name, "bound_inertia"}, *bound_inertia);
  for (size_t b = 0; b < bodies_.size(); ++b) {
    float& mass = masses.mass[b];
    if (bodies_[b].is_kinematic || !(mass > 0.0f)) continue;
    if (bound_mass && mass < *bound_mass) {
      warn_of(detail::Where{name, "body_mass", b}, " (", bodies_[b].label, "): raised from ", mass,
              " kg to bound_mass, ", *bound_mass, " kg");
      mass = *bound_mass;
    }
    const double raise = detail::mend_inertia(masses.inertia[b], {balance_inertia, bound_inertia});
    if (raise > 0.0)
      warn_of(detail::Where{name, "body_inertia", b}, " (", bodies_[b].label,
              "): all principal moments were raised by ", raise,
              " kg m^2, so that none is below bound_inertia (if there is one) and, with "
              "balance_inertia, none exceeds the sum of the other two");
  }
}

void ModelBuilder::check_bodies(const BodyMasses& masses) const {
  constexpr std::string_view name = "finalize";
  for (size_t b = 0; b < bodies_.size(); ++b) {
    detail::checked_pose({name, "body_q", b}, body_q[b]);
    detail::check_finite({name, "body_qd", b}, body_qd[b].linear);
    detail::check_finite({name, "body_qd", b}, body_qd[b].angular);
    detail::check_world_setting({name, "body_world", b}, bodies_[b].world, "gravity", gravity,
                                world_gravity_);
    if (bodies_[b].is_kinematic || (bodies_[b].is_link && masses.mass[b] == 0.0f)) continue;
    require(masses.mass[b] > 0.0f, ErrorKind::Value, detail::Where{name, "body_mass", b},
            ": expected a number > 0 for a dynamic body (give it a mass, or a shape with a "
            "density, or make it kinematic), got ",
            masses.mass[b]);
    detail::check_mass({name, "body_mass", b}, masses.mass[b]);
    detail::check_finite({name, "body_com", b}, masses.com[b]);
    detail::check_inertia({name, "body_inertia", b}, masses.inertia[b]);
  }
}

void ModelBuilder::append_bodies(const ModelBuilder& b, const Transformf& xform) {
  // The identity transform is skipped, so that it keeps the bits.
  const Transformf identity = Transformf::identity();
  const bool moves = xform != identity, turns = xform.q != identity.q;
  for (size_t i = 0; i < b.bodies_.size(); ++i) {
    const SpatialVectorf& qd = b.body_qd[i];
    body_q.push_back(moves ? math::multiply(xform, b.body_q[i]) : b.body_q[i]);
    body_qd.push_back(
        turns ? SpatialVectorf{math::rotate(xform.q, qd.linear), math::rotate(xform.q, qd.angular)}
              : qd);
    bodies_.push_back(b.bodies_[i]);
    bodies_.back().world = current_world_;
    if (moves) bodies_.back().added_at = math::multiply(xform, b.bodies_[i].added_at);
  }
}

void ModelBuilder::upload_bodies(Model& m, const BodyMasses& masses) const {
  std::vector<Transformf> pose;
  std::vector<int32_t> flags, world;
  std::vector<float> gravcomp;
  for (size_t b = 0; b < bodies_.size(); ++b) {
    pose.push_back(detail::checked_pose({"finalize", "body_q", b}, body_q[b]));
    flags.push_back(
        static_cast<int32_t>(bodies_[b].is_kinematic ? BodyFlags::KINEMATIC : BodyFlags::DYNAMIC));
    world.push_back(bodies_[b].world);
    gravcomp.push_back(bodies_[b].gravcomp);
    m.body_label.push_back(bodies_[b].label);
  }
  m.body_q.copy_from_host(std::span<const Transformf>(pose));
  m.body_qd.copy_from_host(std::span<const SpatialVectorf>(body_qd));
  m.body_com.copy_from_host(std::span<const Vec3f>(masses.com));
  m.body_mass.copy_from_host(std::span<const float>(masses.mass));
  m.body_inertia.copy_from_host(std::span<const Mat33f>(masses.inertia));
  m.body_flags.copy_from_host(std::span<const int32_t>(flags));
  m.body_world.copy_from_host(std::span<const int32_t>(world));
  m.body_gravcomp.copy_from_host(std::span<const float>(gravcomp));
  upload_fluid(m, masses);
}

}  // namespace novaphy
