// Kernels for GradientNotes: the branches of a step's contacts (which contacts push, stick and
// slip, and which have frozen points or normals). The laws are those of the semi-implicit solver
// and of VBD. The kernels run on the host and on all devices.
//
//   note_soft_contacts   contacts of particles with shapes, by the laws of both solvers
//   note_rigid_contacts  contacts of two shapes
//   note_static_particles, note_plane_pairs  the same for static contacts, which steps find by
//                        themselves
//   note_contact_events  changes since the step before, in parts or at once
//   note_gradient_step   the sum of the parts of a step
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/gradient_counts.h"
#include "novaphy/dynamics/semi_implicit/contact_moves_kernels.h"

namespace novaphy {

// The states of a step's contacts, and those of the step before. A kernel row is a contact.
struct SeenRows {
  NOVAPHY_ARGUMENTS(UpdatesRow<SeenContact> now, before; Reads<int32_t> count;  // of contacts
  )
};
inline bool next_seen(const SeenRows& of, int64_t row) {
  of.before[row] = of.now[row];
  of.now[row] = SeenContact{};
  return row < *of.count;
}

// The materials of particles and shapes.
struct SoftModes {
  NOVAPHY_ARGUMENTS(Detached<Reads<float>> mass, ke, kf, mu;
                    Number<float> model_ke, model_kf, model_mu, kf_rate;)
};

struct NoteSoftContactsArguments {
  NOVAPHY_ARGUMENTS(Part<SeenRows> seen; Reads<int32_t> particle, shape;
                    Detached<Reads<Vec3f>> point, velocity,
                    normal;                        // world; point and velocity: frame of the body
                    Detached<Reads<Vec3f>> q, qd;  // of the particles
                    Detached<Reads<Transformf>> body_q; Detached<Reads<SpatialVectorf>> body_qd;
                    Detached<Reads<Vec3f>> body_com; Reads<int32_t> shape_body, shape_type;
                    Detached<Reads<Vec3f>> shape_scale; Detached<Reads<float>> radius;
                    Optional<Detached<Reads<float>>> margin;  // null: not part of the law
                    Part<SoftModes> modes;
                    Number<float> slip;       // m/s; > 0: contacts with less slip stick
                    Number<int64_t> follows;  // points and normals move with the particles
                    Number<int64_t> shapes;)
};
// Returns the mode (SeenContact::mode) of a contact of particle p with shape s. `v`: velocity of
// the particle relative to the shape.
inline int32_t soft_mode(float gap, const Vec3f& n, const Vec3f& v, const SoftModes& of, int64_t p,
                         int32_t s, float slip) {
  if (!(gap < 0.0f) || !(of.mass[p] > 0.0f)) return 0;
  const Vec3f along = v - n * math::dot(n, v);
  const float speed = math::sqrt(math::dot(along, along));
  if (slip > 0.0f) return speed > slip || !(of.mu[s] * of.model_mu.value > 0.0f) ? 2 : 1;
  const SoftContactMaterial<float> mean = mean_soft_contact_material<float>(
      {of.model_ke.value, 0.0f, of.model_kf.value, of.model_mu.value},
      {of.ke[s], 0.0f, of.kf[s], of.mu[s]});
  const SoftContactMaterial<float> m = with_bounded_kf(mean, of.mass[p], of.kf_rate.value);
  return m.kf * speed >= math::abs((m.mu * gap) * m.ke) ? 2 : 1;
}

NOVAPHY_ROW_KERNEL(note_soft_contacts, NoteSoftContactsArguments) {
  if (!next_seen(a.seen, row)) return;
  const int32_t p = a.particle[row], s = a.shape[row];
  if (p < 0 || s < 0 || s >= a.shapes) return;
  const int32_t body = a.shape_body[s];
  SoftContactBody<float> at{a.point[row], a.velocity[row], {}};
  if (body >= 0)
    at = soft_contact_body(a.body_q[body], a.body_qd[body], a.body_com[body], a.point[row],
                           a.velocity[row]);
  const float reach = a.radius[p] + (a.margin == nullptr ? 0.0f : a.margin[s]);
  SeenContact& to = a.seen.now[row];
  to.first = s;
  to.second = ContactPair::kParticle + p;
  const bool follows = a.follows != 0 && is_followed_by_particles(a.shape_type[s]);
  to.held = follows || is_endless_plane(a.shape_type[s], a.shape_scale[s]) ? 0 : 1;
  to.mode = soft_mode(math::dot(a.normal[row], a.q[p] - at.position) - reach, a.normal[row],
                      a.qd[p] - at.velocity, a.modes, p, s, a.slip.value);
}

// Arguments for static contacts of particles with shapes of the world. A kernel row is a particle.
struct NoteStaticParticlesArguments {
  NOVAPHY_ARGUMENTS(Updates<SeenContact> now, before;
                    Optional<Reads<int32_t>> begin,
                    shape;  // the shapes of each particle; null: all
                    Detached<Reads<Vec3f>> q, qd;
                    Reads<int32_t> shape_flags, shape_body, shape_type;
                    Detached<Reads<Transformf>> shape_transform; Detached<Reads<Vec3f>> shape_scale;
                    Detached<Reads<float>> radius, margin; Part<SoftModes> modes;
                    Number<float> reach; Number<int64_t> shapes;)
};
NOVAPHY_ROW_KERNEL(note_static_particles, NoteStaticParticlesArguments) {
  const int64_t begin = a.begin == nullptr ? row * a.shapes : a.begin[row];
  const int64_t end = a.begin == nullptr ? begin + a.shapes : a.begin[row + 1];
  for (int64_t k = begin; k < end; ++k) {
    const auto s = a.begin == nullptr ? static_cast<int32_t>(k - begin) : a.shape[k];
    const int32_t type = a.shape_type[s];
    const auto is = [&](GeoType wanted) { return type == static_cast<int32_t>(wanted); };
    const StaticContact<float> at = static_shape_contact<true>(
        static_shape_type<GeoType, bool>(is), a.shape_transform[s], a.shape_scale[s], a.q[row]);
    SeenContact& to = a.now[k];
    a.before[k] = to;
    to = SeenContact{};
    to.first = s;
    to.second = ContactPair::kParticle + static_cast<int32_t>(row);
    constexpr auto kCollides = static_cast<int32_t>(ShapeFlags::COLLIDE_PARTICLES);
    const bool acts = (a.shape_flags[s] & kCollides) != 0 && a.shape_body[s] < 0 &&
                      at.distance < (a.reach.value + a.margin[s]) + a.radius[row];
    if (acts)
      to.mode = soft_mode(math::dot(at.normal, a.q[row] - at.point) - a.radius[row], at.normal,
                          a.qd[row], a.modes, row, s, 0.0f);
  }
}

// Returns the mode (SeenContact::mode) of a contact at two points. n points from B to A. u is the
// velocity of A relative to B at the point where the force acts (rigid_contact_trace.h).
inline int32_t rigid_mode(const Vec3f& n, const Vec3f& p_a, const Vec3f& p_b, const Vec3f& u,
                          const RigidContactMaterial<float>& of, float smoothing) {
  const float d = math::dot(n, p_a - p_b), un = math::dot(n, u);
  if (!(d < 0.0f)) return 0;
  const Vec3f along = u - n * un;
  float slip = math::sqrt(math::dot(along, along));
  if (slip < smoothing) slip = (slip * slip + smoothing * smoothing) / (smoothing + smoothing);
  const float limit = -of.mu * (of.ke * d + of.kd * (un < 0.0f ? un : 0.0f));
  return of.kf * slip >= limit ? 2 : 1;
}
inline Vec3f point_velocity(const SpatialVectorf& twist, const Transformf& pose, const Vec3f& com,
                            const Vec3f& at) {
  return twist.linear + math::cross(twist.angular, at - math::transform_point(pose, com));
}

struct RigidModes {
  NOVAPHY_ARGUMENTS(Detached<Reads<SpatialVectorf>> body_qd; Detached<Reads<Vec3f>> body_com;
                    Detached<Reads<float>> ke, kd, kf, mu;  // of the shapes
                    Number<float> smoothing;)
};
inline RigidContactMaterial<float> mean_of(const RigidModes& m, int32_t a, int32_t b) {
  return mean_rigid_contact_material<float>({m.ke[a], m.kd[a], m.kf[a], 0.0f, m.mu[a]},
                                            {m.ke[b], m.kd[b], m.kf[b], 0.0f, m.mu[b]});
}

struct NoteRigidContactsArguments {
  NOVAPHY_ARGUMENTS(Part<SeenRows> seen; Part<MovingContacts> of; Reads<int32_t> point_id;
                    Detached<Reads<float>> margin0, margin1;
                    Optional<Detached<Reads<float>>> row_ke, row_kd, row_mu; Part<RigidModes> modes;
                    Number<int64_t> follows, shapes;)
};
NOVAPHY_ROW_KERNEL(note_rigid_contacts, NoteRigidContactsArguments) {
  if (!next_seen(a.seen, row)) return;
  const int32_t shapes[2] = {a.of.shape0[row], a.of.shape1[row]};
  for (const int32_t s : shapes)
    if (s < 0 || s >= a.shapes) return;
  const Vec3f out = -a.of.normal[row];
  const float margins[2] = {-a.margin0[row], a.margin1[row]};
  const int32_t bodies[2] = {a.of.shape_body[shapes[0]], a.of.shape_body[shapes[1]]};
  Vec3f at[2], v[2];
  const auto pose = [&](int side) {
    return bodies[side] < 0 ? Transformf::identity() : a.of.body_q[bodies[side]];
  };
  for (int side = 0; side < 2; ++side)
    at[side] = math::transform_point(pose(side), side == 0 ? a.of.point0[row] : a.of.point1[row]) +
               out * margins[side];
  const bool both = bodies[0] >= 0 && bodies[1] >= 0;
  for (int side = 0; side < 2; ++side)
    v[side] = bodies[side] < 0 ? Vec3f{}
                               : point_velocity(a.modes.body_qd[bodies[side]], pose(side),
                                                a.modes.body_com[bodies[side]],
                                                both ? (at[0] + at[1]) * 0.5f : at[side]);
  SeenContact& to = a.seen.now[row];
  to.first = shapes[0];
  to.second = shapes[1];
  to.point = a.point_id[row];
  to.held = a.follows != 0 && contact_moves(a.of, row) ? 0 : 1;
  const auto own = [&](const float* rows) { return rows == nullptr ? 0.0f : rows[row]; };
  const RigidContactMaterial<float> of = rigid_contact_material_of_row(
      mean_of(a.modes, shapes[0], shapes[1]), own(a.row_ke), own(a.row_kd), own(a.row_mu));
  to.mode = rigid_mode(out, at[0], at[1], v[0] - v[1], of, a.modes.smoothing.value);
}

// Arguments for static contacts of planes of the world with shapes of bodies, with eight points per
// pair.
struct NotePlanePairsArguments {
  NOVAPHY_ARGUMENTS(Updates<SeenContact> now, before;
                    Reads<int32_t> pairs;  // {rows, 2}: plane, shape
                    Detached<Reads<Transformf>> body_q; Reads<int32_t> shape_body, shape_type;
                    Detached<Reads<Transformf>> shape_transform; Detached<Reads<Vec3f>> shape_scale;
                    Detached<Reads<float>> margin; Part<RigidModes> modes;)
};
inline constexpr int64_t kPlanePoints = 8;
NOVAPHY_ROW_KERNEL(note_plane_pairs, NotePlanePairsArguments) {
  const int32_t plane = a.pairs[2 * row], shape = a.pairs[2 * row + 1], body = a.shape_body[shape];
  const Transformf pose = math::multiply(a.body_q[body], a.shape_transform[shape]);
  const Vec3f up = math::rotate(a.shape_transform[plane].q, Vec3f{0.0f, 0.0f, 1.0f});
  const Vec3f on_plane = a.shape_transform[plane].p + up * a.margin[plane];
  const Vec3f h = a.shape_scale[shape];
  const int32_t type = a.shape_type[shape];
  const bool is_box = type == static_cast<int32_t>(GeoType::BOX);
  const int32_t points = is_box ? 8 : type == static_cast<int32_t>(GeoType::CAPSULE) ? 2 : 1;
  const float beyond = (is_box ? 0.0f : h.x) + a.margin[shape];
  const RigidContactMaterial<float> of = mean_of(a.modes, plane, shape);
  for (int32_t k = 0; k < kPlanePoints; ++k) {
    SeenContact& to = a.now[row * kPlanePoints + k];
    a.before[row * kPlanePoints + k] = to;
    to = SeenContact{};
    to.first = plane;
    to.second = shape;
    to.point = k;
    if (k >= points) continue;
    Vec3f local{};
    if (is_box)
      local = {(k & 1) != 0 ? h.x : -h.x, (k & 2) != 0 ? h.y : -h.y, (k & 4) != 0 ? h.z : -h.z};
    else if (points == 2)
      local.z = k == 0 ? h.y : -h.y;
    const Vec3f at = math::transform_point(pose, local) - up * beyond;
    const Vec3f v =
        point_velocity(a.modes.body_qd[body], a.body_q[body], a.modes.body_com[body], at);
    to.mode = rigid_mode(-up, on_plane, at, -v, of, a.modes.smoothing.value);
  }
}

// Returns the mode of the same contact in a list of `count` rows, which is sorted by pairs.
// `guess`: the row to try first.
inline int32_t mode_in(const SeenContact* list, int64_t count, int64_t guess,
                       const SeenContact& of) {
  const auto same = [&](const SeenContact& c) {
    return c.first == of.first && c.second == of.second;
  };
  int64_t begin = 0;
  if (guess < count && same(list[guess]) && list[guess].point == of.point) return list[guess].mode;
  for (int64_t end = count; begin < end;) {
    const int64_t middle = (begin + end) / 2;
    const SeenContact& c = list[middle];
    const bool before = c.first != of.first ? c.first < of.first : c.second < of.second;
    (before ? begin : end) = before ? middle + 1 : middle;
  }
  for (; begin < count && same(list[begin]); ++begin)
    if (list[begin].point == of.point && list[begin].mode != 0) return list[begin].mode;
  return 0;
}

// Arguments with the lists of particle contacts ("soft") and shape contacts ("rigid"). A step
// without contacts has no rows.
struct NoteContactEventsArguments {
  NOVAPHY_ARGUMENTS(
      Reads<SeenContact> soft_now, soft_before, rigid_now, rigid_before;
      Number<int64_t> soft_count, rigid_count, continues;
      WritesRow<StepNotes> notes;                // one part per row
      Optional<Updates<GradientCounts>> counts;  // null: note_gradient_step sums the parts
      Number<int64_t> step, begins;)
};
// Adds the notes of step `step` of a chain to the counts. `begins`: the counts start with this
// step. Steps without notes count as exact.
inline void note_step_of(const StepNotes& notes, int64_t step, bool begins, GradientCounts& to) {
  if (begins) to = GradientCounts{};
  to.exact += step - to.steps;
  to.steps = step;
  note_step(notes, to);
}
inline void note_list(const SeenContact* all_now, const SeenContact* all_before, int64_t count,
                      bool continues, int64_t row, int64_t n, StepNotes& to) {
  for (int64_t i = row; i < count; i += n) {
    const SeenContact &now = all_now[i], &before = all_before[i];
    if (now.mode != 0 && now.held != 0) take_first({now.first, now.second, 0}, to.held);
    if (!continues) continue;
    if (now.mode != 0) note_change(now, mode_in(all_before, count, i, now), to);
    if (before.mode != 0 && mode_in(all_now, count, i, before) == 0) note_end(before, to);
  }
}
NOVAPHY_ROW_KERNEL(note_contact_events, NoteContactEventsArguments) {
  StepNotes notes;
  const bool continues = a.continues != 0;
  note_list(a.soft_now, a.soft_before, a.soft_count, continues, row, n, notes);
  note_list(a.rigid_now, a.rigid_before, a.rigid_count, continues, row, n, notes);
  if (a.counts != nullptr) return note_step_of(notes, a.step, a.begins != 0, *a.counts);
  a.notes[row] = notes;
}

struct NoteGradientStepArguments {
  NOVAPHY_ARGUMENTS(Reads<StepNotes> notes; Updates<GradientCounts> counts;
                    Number<int64_t> parts, step, begins;)
};
NOVAPHY_ROW_KERNEL(note_gradient_step, NoteGradientStepArguments) {
  StepNotes sum;
  for (int64_t k = 0; k < a.parts; ++k) note_all(a.notes[k], sum);
  note_step_of(sum, a.step, a.begins != 0, *a.counts);
}

}  // namespace novaphy
