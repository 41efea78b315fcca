#include "mass_properties.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "novaphy/math/ldlt.h"
#include "novaphy/math/principal_axes.h"

namespace novaphy::detail {
namespace {

using Vec3d = Vec3<double>;
using Mat33d = Mat33<double>;
constexpr double kPi = std::numbers::pi;

Mat33d diagonal(double x, double y, double z) {
  return {{{x, 0.0, 0.0}, {0.0, y, 0.0}, {0.0, 0.0, z}}};
}

// Returns the increase of a mass's inertia if its center moves by p (parallel axis theorem).
Mat33d parallel_axis(double mass, const Vec3d& p) {
  const double xx = p.x * p.x, yy = p.y * p.y, zz = p.z * p.z;
  const double xy = -p.x * p.y * mass, xz = -p.x * p.z * mass, yz = -p.y * p.z * mass;
  return {{{(yy + zz) * mass, xy, xz}, {xy, (xx + zz) * mass, yz}, {xz, yz, (xx + yy) * mass}}};
}

Mat33d sum(const Mat33d& a, const Mat33d& b, double factor_b = 1.0) {
  Mat33d result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result.m[i][j] = a.m[i][j] + factor_b * b.m[i][j];
  return result;
}

// Returns the mass properties of a solid in closed form, for scale s. h is the full height.
MassProperties solid_mass(GeoType type, const Vec3d& s, double density) {
  const double r = s.x, h = 2.0 * s.y;
  switch (type) {
    case GeoType::SPHERE: {
      const double m = density * (4.0 / 3.0) * kPi * r * r * r, i = 0.4 * m * r * r;
      return {m, {}, diagonal(i, i, i)};
    }
    case GeoType::BOX: {
      const double m = density * 8.0 * s.x * s.y * s.z;
      const double xx = s.x * s.x, yy = s.y * s.y, zz = s.z * s.z;
      return {m, {}, diagonal(m / 3.0 * (yy + zz), m / 3.0 * (xx + zz), m / 3.0 * (xx + yy))};
    }
    case GeoType::ELLIPSOID: {
      const double m = density * (4.0 / 3.0) * kPi * s.x * s.y * s.z;
      const double xx = s.x * s.x, yy = s.y * s.y, zz = s.z * s.z;
      return {m, {}, diagonal(m / 5.0 * (yy + zz), m / 5.0 * (xx + zz), m / 5.0 * (xx + yy))};
    }
    case GeoType::CYLINDER: {
      const double m = density * kPi * r * r * h, i = m * (3.0 * r * r + h * h) / 12.0;
      return {m, {}, diagonal(i, i, m * r * r / 2.0)};
    }
    case GeoType::CAPSULE: {
      const double caps = density * (4.0 / 3.0) * kPi * r * r * r;
      const double middle = density * kPi * r * r * h;
      const double i = middle * (r * r / 4.0 + h * h / 12.0) +
                       caps * (0.4 * r * r + 0.375 * r * h + 0.25 * h * h);
      return {caps + middle, {}, diagonal(i, i, (0.5 * middle + 0.4 * caps) * r * r)};
    }
    case GeoType::CONE: {
      const double m = density * kPi * r * r * h / 3.0;
      const double i = m * (0.15 * r * r + 0.0375 * h * h);
      return {m, {0.0, 0.0, -h / 4.0}, diagonal(i, i, 0.3 * m * r * r)};
    }
    default:
      return {};
  }
}

// The hollow inside of a shell: its scale, and the height of its center above that of the shape.
struct Hollow {
  Vec3d scale;
  double z = 0.0;
};

// Returns the hollow of a cone, whose surface lies t inside the base and the lateral surface. The
// apex sinks by t over the sine of the half opening angle.
Hollow cone_hollow(double radius, double half_height, double t) {
  const double height = 2.0 * half_height;
  const double sinks = t * std::hypot(radius, height) / radius;
  const double inside = height - t - sinks;
  return {{radius * inside / height, 0.5 * inside, 0.0}, 0.5 * (t - sinks)};
}

// Returns the hollow of a shell with wall thickness t.
Hollow hollow(GeoType type, const Vec3d& s, double t) {
  const ShapeTraits traits = shape_traits(type);
  if (type == GeoType::CONE) return cone_hollow(s.x, s.y, t);
  if (traits.is_rounded) return {{s.x - t, s.y, 0.0}};
  return {{s.x - t, s.y - t, traits.size == ShapeSize::RADIUS_HEIGHT ? 0.0 : s.z - t}};
}

double trace(const Mat33d& a) { return a.m[0][0] + a.m[1][1] + a.m[2][2]; }

// Returns whether a + shift * identity is positive definite.
bool is_positive(const Mat33d& a, double shift) {
  const auto factors = math::ldlt(sum(a, diagonal(1.0, 1.0, 1.0), shift).m);
  return factors.d[0] > 0.0 && factors.d[1] > 0.0 && factors.d[2] > 0.0;
}

// Returns whether a matrix is positive definite, even after rounding errors of its entries. The
// matrix is scaled to a unit diagonal first, because the moments of a thin body differ widely.
bool is_surely_positive(const Mat33d& a) {
  Mat33d scaled;
  for (int i = 0; i < 3; ++i) {
    if (!(a.m[i][i] > 0.0)) return false;
    for (int j = 0; j < 3; ++j) scaled.m[i][j] = a.m[i][j] / std::sqrt(a.m[i][i] * a.m[j][j]);
  }
  return is_positive(scaled, -1e-7);
}

// Checks the triangle inequality of the moments of inertia. The inequality holds if and only if the
// second moments of the mass, tr(I)/2 1 - I, are >= 0. A flat body has one second moment of 0.
bool meets_triangle_inequality(const Mat33d& a, double largest) {
  const double half = trace(a) / 2.0;
  return is_positive(sum(diagonal(half, half, half), a, -1.0), 1e-5 * largest);
}

constexpr double kLeastMoment = 1e-30;  // kg m^2

struct Entries {
  Mat33d a;
  double largest = 0.0;  // largest magnitude of an entry
  bool finite = true, symmetric = true;
};
Entries entries(const Mat33f& inertia) {
  Entries e;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      e.a.m[i][j] = inertia.m[i][j];
      e.finite = e.finite && std::isfinite(e.a.m[i][j]);
      e.largest = std::max(e.largest, std::abs(e.a.m[i][j]));
    }
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < i; ++j)
      e.symmetric = e.symmetric && std::abs(e.a.m[i][j] - e.a.m[j][i]) <= 1e-5 * e.largest;
  return e;
}

// Returns the principal moments in ascending order.
std::array<double, 3> principal_moments(const Mat33d& a) {
  std::array<double, 3> moments = std::to_array(math::principal_axes(a).moments);
  std::sort(moments.begin(), moments.end());
  return moments;
}

}  // namespace

MassProperties shape_mass(std::string_view function, GeoType type, const Vec3f& scale,
                          const ShapeConfig& cfg, const SolidProperties& solid) {
  if (type == GeoType::PLANE || cfg.density == 0.0f) return {};
  if (shape_traits(type).size == ShapeSize::FACTORS) {
    MassProperties mass{cfg.density * solid.volume, solid.com, {}};
    mass.inertia = sum(mass.inertia, solid.inertia, cfg.density);
    return mass;
  }
  const Vec3d size = {scale.x, scale.y, scale.z};
  const double density = cfg.density;
  MassProperties mass = solid_mass(type, size, density);
  if (cfg.is_solid) return mass;
  const Hollow inside = hollow(type, size, cfg.margin);
  const bool has_hollow = inside.scale.x > 0.0 &&
                          (type == GeoType::SPHERE || inside.scale.y > 0.0) &&
                          (scale.z == 0.0f || inside.scale.z > 0.0);
  require(cfg.margin > 0.0f && has_hollow, ErrorKind::Value, function,
          ": cfg.margin: expected the wall of a shell (cfg.is_solid false), > 0 m and thinner than "
          "the shape, got ",
          cfg.margin, "; a shell without mass has cfg.density 0");
  MassProperties taken = solid_mass(type, inside.scale, density);
  taken.com.z += inside.z;
  const double m = mass.mass - taken.mass;
  const Vec3d com = (mass.com * mass.mass - taken.com * taken.mass) / m;
  // Both inertias are moved to the center of the shell.
  Mat33d inertia = sum(mass.inertia, parallel_axis(mass.mass, mass.com - com));
  inertia = sum(inertia, taken.inertia, -1.0);
  inertia = sum(inertia, parallel_axis(taken.mass, taken.com - com), -1.0);
  return {m, com, inertia};
}

MassProperties moved(const MassProperties& body, const Transformf& xform) {
  const Quat<double> q = {xform.q.x, xform.q.y, xform.q.z, xform.q.w};
  const Vec3d p = {xform.p.x, xform.p.y, xform.p.z};
  // Rotates the inertia, R I R^T: first the columns of I, then the rows of the result.
  Mat33d half, turned;
  for (int j = 0; j < 3; ++j) {
    const auto& m = body.inertia.m;
    const Vec3d c = math::rotate(q, Vec3d{m[0][j], m[1][j], m[2][j]});
    half.m[0][j] = c.x;
    half.m[1][j] = c.y;
    half.m[2][j] = c.z;
  }
  for (int i = 0; i < 3; ++i) {
    const Vec3d r = math::rotate(q, Vec3d{half.m[i][0], half.m[i][1], half.m[i][2]});
    turned.m[i][0] = r.x;
    turned.m[i][1] = r.y;
    turned.m[i][2] = r.z;
  }
  return {body.mass, p + math::rotate(q, body.com), turned};
}

MassProperties combined(const MassProperties& a, const MassProperties& b) {
  if (a.mass == 0.0) return b;
  if (b.mass == 0.0) return a;
  const double mass = a.mass + b.mass;
  const Vec3d com = (a.com * a.mass + b.com * b.mass) / mass;
  return {mass, com,
          sum(sum(a.inertia, parallel_axis(a.mass, a.com - com)),
              sum(b.inertia, parallel_axis(b.mass, b.com - com)))};
}

void check_inertia(const Where& where, const Mat33f& inertia, const InertiaMending& later) {
  const Entries e = entries(inertia);
  const auto check = [&](bool good, const char* expected) {
    const auto& m = inertia.m;
    require(good, ErrorKind::Value, where, ": expected ", expected, ", got ((", m[0][0], ", ",
            m[0][1], ", ", m[0][2], "), (", m[1][0], ", ", m[1][1], ", ", m[1][2], "), (", m[2][0],
            ", ", m[2][1], ", ", m[2][2], "))");
  };
  check(e.finite, "finite numbers");
  check(e.symmetric, "a symmetric matrix");
  check(later.bound || is_surely_positive(e.a),
        "a positive definite matrix, to float32 (where the axes of the body are not its principal "
        "axes, a moment below 1e-7 of the largest is lost)");
  const bool invertible = std::min({e.a.m[0][0], e.a.m[1][1], e.a.m[2][2]}) >= kLeastMoment;
  check(later.bound || invertible, "moments of at least 1e-30 kg m^2, so that float32 holds 1/I");
  check(later.balance || meets_triangle_inequality(e.a, e.largest),
        "principal moments none of which exceeds the sum of the other two");
}

double mend_inertia(Mat33f& inertia, const InertiaMending& how) {
  const Entries e = entries(inertia);
  if (!e.finite || !e.symmetric) return 0.0;
  const std::array<double, 3> moments = principal_moments(e.a);
  double raise = how.bound ? std::max(double{*how.bound} - moments[0], 0.0) : 0.0;
  if (how.balance && !meets_triangle_inequality(e.a, e.largest))
    raise = std::max(raise, moments[2] - moments[1] - moments[0]);
  if (raise > 0.0)
    for (int k = 0; k < 3; ++k) inertia.m[k][k] = static_cast<float>(e.a.m[k][k] + raise);
  return raise;
}

}  // namespace novaphy::detail
