#include "mjcf_mass.h"

#include <algorithm>
#include <numbers>

#include "novaphy/core/geometry/hull_of_all.h"

namespace novaphy::detail {
namespace {

Mat33d diagonal(double x, double y, double z) {
  return {{{x, 0.0, 0.0}, {0.0, y, 0.0}, {0.0, 0.0, z}}};
}

struct Facet {
  Vec3d corners[3], center, normal;
  double area;
};

Facet facet(const Mesh& surface, const std::vector<int32_t>& indices, size_t at,
            const Vec3d& origin) {
  Facet f{};
  for (size_t k = 0; k < 3; ++k) {
    const Vec3f& v = surface.vertices[static_cast<size_t>(indices[at + k])];
    f.corners[k] = Vec3d{v.x, v.y, v.z} - origin;
    f.center = f.center + f.corners[k] * (1.0 / 3.0);
  }
  const Vec3d n = math::cross(f.corners[1] - f.corners[0], f.corners[2] - f.corners[0]);
  const double length = std::sqrt(math::dot(n, n));
  f.area = 0.5 * length;
  f.normal = length > 0.0 ? n / length : Vec3d{};
  return f;
}

double component(const Vec3d& v, int k) { return k == 0 ? v.x : k == 1 ? v.y : v.z; }

}  // namespace

SolidMass primitive_mass(GeoType type, const Vec3d& s) {
  constexpr double pi = std::numbers::pi;
  const double r = s.x, h = 2.0 * s.y;
  switch (type) {
    case GeoType::SPHERE: {
      const double v = 4.0 / 3.0 * pi * r * r * r, i = 0.4 * v * r * r;
      return {v, {}, diagonal(i, i, i)};
    }
    case GeoType::CYLINDER: {
      const double v = pi * r * r * h, i = v * (3.0 * r * r + h * h) / 12.0;
      return {v, {}, diagonal(i, i, 0.5 * v * r * r)};
    }
    case GeoType::CAPSULE: {
      const double tube = pi * r * r * h, caps = 4.0 / 3.0 * pi * r * r * r;
      const double i = tube * (3.0 * r * r + h * h) / 12.0 +
                       caps * (0.4 * r * r + h * (3.0 * r + 2.0 * h) / 8.0);
      return {tube + caps, {}, diagonal(i, i, 0.5 * tube * r * r + 0.4 * caps * r * r)};
    }
    case GeoType::ELLIPSOID: {
      const double v = 4.0 / 3.0 * pi * s.x * s.y * s.z;
      return {v,
              {},
              diagonal(v * (s.y * s.y + s.z * s.z) / 5.0, v * (s.x * s.x + s.z * s.z) / 5.0,
                       v * (s.x * s.x + s.y * s.y) / 5.0)};
    }
    case GeoType::BOX: {
      const double v = 8.0 * s.x * s.y * s.z;
      return {v,
              {},
              diagonal(v * (s.y * s.y + s.z * s.z) / 3.0, v * (s.x * s.x + s.z * s.z) / 3.0,
                       v * (s.x * s.x + s.y * s.y) / 3.0)};
    }
    default:
      return {};
  }
}

SolidMass mesh_mass(const Mesh& surface, MeshInertia how) {
  const std::vector<int32_t> hull =
      how == MeshInertia::Convex ? hull_of_all(surface.vertices) : std::vector<int32_t>{};
  const std::vector<int32_t>& indices = how == MeshInertia::Convex ? hull : surface.indices;
  const bool is_shell = how == MeshInertia::Shell;
  const auto weight = [&](const Facet& f) {
    if (is_shell) return f.area;
    const double volume = math::dot(f.center, f.normal) * f.area / 3.0;
    return how == MeshInertia::Legacy ? std::abs(volume) : volume;
  };
  Vec3d middle{};
  double area = 0.0;
  for (size_t k = 0; k < indices.size(); k += 3) {
    const Facet f = facet(surface, indices, k, {});
    middle = middle + f.center * f.area;
    area += f.area;
  }
  if (!(area > 0.0)) return {};
  middle = middle / area;
  SolidMass mass;
  double sum = 0.0;
  for (size_t k = 0; k < indices.size(); k += 3) {
    const Facet f = facet(surface, indices, k, middle);
    const double w = weight(f);
    mass.com = mass.com + f.center * (is_shell ? w : 0.75 * w);
    sum += w;
  }
  if (!(std::abs(sum) > 0.0)) return {};
  mass.com = middle + mass.com / sum;
  Mat33d products{};
  for (size_t k = 0; k < indices.size(); k += 3) {
    const Facet f = facet(surface, indices, k, mass.com);
    const double w = weight(f);
    mass.volume += w;
    const Vec3d all = f.corners[0] + f.corners[1] + f.corners[2];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        double each = component(all, i) * component(all, j);
        for (const Vec3d& c : f.corners) each += component(c, i) * component(c, j);
        products.m[i][j] += w / (is_shell ? 12.0 : 20.0) * each;
      }
  }
  const double trace = products.m[0][0] + products.m[1][1] + products.m[2][2];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) mass.inertia.m[i][j] = (i == j ? trace : 0.0) - products.m[i][j];
  return mass;
}

void mend_masses(Robot& robot, const MjcfCompiler& compiler) {
  if (compiler.bound_mass > 0.0)
    for (RobotLink& link : robot.links)
      if (!link.is_between) link.mass = std::max(link.mass, compiler.bound_mass);
  if (compiler.bound_inertia > 0.0 || compiler.balance_inertia)
    for (RobotLink& link : robot.links) {
      if (link.is_between) continue;
      PrincipalAxes p = principal_axes(link.inertia);
      double* const m = p.moments;
      bool changes = false;
      for (int k = 0; k < 3; ++k) {
        changes = changes || m[k] < compiler.bound_inertia;
        m[k] = std::max(m[k], compiler.bound_inertia);
      }
      const double sum = m[0] + m[1] + m[2], largest = std::max({m[0], m[1], m[2]});
      if (compiler.balance_inertia && largest > sum - largest) {
        changes = true;
        m[0] = m[1] = m[2] = sum / 3.0;
      }
      if (!changes) continue;
      link.inertia = from_axes(p);
    }
  if (!(compiler.total_mass > 0.0)) return;
  double sum = 0.0;
  for (const RobotLink& link : robot.links) sum += link.mass;
  if (!(sum > 0.0)) return;
  const double factor = compiler.total_mass / sum;
  for (RobotLink& link : robot.links) {
    link.mass *= factor;
    for (auto& row : link.inertia.m)
      for (double& value : row) value *= factor;
  }
}

}  // namespace novaphy::detail
