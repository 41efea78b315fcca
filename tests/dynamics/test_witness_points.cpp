// The derivative of nearest points and normals, against central differences in double precision.
//
// No search is needed: a contact has six coordinates, of which the pose of B follows. Two of them
// move the point or the normal on each shape, one turns B about the normal, and one is the gap. A
// rests.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "novaphy/dynamics/articulation/turning_contacts.h"

namespace novaphy {
namespace {

using Vec3d = Vec3<double>;
using Quatd = Quat<double>;
using Posed = Transform<double>;

Vec3d unit(const Vec3d& v) { return v / std::sqrt(math::dot(v, v)); }
Quatd unit(const Quatd& q) {
  const double l = std::sqrt((q.x * q.x + q.y * q.y) + (q.z * q.z + q.w * q.w));
  return {q.x / l, q.y / l, q.z / l, q.w / l};
}
Quatd turned(const Vec3d& axis, double angle) {
  const Vec3d v = unit(axis) * std::sin(angle / 2);
  return {v.x, v.y, v.z, std::cos(angle / 2)};
}
Vec3f narrow(const Vec3d& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}
Transformf narrow(const Posed& x) {
  return {narrow(x.p),
          {static_cast<float>(x.q.x), static_cast<float>(x.q.y), static_cast<float>(x.q.z),
           static_cast<float>(x.q.w)}};
}

// A point of a core and a normal there that points out of it, in the frame of the shape.
struct Place {
  Vec3d point, normal;
};
struct Feature {
  std::string name;
  GeoType type;
  Vec3d scale;
  bool is_curved, is_straight, is_flat;  // straight along a line; flat: everywhere
  std::function<Place(double, double)> at;
};

std::vector<Feature> features() {
  const Vec3d round = {0.1, 0.12, 0.0}, half = {0.1, 0.13, 0.08}, axes = {0.15, 0.1, 0.07};
  const auto tilted = [](double s, double t) { return unit(Vec3d{0.4 + s, 0.3 + t, 0.8}); };
  const auto around = [](double s) { return Vec3d{std::cos(s + 0.7), std::sin(s + 0.7), 0.0}; };
  const auto sloped = [=](double s) {  // the normal of a cone's side
    return unit(around(s) * (2 * round.y) + Vec3d{0, 0, round.x});
  };
  return {
      {"sphere",
       GeoType::SPHERE,
       {0.1, 0, 0},
       false,
       false,
       false,
       [=](double s, double t) {
         return Place{{}, tilted(s, t)};
       }},
      {"axis",
       GeoType::CAPSULE,
       {0.06, 0.15, 0},
       false,
       true,
       false,
       [=](double s, double t) {
         return Place{{0, 0, 0.02 + s}, around(t)};
       }},
      {"corner", GeoType::BOX, half, false, false, false,
       [=](double s, double t) {
         return Place{half, tilted(s, t)};
       }},
      {"edge", GeoType::BOX, half, false, true, false,
       [=](double s, double t) {
         return Place{{0.01 + s, half.y, half.z}, {0, std::cos(0.6 + t), std::sin(0.6 + t)}};
       }},
      {"face", GeoType::BOX, half, false, false, true,
       [=](double s, double t) {
         return Place{{0.01 + s, t - 0.02, half.z}, {0, 0, 1}};
       }},
      {"side", GeoType::CYLINDER, round, true, true, false,
       [=](double s, double t) {
         return Place{around(s) * round.x + Vec3d{0, 0, 0.03 + t}, around(s)};
       }},
      {"base", GeoType::CYLINDER, round, true, false, true,
       [=](double s, double t) {
         return Place{{0.01 + s, 0.03 + t, -round.y}, {0, 0, -1}};
       }},
      {"rim", GeoType::CYLINDER, round, true, false, false,
       [=](double s, double t) {
         return Place{around(s) * round.x + Vec3d{0, 0, round.y},
                      around(s) * std::cos(0.5 + t) + Vec3d{0, 0, std::sin(0.5 + t)}};
       }},
      {"cone", GeoType::CONE, round, true, true, false,
       [=](double s, double t) {
         const double z = t - 0.02, rho = round.x * (round.y - z) / (2 * round.y);
         return Place{around(s) * rho + Vec3d{0, 0, z}, sloped(s)};
       }},
      {"apex", GeoType::CONE, round, true, false, false,
       [=](double s, double t) {
         return Place{{0, 0, round.y}, tilted(s, t)};
       }},
      {"ellipsoid", GeoType::ELLIPSOID, axes, true, false, false,
       [=](double s, double t) {
         const Vec3d n = tilted(s, t), d = {axes.x * n.x, axes.y * n.y, axes.z * n.z};
         const double l = std::sqrt(math::dot(d, d));
         return Place{{axes.x * d.x / l, axes.y * d.y / l, axes.z * d.z / l}, n};
       }},
  };
}

using Coordinates = std::array<double, 6>;  // of A, of B, the turn, the gap
struct Contact {
  Posed pose[2];
  Vec3d point[2], normal;
};

Contact contact_at(const Feature& a, const Feature& b, const Coordinates& x) {
  const Place at_a = a.at(x[0], x[1]), at_b = b.at(x[2], x[3]);
  Contact c;
  c.pose[0] = {{0.2, -0.1, 0.3}, turned({0.3, -0.5, 0.8}, 0.9)};
  c.normal = math::rotate(c.pose[0].q, at_a.normal);
  c.point[0] = math::transform_point(c.pose[0], at_a.point);
  c.point[1] = c.point[0] + c.normal * x[5];
  const Vec3d to = c.normal * -1.0, arc = math::cross(at_b.normal, to);
  const Quatd least = unit(Quatd{arc.x, arc.y, arc.z, 1 + math::dot(at_b.normal, to)});
  c.pose[1].q = math::multiply(turned(c.normal, x[4]), least);
  c.pose[1].p = c.point[1] - math::rotate(c.pose[1].q, at_b.point);
  return c;
}

// The derivative of a contact by the twist of B at the point of A, as the engine has it.
articulation::ContactTurning engine_turning(const Feature& a, const Feature& b, const Contact& c) {
  const Posed in_body[2] = {{{0.02, 0.01, -0.03}, turned({1, 0.4, 0}, 0.8)},
                            {{-0.01, 0.02, 0.01}, turned({0, 1, 0.3}, -1.1)}};
  const int32_t types[2] = {static_cast<int32_t>(a.type), static_cast<int32_t>(b.type)};
  const Vec3f scales[2] = {narrow(a.scale), narrow(b.scale)};
  const Transformf poses[2] = {narrow(in_body[0]), narrow(in_body[1])};
  articulation::TurningInput<float> of;
  for (int k = 0; k < 2; ++k) {
    const Posed body = math::multiply(c.pose[k], math::inverse(in_body[k]));
    of.shape[k] = k;
    of.point[k] = narrow(math::transform_point(math::inverse(body), c.point[k]));
    of.pose[k] = narrow(body);
  }
  of.normal = narrow(c.normal);
  const float margins[2] = {};
  return articulation::contact_turning({types, poses, scales}, of, margins, narrow(c.point[0]));
}

// The largest error of the derivatives, relative to the largest of them.
double error_of(const Feature& a, const Feature& b, const Coordinates& x) {
  const Contact c = contact_at(a, b, x);
  const articulation::ContactTurning ours = engine_turning(a, b, c);
  EXPECT_TRUE(ours.is_exact);
  const double eps = 1e-5;
  double error = 0, largest = 0;
  for (size_t k = 0; k < x.size(); ++k) {
    Coordinates hi = x, lo = x;
    hi[k] += eps;
    lo[k] -= eps;
    const Contact there = contact_at(a, b, hi), back = contact_at(a, b, lo);
    const auto rate = [&](const Vec3d& p, const Vec3d& q) { return (p - q) / (2 * eps); };
    const Quatd turn = math::multiply(there.pose[1].q, math::conjugate(back.pose[1].q));
    const Vec3d angular = Vec3d{turn.x, turn.y, turn.z} / (eps * turn.w);
    const Vec3d linear =
        rate(there.pose[1].p, back.pose[1].p) + math::cross(angular, c.point[0] - c.pose[1].p);
    const double twist[6] = {linear.x, linear.y, linear.z, angular.x, angular.y, angular.z};
    const auto compare = [&](const Vec3f(&by)[6], const Vec3d& wanted) {
      Vec3d sum;
      for (int i = 0; i < 6; ++i) sum = sum + Vec3d{by[i].x, by[i].y, by[i].z} * twist[i];
      error = std::max(error, std::sqrt(math::dot(sum - wanted, sum - wanted)));
      largest = std::max(largest, std::sqrt(math::dot(wanted, wanted)));
    };
    compare(ours.a, rate(there.point[0], back.point[0]));
    compare(ours.b, rate(there.point[1], back.point[1]));
    compare(ours.normal, rate(there.normal, back.normal));
  }
  return error / largest;
}

Feature feature_named(const std::string& name) {
  for (const Feature& f : features())
    if (f.name == name) return f;
  return {};
}

TEST(WitnessPoints, HaveTheDerivativesOfTheNearestPoints) {
  int pairs = 0;
  for (const Feature& a : features())
    for (const Feature& b : features()) {
      const bool flat = (a.is_flat && (b.is_flat || b.is_straight)) || (b.is_flat && a.is_straight);
      if (flat || !(a.is_curved || b.is_curved)) continue;
      SCOPED_TRACE(a.name + " and " + b.name);
      EXPECT_LT(error_of(a, b, {0, 0, 0, 0, 1.1, 0.03}), 1e-4);
      ++pairs;
    }
  EXPECT_EQ(pairs, 81);
}

TEST(WitnessPoints, OfAnOverlapHaveTheirDerivativesToo) {
  const Feature ellipsoid = feature_named("ellipsoid");
  for (const Feature& other : features()) {
    SCOPED_TRACE(other.name);
    EXPECT_LT(error_of(ellipsoid, other, {0, 0, 0, 0, 1.1, -0.01}), 1e-4);
    EXPECT_LT(error_of(other, ellipsoid, {0, 0, 0, 0, 1.1, -0.01}), 1e-4);
  }
}

TEST(WitnessPoints, OfAHullOnAFaceOfABoxAreItsCorners) {
  Feature corner = feature_named("corner");
  const Feature face = feature_named("face");
  corner.type = GeoType::CONVEX_MESH;
  EXPECT_LT(error_of(face, corner, {0, 0, 0, 0, 1.1, -0.002}), 1e-4);
  EXPECT_LT(error_of(corner, face, {0, 0, 0, 0, 1.1, 0.002}), 1e-4);
}

}  // namespace
}  // namespace novaphy
