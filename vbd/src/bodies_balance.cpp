// The momentum of free groups of particles and bodies at the end of a step.
//
// Iterations end before all forces balance, so the parts of a group together can gain or lose
// momentum. A group gets back its momentum and its angular momentum by one small rigid motion. The
// motion hardly changes distances, and therefore forces.
#include <algorithm>
#include <numeric>

#include "bodies.h"
#include "rows.h"

namespace novaphy::vbd {
namespace {

using Vec3d = Vec3<double>;

double wide(float v) { return static_cast<double>(v); }
Vec3d wide(const Vec3f& v) { return {wide(v.x), wide(v.y), wide(v.z)}; }
Vec3d wide(const Vec4f& v) { return {wide(v.x), wide(v.y), wide(v.z)}; }
Vec3f narrow(const Vec3d& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

// Adds m (|r|^2 1 - r r^T) to the lower triangle of an inertia (kg m^2).
void add_point(double (&inertia)[3][3], double m, const Vec3d& r) {
  const double of[3] = {r.x, r.y, r.z}, square = math::dot(r, r);
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k <= i; ++k) inertia[i][k] += m * ((i == k ? square : 0.0) - of[i] * of[k]);
}

// Finds the rigid motion of a group from what it lacks.
void find_shift(BodyGroups::Group& g) {
  g.shift = g.lacks * (1.0 / g.mass);
  const double of[3] = {g.lacks_turn.x, g.lacks_turn.y, g.lacks_turn.z};
  double turn[3];
  math::solve(math::ldlt(g.inertia), of, turn);
  g.turn = {turn[0], turn[1], turn[2]};
}

}  // namespace

// Returns the last member of a member's group. Members are the components of particles, then the
// bodies, then the world.
int32_t BodyGroups::root(int32_t member) {
  while (next[at(member)] != member) member = next[at(member)] = next[at(next[at(member)])];
  return member;
}

void BodyGroups::join(int32_t a, int32_t b) {
  const auto [low, high] = std::minmax({root(a), root(b)});
  next[at(low)] = high;
}

// Joins all members that touched or that joints connect. The group of the world is not free.
void Bodies::find_groups() {
  const ColorSlots& slots = *particles_.slots;
  BodyGroups& g = groups_;
  const int32_t components = slots.component_count(), world = components + model_.body_count();
  g.next.resize(static_cast<size_t>(world) + 1);
  std::iota(g.next.begin(), g.next.end(), 0);
  g.of.assign(g.next.size(), {});
  const auto body = [&](int32_t b) {
    return b < 0 || is_kinematic_.data()[b] != 0 ? world : components + b;
  };
  const auto particle = [&](int32_t p) {
    const int32_t c = slots.components()[static_cast<size_t>(p)];
    return c < 0 ? world : c;
  };
  for (int32_t c = 0; c < components; ++c)
    if (!slots.is_free(c)) g.join(c, world);
  for (const int32_t p : near_world_) g.join(particle(p), world);
  for (const VbdTouch& t : touch_)
    if (t.has_acted != 0.0f) g.join(particle(t.particle), body(t.body));
  for (const VbdBodyContact& c : contact_)
    if (c.lam_n > 0.0f) g.join(body(c.body[0]), body(c.body[1]));
  for (const VbdBodyJoint& j : joint_) g.join(body(j.body[0]), body(j.body[1]));
  for (const VbdTouch& t : touch_)
    if (t.has_acted != 0.0f) g.of[g.at(g.root(body(t.body)))].is_balanced = true;
  g.of[g.at(g.root(world))].is_balanced = false;
}

// Calls of_particle(group, particle) and of_body(group, body) for the members of groups to balance.
template <class OfParticle, class OfBody>
void Bodies::for_members(const OfParticle& of_particle, const OfBody& of_body) {
  const ColorSlots& slots = *particles_.slots;
  const auto group = [&](int32_t member) -> BodyGroups::Group* {
    BodyGroups::Group& of = groups_.of[groups_.at(groups_.root(member))];
    return of.is_balanced ? &of : nullptr;
  };
  for (size_t p = 0; p < particles_.x.size(); ++p)
    if (const int32_t c = slots.components()[p]; c >= 0)
      if (BodyGroups::Group* const of = group(c)) of_particle(*of, p);
  for (size_t b = 0; b < motion_.size(); ++b)
    if (is_kinematic_.data()[b] == 0)
      if (BodyGroups::Group* const of = group(slots.component_count() + static_cast<int32_t>(b)))
        of_body(*of, b);
}

// Calls visit(group, mass, position, lacks) for the members of groups to balance: the position at
// the start of the step, and the displacement that leads to the inertial target.
template <class Visit>
void Bodies::for_masses(const Visit& visit) {
  for_members(
      [&](BodyGroups::Group& g, size_t p) {
        visit(g, wide(model_.particle_mass.data()[p]), wide(particles_.start[p]),
              wide(particles_.target[p]) - wide(particles_.x[p]));
      },
      [&](BodyGroups::Group& g, size_t b) {
        visit(g, wide(model_.body_mass.data()[b]), wide(start_center(b)),
              wide(body_[b].target) - wide(motion_[b].moved));
      });
}

Vec3f Bodies::start_center(size_t body) const {
  return math::transform_point(start_.data()[body], model_.body_com.data()[body]);
}

// Returns the angular momentum about the center that a body lacks without contacts, times dt
// (kg m^2).
Vec3f Bodies::lacking_spin(size_t body) const {
  const Mat33f& inertia = model_.body_inertia.data()[body];
  const auto spin = [&inertia](const Quatf& q, const Vec3f& w) {
    return math::rotate(q, math::multiply(inertia, math::rotate_inverse(q, w)));
  };
  const Quatf before = start_.data()[body].q;
  const Vec3f wanted =
      spin(before, start_qd_.data()[body].angular) + start_f_.data()[body].angular * dt_;
  return wanted * dt_ -
         spin(unit(math::multiply(motion_[body].turned, before)), motion_[body].turn);
}

void Bodies::balance() {
  using Group = BodyGroups::Group;
  // VbdInitialGuess::Previous stops particles that move together with a body. The motion would then
  // give their momentum to the body, and energy with it.
  if (touch_.empty() || options_.initial_guess == VbdInitialGuess::Previous) return;
  find_groups();
  for_masses([](Group& g, double m, const Vec3d& x, const Vec3d& lacks) {
    g.mass += m;
    g.center = g.center + x * m;
    g.lacks = g.lacks + lacks * m;
  });
  for (Group& g : groups_.of)
    if (g.mass > 0.0) g.center = g.center * (1.0 / g.mass);
  for_masses([](Group& g, double m, const Vec3d& x, const Vec3d& lacks) {
    g.lacks_turn = g.lacks_turn + math::cross(x - g.center, lacks * m);
    add_point(g.inertia, m, x - g.center);
  });
  const auto nothing = [](Group&, size_t) {};
  for_members(nothing, [&](Group& g, size_t b) {
    const double h2 = wide(dt_) * wide(dt_);
    g.lacks_turn = g.lacks_turn + wide(lacking_spin(b));
    const BodyBlock own = inertia_block(body_[b], motion_[b]);
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k <= i; ++k) g.inertia[i][k] += h2 * wide(own.h[3 + i][3 + k]);
  });
  for (Group& g : groups_.of)
    if (g.mass > 0.0) find_shift(g);
  for_members(
      [&](Group& g, size_t p) {
        const Vec4f start = particles_.start[p], before = particles_.moved[p];
        const Vec3f moved = Vec3f{before.x, before.y, before.z} + narrow(g.at_point(wide(start)));
        particles_.moved[p] = {moved.x, moved.y, moved.z, 0.0f};
        particles_.x[p] = {start.x + moved.x, start.y + moved.y, start.z + moved.z, 0.0f};
      },
      [&](Group& g, size_t b) {
        const Vec3f shift = narrow(g.at_point(wide(start_center(b)))), turn = narrow(g.turn);
        move_body(motion_[b], {shift.x, shift.y, shift.z, turn.x, turn.y, turn.z});
      });
  place_touches();
}

}  // namespace novaphy::vbd
