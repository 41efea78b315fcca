// Exact distances of convex shapes in double precision, without the library's GJK, EPA or SAT. The
// signed distance is the largest separation over all directions. A dense search finds it, and for
// polytopes a search over their features.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <vector>

#include "novaphy/collision/geometry/collide.h"
#include "novaphy/core/geometry/convex_hull.h"

namespace geometry_test {

using namespace novaphy;
using Vec3d = Vec3<double>;

inline Vec3d widen(const Vec3f& v) { return {v.x, v.y, v.z}; }
inline Vec3f narrow(const Vec3d& v) { return {float(v.x), float(v.y), float(v.z)}; }
inline double norm(const Vec3d& v) { return std::sqrt(math::dot(v, v)); }
inline Vec3d unit(const Vec3d& v) { return v * (1.0 / norm(v)); }

// A shape somewhere; a hull keeps its tables.
struct Solid {
  geometry::Shape shape;
  Transformf pose;
  std::shared_ptr<ConvexHull> hull;
};

struct Rigid {
  Vec3d x, y, z, p;
  Vec3d out(const Vec3d& v) const { return (x * v.x + y * v.y) + z * v.z; }
  Vec3d in(const Vec3d& v) const { return {math::dot(x, v), math::dot(y, v), math::dot(z, v)}; }
  Vec3d point(const Vec3d& v) const { return out(v) + p; }
};
inline Rigid rigid(const Transformf& t) {
  double x = t.q.x, y = t.q.y, z = t.q.z, w = t.q.w;
  const double l = std::sqrt(x * x + y * y + z * z + w * w);
  x /= l, y /= l, z /= l, w /= l;
  return {{1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)},
          {2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)},
          {2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)},
          widen(t.p)};
}

// The support point of the whole shape (not of its core), in its frame.
inline Vec3d support(const geometry::Shape& shape, const Vec3d& d) {
  const Vec3d s = widen(shape.scale);
  const double rho = std::hypot(d.x, d.y);
  const Vec3d side = rho > 0 ? Vec3d{d.x / rho, d.y / rho, 0} : Vec3d{1, 0, 0};
  const double up = d.z < 0 ? -1 : 1;
  switch (shape.type) {
    case GeoType::SPHERE:
      return unit(d) * s.x;
    case GeoType::CAPSULE:
      return unit(d) * s.x + Vec3d{0, 0, up * s.y};
    case GeoType::BOX:
      return {d.x < 0 ? -s.x : s.x, d.y < 0 ? -s.y : s.y, d.z < 0 ? -s.z : s.z};
    case GeoType::CYLINDER:
      return side * s.x + Vec3d{0, 0, up * s.y};
    case GeoType::CONE: {
      const Vec3d rim = side * s.x + Vec3d{0, 0, -s.y}, apex = {0, 0, s.y};
      return math::dot(apex, d) > math::dot(rim, d) ? apex : rim;
    }
    case GeoType::ELLIPSOID: {
      const Vec3d m = {s.x * d.x, s.y * d.y, s.z * d.z};
      const double l = norm(m);
      return {s.x * m.x / l, s.y * m.y / l, s.z * m.z / l};
    }
    default: {
      Vec3d best{};
      double height = -1e300;
      for (int32_t i = 0; i < shape.hull.vertex_count; ++i) {
        const Vec3d v = widen(shape.hull.vertices[i]);
        if (math::dot(v, d) > height) {
          height = math::dot(v, d);
          best = v;
        }
      }
      return best;
    }
  }
}

struct ExactPair {
  const geometry::Shape& a;
  const geometry::Shape& b;
  Rigid ra, rb;
  ExactPair(const Solid& x, const Solid& y)
      : a(x.shape), b(y.shape), ra(rigid(x.pose)), rb(rigid(y.pose)) {}
  // How far b is from a along the unit vector n.
  double separation(const Vec3d& n) const {
    const Vec3d on_a = ra.point(support(a, ra.in(n)));
    const Vec3d on_b = rb.point(support(b, rb.in(n * -1.0)));
    return math::dot(on_b - on_a, n);
  }
};

struct Exact {
  double distance = -1e300;
  Vec3d normal{};
};
inline void keep_larger(Exact& best, double distance, const Vec3d& normal) {
  if (distance > best.distance) best = {distance, normal};
}

// Returns the maximum of f on [lo, hi] by golden section, and its place. f has one peak there.
template <class F>
double golden(double lo, double hi, int steps, F f, double& at) {
  const double g = 0.6180339887498949;
  double x = hi - g * (hi - lo), y = lo + g * (hi - lo), fx = f(x), fy = f(y);
  for (int i = 0; i < steps; ++i) {
    if (fx > fy) {
      hi = y, y = x, fy = fx;
      fx = f(x = hi - g * (hi - lo));
    } else {
      lo = x, x = y, fx = fy;
      fy = f(y = lo + g * (hi - lo));
    }
  }
  at = fx > fy ? x : y;
  return std::max(fx, fy);
}

// Refines the separation about `start`. Over the tangent plane of the sphere of directions the
// separation is concave up to the vector's length. One search over v for each u of another search
// therefore finds kinks too.
inline Exact zoom(const ExactPair& pair, const Vec3d& start) {
  Exact best{pair.separation(start), start};
  for (const double width : {0.1, 0.03, 0.002}) {
    const Vec3d n = best.normal;
    const Vec3d u = unit(math::cross(n, std::abs(n.x) < 0.6 ? Vec3d{1, 0, 0} : Vec3d{0, 1, 0}));
    const Vec3d v = math::cross(n, u);
    double s = 0, t = 0;
    const int steps = 24;
    golden(
        -width, width, steps,
        [&](double x) {
          return golden(
              -width, width, steps,
              [&](double y) { return pair.separation(unit(n + u * x + v * y)); }, t);
        },
        s);
    golden(
        -width, width, steps, [&](double y) { return pair.separation(unit(n + u * s + v * y)); },
        t);
    const Vec3d d = unit(n + u * s + v * t);
    const double found = pair.separation(d);
    if (found > best.distance) best = {found, d};
  }
  return best;
}

// The largest separation over directions: spread evenly over the sphere, then zoomed from the
// best ones that are not neighbors.
inline Exact exact_distance(const Solid& x, const Solid& y, int directions = 1500) {
  const ExactPair pair(x, y);
  std::vector<Exact> found(static_cast<size_t>(directions));
  for (int i = 0; i < directions; ++i) {
    const double z = 1 - (2 * i + 1.0) / directions, t = 2.399963229728653 * i;
    const double r = std::sqrt(1 - z * z);
    const Vec3d n = {r * std::cos(t), r * std::sin(t), z};
    found[static_cast<size_t>(i)] = {pair.separation(n), n};
  }
  std::sort(found.begin(), found.end(),
            [](const Exact& p, const Exact& q) { return p.distance > q.distance; });
  Exact best;
  std::vector<Vec3d> starts;
  for (const Exact& f : found) {
    bool near = false;
    for (const Vec3d& s : starts) near = near || math::dot(s, f.normal) > 0.95;
    if (near || f.distance < found[0].distance - 0.12) continue;
    starts.push_back(f.normal);
    const Exact e = zoom(pair, f.normal);
    keep_larger(best, e.distance, e.normal);
    if (starts.size() == 4) break;
  }
  return best;
}

struct Edges {
  std::vector<Vec3d> normals, directions;  // normals of faces, directions of edges, world frame
};
inline Edges polytope_edges(const Solid& s) {
  const Rigid r = rigid(s.pose);
  Edges e;
  if (s.shape.type == GeoType::BOX) return {{r.x, r.y, r.z}, {r.x, r.y, r.z}};
  const ConvexHull& h = *s.hull;
  const std::vector<int32_t> t = hull_triangles(h);
  auto at = [&](int32_t i) { return widen(h.vertices[size_t(i)]); };
  for (size_t k = 0; k < t.size(); k += 3) {
    const Vec3d a = at(t[k]), b = at(t[k + 1]), c = at(t[k + 2]);
    e.normals.push_back(r.out(unit(math::cross(b - a, c - a))));
    for (const Vec3d& d : {b - a, c - b, a - c}) e.directions.push_back(r.out(unit(d)));
  }
  return e;
}
// The signed distance of boxes and hulls that overlap: the best of all separating axes.
inline Exact exact_overlap(const Solid& x, const Solid& y) {
  const ExactPair pair(x, y);
  const Edges a = polytope_edges(x), b = polytope_edges(y);
  Exact best;
  auto ask = [&](const Vec3d& n) {
    const double l = norm(n);
    if (l < 1e-9) return;
    for (const double sign : {1.0, -1.0}) {
      const Vec3d d = n * (sign / l);
      keep_larger(best, pair.separation(d), d);
    }
  };
  for (const Vec3d& n : a.normals) ask(n);
  for (const Vec3d& n : b.normals) ask(n);
  for (const Vec3d& u : a.directions)
    for (const Vec3d& v : b.directions) ask(math::cross(u, v));
  return best;
}

class Scenes {
 public:
  explicit Scenes(uint32_t seed) : random_(seed) {}
  double uniform(double lo, double hi) {
    return std::uniform_real_distribution<double>(lo, hi)(random_);
  }
  Vec3d direction() {
    std::normal_distribution<double> normal;
    return unit({normal(random_), normal(random_), normal(random_)});
  }
  Quatf rotation() {
    std::normal_distribution<double> normal;
    double q[4], l = 0;
    for (double& c : q) {
      c = normal(random_);
      l += c * c;
    }
    l = std::sqrt(l);
    return {float(q[0] / l), float(q[1] / l), float(q[2] / l), float(q[3] / l)};
  }
  // Returns a solid of a size between 0.1 and 0.6 m, times `scale`.
  Solid solid(GeoType type, double scale = 1.0, int max_points = 90) {
    Solid s;
    s.shape.type = type;
    s.shape.scale = narrow(Vec3d{uniform(0.1, 0.6), uniform(0.1, 0.6), uniform(0.1, 0.6)} * scale);
    s.pose.q = rotation();
    if (type == GeoType::CONVEX_MESH) {
      const int count = static_cast<int>(uniform(6, max_points));
      std::vector<Vec3f> points;
      for (int i = 0; i < count; ++i) {
        const Vec3d d = direction();
        points.push_back({float(d.x) * s.shape.scale.x, float(d.y) * s.shape.scale.y,
                          float(d.z) * s.shape.scale.z});
      }
      set_hull(s, points);
    }
    return s;
  }
  static void set_hull(Solid& s, const std::vector<Vec3f>& points) {
    s.shape.type = GeoType::CONVEX_MESH;
    s.hull = std::make_shared<ConvexHull>(convex_hull(points));
    s.shape.hull = {s.hull->vertices.data(),          s.hull->face_normals.data(),
                    s.hull->face_starts.data(),       s.hull->face_vertices.data(),
                    s.hull->neighbor_starts.data(),   s.hull->neighbors.data(),
                    int32_t(s.hull->vertices.size()), int32_t(s.hull->face_normals.size())};
  }
  // Puts b beside a: `distance` apart along some direction (m, < 0 overlaps).
  void place(Solid& a, Solid& b, double distance) {
    a.pose.p = narrow(direction() * uniform(0, 2));
    b.pose.p = a.pose.p;
    const Vec3d n = direction();
    const double s = ExactPair(a, b).separation(n);
    b.pose.p = narrow(widen(a.pose.p) + n * (distance - s));
  }

 private:
  std::mt19937 random_;
};

inline const GeoType kConvexTypes[] = {GeoType::SPHERE,     GeoType::CAPSULE, GeoType::ELLIPSOID,
                                       GeoType::CYLINDER,   GeoType::BOX,     GeoType::CONE,
                                       GeoType::CONVEX_MESH};

}  // namespace geometry_test
