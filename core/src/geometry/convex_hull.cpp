#include "novaphy/core/geometry/convex_hull.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <queue>
#include <set>
#include <span>

#include "geometry/edge_owners.h"
#include "geometry/vector_double.h"
#include "novaphy/core/error.h"
#include "novaphy/core/geometry/hull_of_all.h"

namespace novaphy {
namespace {

using detail::Edge;
using detail::Vec3d;

constexpr double kFlat = 1e-6;                    // times the extent: smaller heights are flat
constexpr double kVisible = 1e-9;                 // times the extent: least height above a face
constexpr double kCoplanarCosine = 1 - 1.523e-6;  // 0.1 deg
constexpr double kLost = 0.01;                    // times the thickness: largest loss by a merge

struct Triangle {
  std::array<int32_t, 3> v;
  Vec3d normal;
  double offset = 0.0;
  std::vector<int32_t> outside;  // points above the triangle
  int32_t farthest = -1;
  double height = 0.0;
  bool is_gone = false, is_seen = false;
};

class Quickhull {
 public:
  Quickhull(std::span<const Vec3f> points, int32_t max_vertices);
  std::vector<Triangle> triangles;
  std::vector<Vec3d> points;  // relative to the middle of their bounding box
  double extent = 0.0;

 private:
  // A triangle with a point above it. The queue takes the highest point, on ties the lowest index.
  struct Candidate {
    double height;
    int32_t point;
    size_t triangle;
    bool operator<(const Candidate& other) const {
      return height != other.height ? height < other.height : point > other.point;
    }
  };
  void start();
  bool grow();  // adds a point; false if no point is outside
  void add_triangle(int32_t i, int32_t j, int32_t k);
  void distribute(const std::vector<int32_t>& candidates, size_t first);
  std::vector<size_t> seen_by(size_t start, const Vec3d& p);
  void drop_gone();

  detail::EdgeOwners owner_;
  std::priority_queue<Candidate> candidates_;
  size_t gone_ = 0;
};

Quickhull::Quickhull(std::span<const Vec3f> input, int32_t max_vertices) {
  Vec3d lo = detail::to_double(input[0]), hi = lo;
  for (const Vec3f& p : input) {
    const Vec3d x = detail::to_double(p);
    lo = {std::min(lo.x, x.x), std::min(lo.y, x.y), std::min(lo.z, x.z)};
    hi = {std::max(hi.x, x.x), std::max(hi.y, x.y), std::max(hi.z, x.z)};
  }
  const Vec3d middle = (lo + hi) * 0.5;
  points.reserve(input.size());
  for (const Vec3f& p : input) points.push_back(detail::to_double(p) - middle);
  extent = std::max({hi.x - lo.x, hi.y - lo.y, hi.z - lo.z});
  start();
  for (int32_t vertices = 4; vertices < max_vertices && grow();) ++vertices;
  drop_gone();
}

// Returns the index of the largest score, and the smallest such index on a tie.
template <class Score>
int32_t largest(const std::vector<Vec3d>& points, Score score) {
  int32_t best = 0;
  double best_score = score(points[0]);
  for (size_t i = 1; i < points.size(); ++i) {
    const double s = score(points[i]);
    if (s > best_score) {
      best = static_cast<int32_t>(i);
      best_score = s;
    }
  }
  return best;
}

// Makes the initial tetrahedron: the farthest pair of extreme points, the point farthest from their
// line, and the point farthest from the plane of the three.
void Quickhull::start() {
  std::vector<int32_t> extreme;
  for (const Vec3d d : {Vec3d{1, 0, 0}, Vec3d{0, 1, 0}, Vec3d{0, 0, 1}})
    for (const double sign : {-1.0, 1.0})
      extreme.push_back(largest(points, [&](const Vec3d& p) { return sign * math::dot(d, p); }));
  int32_t a = 0, b = 0;
  double longest = 0.0;
  for (const int32_t i : extreme)
    for (const int32_t j : extreme)
      if (const double l = detail::norm(points[j] - points[i]); l > longest) {
        longest = l;
        a = i;
        b = j;
      }
  const double flat = kFlat * extent;
  constexpr const char* kExpected = "convex_hull: points: expected 4 that span a volume, got ";
  require(longest > 0.0, ErrorKind::Value, kExpected, points.size(), " in one place");
  const Vec3d o = points[a], u = detail::unit(points[b] - o);
  const int32_t c =
      largest(points, [&](const Vec3d& p) { return detail::norm(math::cross(p - o, u)); });
  require(detail::norm(math::cross(points[c] - o, u)) > flat, ErrorKind::Value, kExpected,
          points.size(), " on one line, to 1e-6 of their extent");
  const Vec3d n = detail::unit(math::cross(u, points[c] - o));
  const int32_t d = largest(points, [&](const Vec3d& p) { return std::abs(math::dot(n, p - o)); });
  const double height = math::dot(n, points[d] - o);
  require(std::abs(height) > flat, ErrorKind::Value, kExpected, points.size(),
          " in one plane, to 1e-6 of their extent");
  const bool above = height > 0.0;
  add_triangle(a, above ? c : b, above ? b : c);
  add_triangle(a, above ? b : c, d);
  add_triangle(above ? b : c, above ? c : b, d);
  add_triangle(above ? c : b, a, d);
  std::vector<int32_t> all(points.size());
  std::iota(all.begin(), all.end(), 0);
  distribute(all, 0);
}

void Quickhull::add_triangle(int32_t i, int32_t j, int32_t k) {
  Triangle t;
  t.v = {i, j, k};
  t.normal = detail::unit(math::cross(points[j] - points[i], points[k] - points[i]));
  t.offset = math::dot(t.normal, points[i]);
  for (size_t e = 0; e < 3; ++e) owner_[{t.v[e], t.v[(e + 1) % 3]}] = triangles.size();
  triangles.push_back(std::move(t));
}

// Removes the triangles that are gone. The others keep their order.
void Quickhull::drop_gone() {
  std::erase_if(triangles, [](const Triangle& t) { return t.is_gone; });
  gone_ = 0;
  owner_.clear();
  candidates_ = {};
  for (size_t t = 0; t < triangles.size(); ++t) {
    const Triangle& of = triangles[t];
    for (size_t e = 0; e < 3; ++e) owner_[{of.v[e], of.v[(e + 1) % 3]}] = t;
    if (of.farthest >= 0) candidates_.push({of.height, of.farthest, t});
  }
}

// Assigns each point to the triangle above which the point is highest, from index `first` on.
void Quickhull::distribute(const std::vector<int32_t>& candidates, size_t first) {
  std::vector<std::pair<Vec3d, double>> planes;
  for (size_t t = first; t < triangles.size(); ++t)
    planes.emplace_back(triangles[t].normal, triangles[t].offset);
  for (const int32_t i : candidates) {
    const Vec3d p = points[i];
    double height = kFlat * extent;
    size_t owner = planes.size();
    for (size_t k = 0; k < planes.size(); ++k) {
      const double h = math::dot(planes[k].first, p) - planes[k].second;
      if (!(h > height)) continue;
      height = h;
      owner = k;
    }
    if (owner == planes.size()) continue;
    Triangle& t = triangles[first + owner];
    t.outside.push_back(i);
    const bool is_first = height == t.height && i < t.farthest;  // candidates come in any order
    if (height > t.height || is_first) t.farthest = i;
    t.height = std::max(t.height, height);
  }
  for (size_t t = first; t < triangles.size(); ++t)
    if (triangles[t].farthest >= 0)
      candidates_.push({triangles[t].height, triangles[t].farthest, t});
}

// Returns, ascending, the triangles visible from p and connected to `start`, which is visible too.
std::vector<size_t> Quickhull::seen_by(size_t start, const Vec3d& p) {
  std::vector<size_t> seen = {start};
  triangles[start].is_seen = true;
  for (size_t i = 0; i < seen.size(); ++i) {
    const std::array<int32_t, 3> v = triangles[seen[i]].v;
    for (size_t k = 0; k < 3; ++k) {
      const size_t next = owner_.at({v[(k + 1) % 3], v[k]});
      Triangle& n = triangles[next];
      if (n.is_seen || !(math::dot(n.normal, p) - n.offset > kVisible * extent)) continue;
      n.is_seen = true;
      seen.push_back(next);
    }
  }
  std::sort(seen.begin(), seen.end());
  return seen;
}

bool Quickhull::grow() {
  while (!candidates_.empty() && triangles[candidates_.top().triangle].is_gone) candidates_.pop();
  if (candidates_.empty()) return false;
  const Candidate from = candidates_.top();
  std::set<Edge> horizon;
  std::vector<int32_t> orphans;
  for (const size_t i : seen_by(from.triangle, points[from.point])) {
    Triangle& t = triangles[i];
    t.is_gone = true;
    ++gone_;
    orphans.insert(orphans.end(), t.outside.begin(), t.outside.end());
    t.outside = {};
    for (int k = 0; k < 3; ++k) {
      const Edge edge = {t.v[k], t.v[(k + 1) % 3]};
      if (horizon.erase({edge.second, edge.first}) == 0) horizon.insert(edge);
    }
  }
  const size_t first = triangles.size();
  for (const auto& [i, j] : horizon) add_triangle(i, j, from.point);
  distribute(orphans, first);
  if (gone_ > 1024 && 2 * gone_ > triangles.size()) drop_gone();
  return true;
}

struct Polygon {
  std::vector<int32_t> v;
  Vec3d normal;
};

// Returns the outline of a group of triangles as a loop from its smallest vertex. The result is
// empty unless the outline is a single loop.
std::vector<int32_t> outline(const std::vector<Triangle>& triangles,
                             const std::vector<size_t>& group) {
  std::set<Edge> edges;
  for (const size_t t : group)
    for (int k = 0; k < 3; ++k) {
      const Edge e = {triangles[t].v[k], triangles[t].v[(k + 1) % 3]};
      if (edges.erase({e.second, e.first}) == 0) edges.insert(e);
    }
  std::map<int32_t, int32_t> next;
  for (const auto& [i, j] : edges)
    if (!next.emplace(i, j).second) return {};
  std::vector<int32_t> loop;
  for (int32_t i = next.begin()->first; loop.empty() || i != loop[0]; i = next.at(i)) {
    if (loop.size() == next.size()) return {};
    loop.push_back(i);
  }
  if (loop.size() != next.size()) return {};
  return loop;
}

// Returns twice the vector area (Newell), in the direction of the normal that fits all corners.
Vec3d vector_area(const std::vector<Vec3d>& points, const std::vector<int32_t>& v) {
  Vec3d sum{};
  for (size_t k = 1; k + 1 < v.size(); ++k)
    sum = sum + math::cross(points[v[k]] - points[v[0]], points[v[k + 1]] - points[v[0]]);
  return sum;
}

// Merges coplanar neighbors, beginning with the largest triangle. A merge removes the corners
// inside of the outline. A merge that would make the hull thinner by kLost, or flat, is refused.
std::vector<Polygon> merge_coplanar(const Quickhull& hull) {
  const std::vector<Triangle>& triangles = hull.triangles;
  detail::EdgeOwners owner;
  std::vector<double> area(triangles.size());
  for (size_t t = 0; t < triangles.size(); ++t) {
    const auto& v = triangles[t].v;
    area[t] = detail::norm(vector_area(hull.points, {v[0], v[1], v[2]}));
    for (int k = 0; k < 3; ++k) owner[{v[k], v[(k + 1) % 3]}] = t;
  }
  std::vector<size_t> order(triangles.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return area[a] > area[b]; });
  std::vector<bool> taken(triangles.size());
  std::vector<Polygon> polygons;
  for (const size_t seed : order) {
    if (taken[seed]) continue;
    taken[seed] = true;
    const Triangle& s = triangles[seed];
    auto in_plane = [&](const Triangle& t) {
      if (math::dot(t.normal, s.normal) >= kCoplanarCosine) return true;
      return std::all_of(t.v.begin(), t.v.end(), [&](int32_t i) {
        return std::abs(math::dot(s.normal, hull.points[i]) - s.offset) <= kFlat * hull.extent;
      });
    };
    double thickness = 0.0;  // thickness of the hull below the face
    for (const Triangle& t : triangles)
      for (const int32_t i : t.v)
        thickness = std::max(thickness, s.offset - math::dot(s.normal, hull.points[i]));
    // Returns whether a merge with the outline `loop` removes only corners within the tolerance.
    const auto keeps_corners = [&](const std::vector<int32_t>& loop, std::span<const size_t> of) {
      if (loop.empty()) return false;
      const Vec3d up = detail::unit(vector_area(hull.points, loop));
      return std::all_of(of.begin(), of.end(), [&](size_t t) {
        return std::all_of(triangles[t].v.begin(), triangles[t].v.end(), [&](int32_t i) {
          const double above = math::dot(up, hull.points[i] - hull.points[loop[0]]);
          return above <= kLost * thickness || std::find(loop.begin(), loop.end(), i) != loop.end();
        });
      });
    };
    std::vector<size_t> group = {seed};
    for (size_t g = 0; g < group.size(); ++g)
      for (int k = 0; k < 3; ++k) {
        const auto& v = triangles[group[g]].v;
        const size_t other = owner.at({v[(k + 1) % 3], v[k]});
        if (taken[other] || !in_plane(triangles[other])) continue;
        group.push_back(other);
        if (!keeps_corners(outline(triangles, group), group)) {
          group.pop_back();
          continue;
        }
        taken[other] = true;
      }
    Polygon polygon{outline(triangles, group), {}};
    polygon.normal = detail::unit(vector_area(hull.points, polygon.v));
    polygons.push_back(std::move(polygon));
  }
  return polygons;
}

// Makes the tables of the hull. Triangle edges inside merged faces still connect neighbors, because
// a merged face is flat only to 0.1 degrees. Without these edges, a hill climb to the farthest
// vertex in a direction could stop at the lower side of a face.
ConvexHull tables(std::span<const Vec3f> points, const std::vector<Triangle>& triangles,
                  std::vector<Polygon> polygons) {
  std::set<int32_t> used;
  for (const Polygon& polygon : polygons) used.insert(polygon.v.begin(), polygon.v.end());
  ConvexHull hull;
  std::map<int32_t, int32_t> number;
  for (const int32_t i : used) {
    number[i] = static_cast<int32_t>(hull.vertices.size());
    hull.vertices.push_back(points[static_cast<size_t>(i)]);
    hull.input_index.push_back(i);
  }
  std::sort(polygons.begin(), polygons.end(),
            [](const Polygon& a, const Polygon& b) { return a.v < b.v; });
  std::set<Edge> edges;
  hull.face_starts.push_back(0);
  for (const Polygon& polygon : polygons) {
    for (const int32_t i : polygon.v) hull.face_vertices.push_back(number.at(i));
    hull.face_starts.push_back(static_cast<int32_t>(hull.face_vertices.size()));
    hull.face_normals.push_back(detail::to_float(polygon.normal));
  }
  for (const Triangle& t : triangles)
    for (int k = 0; k < 3; ++k) {
      const int32_t i = t.v[k], j = t.v[(k + 1) % 3];
      if (used.contains(i) && used.contains(j)) edges.insert({number[i], number[j]});
    }
  hull.neighbor_starts.push_back(0);
  for (auto edge = edges.begin(); edge != edges.end(); ++edge) {
    while (static_cast<int32_t>(hull.neighbor_starts.size()) <= edge->first)
      hull.neighbor_starts.push_back(static_cast<int32_t>(hull.neighbors.size()));
    hull.neighbors.push_back(edge->second);
  }
  hull.neighbor_starts.push_back(static_cast<int32_t>(hull.neighbors.size()));
  return hull;
}

void check_points(std::span<const Vec3f> points) {
  require(points.size() >= 4, ErrorKind::Value, "convex_hull: points: expected at least 4, got ",
          points.size());
  for (size_t i = 0; i < points.size(); ++i)
    require(std::isfinite(points[i].x) && std::isfinite(points[i].y) && std::isfinite(points[i].z),
            ErrorKind::Value, "convex_hull: points[", i, "]: expected finite numbers, got (",
            points[i].x, ", ", points[i].y, ", ", points[i].z, ")");
}

}  // namespace

std::vector<int32_t> hull_of_all(std::span<const Vec3f> points) {
  check_points(points);
  std::vector<int32_t> out;
  for (const Triangle& t : Quickhull(points, std::numeric_limits<int32_t>::max()).triangles)
    out.insert(out.end(), t.v.begin(), t.v.end());
  return out;
}

ConvexHull convex_hull(std::span<const Vec3f> points, int32_t max_vertices) {
  require(max_vertices >= 4 && max_vertices <= kMaxHullVertices, ErrorKind::Value,
          "convex_hull: max_vertices: expected 4 to ", kMaxHullVertices, ", got ", max_vertices);
  check_points(points);
  const Quickhull hull(points, max_vertices);
  return tables(points, hull.triangles, merge_coplanar(hull));
}

std::vector<int32_t> hull_triangles(const ConvexHull& hull) {
  std::vector<int32_t> out;
  auto corner = [&](int32_t k) { return hull.face_vertices[static_cast<size_t>(k)]; };
  for (size_t f = 0; f + 1 < hull.face_starts.size(); ++f)
    for (int32_t k = hull.face_starts[f] + 1; k + 1 < hull.face_starts[f + 1]; ++k)
      out.insert(out.end(), {corner(hull.face_starts[f]), corner(k), corner(k + 1)});
  return out;
}

}  // namespace novaphy
