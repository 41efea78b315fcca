// The bounds that keep surfaces from crossing (self_contact.h): reaches, planes, and the moves of
// particles up to these bounds.
#include <algorithm>
#include <cmath>
#include <limits>

#include "self_contact.h"

namespace novaphy::vbd {
namespace {

// If a particle would pass a plane, it moves by this part of its distance to the plane.
constexpr double kShare = 0.85;
constexpr double kLeastShare = 0.05;        // of a gap: least room of each side
constexpr char kByPlane = 1, kByReach = 2;  // the bound that stopped a particle

}  // namespace

// Sets the reach of each particle of a world, and the region (box) in which it may move.
void SelfContact::set_reach(int32_t world) {
  const Vec3f around = Vec3f{gap_, gap_, gap_} * 0.5f;
  for (const int32_t p : vertices_) {
    const size_t i = index(p);
    if (world_[i] != world) continue;
    reach_[i] = narrow(length_of(wide(wish_[i]) - wide(origin_[i]))) * 1.0001f + 0.5f * gap_;
    const Vec4f &a = origin_[i], &b = wish_[i];
    regions_[i] = {Vec3f{std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)} - around,
                   Vec3f{std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)} + around};
  }
}

// The pairs of a world have the same order in each search. Worlds without is_new[world] have the
// same pairs as before, and keep their planes.
void SelfContact::detect(std::span<const char> is_new) {
  std::vector<std::vector<Plane>> kept(index(worlds_));
  std::vector<size_t> used(index(worlds_), 0);
  for (size_t k = 0; k < pairs_.size(); ++k)
    if (const size_t w = world_of(pairs_[k]); is_new[w] == 0) kept[w].push_back(planes_[k]);
  pairs_ = surface_->find(origin_, reach_, regions_);
  planes_.resize(pairs_.size());
  corners_.clear();
  for (size_t k = 0; k < pairs_.size(); ++k) {
    const size_t w = world_of(pairs_[k]);
    planes_[k] = is_new[w] == 0 ? kept[w][used[w]++] : plane_between(pairs_[k]);
    corners_.insert(corners_.end(), pairs_[k].particle.begin(), pairs_[k].particle.end());
  }
  pairs_of_.build(corners_, model_.particle_count());
  planes_of_.resize(corners_.size());
  for (const int32_t p : vertices_) set_planes(p);
}

// Sets the planes of a particle. Also sets the distance that the particle may move from its
// reference before its planes need a check.
void SelfContact::set_planes(int32_t p) {
  double least = std::numeric_limits<float>::max();
  const Vec3d x = wide(reference_[index(p)]);
  Plane* to = planes_of_.data() + pairs_of_.begins()[index(p)];
  for (const int32_t item : pairs_of_.items(p)) {
    const size_t k = index(item / 4);
    const double side = pairs_[k].is_first(item % 4) ? 1.0 : -1.0;
    *to = {planes_[k].normal * side, planes_[k].offset * side + slack_[index(world_[index(p)])]};
    least = std::min(least, (to++)->height(x));
  }
  safe_[index(p)] = narrow(std::max(least, 0.0)) * 0.9999f;
}

SelfContact::Plane SelfContact::plane_between(const SurfacePair& pair) const {
  Vec3d x[4], wish[4];
  for (size_t k = 0; k < 4; ++k) {
    x[k] = wide(reference_[index(pair.particle[k])]);
    wish[k] = wide(wish_[index(pair.particle[k])]) - x[k];
  }
  const auto nearest =
      pair.has_edges ? geometry::nearest_of_edges(x) : geometry::nearest_to_triangle(x);
  // Heights relative to a corner of the second feature. Heights relative to the origin would round.
  double best = -std::numeric_limits<double>::infinity(), top = 0.0;
  Vec3d normal{};
  const auto try_normal = [&](Vec3d n) {
    const double size = length_of(n);
    if (!(size > 0.0)) return;
    n = n * (1.0 / size);
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (int k = 0; k < 4; ++k) {
      const double h = math::dot(n, x[k] - x[3]);
      if (pair.is_first(k)) {
        low = std::min(low, h);
      } else {
        high = std::max(high, h);
      }
    }
    if (!(low - high > best)) return;
    best = low - high;
    top = high;
    normal = n;
  };
  try_normal(nearest.apart);
  if (!(best > 0.99 * nearest.distance)) {
    const Vec3d n = pair.has_edges ? math::cross(x[1] - x[0], x[3] - x[2])
                                   : math::cross(x[2] - x[1], x[3] - x[1]);
    try_normal(n);
    try_normal(n * -1.0);
  }
  double first = 0.0, second = 0.0;  // how far each feature approaches the other
  for (int k = 0; k < 4; ++k) {
    const double up = math::dot(normal, wish[k]);
    (pair.is_first(k) ? first : second) =
        std::max(pair.is_first(k) ? first : second, pair.is_first(k) ? -up : up);
  }
  const double both = first + second;
  const double share = both > 0.0 ? std::clamp(second / both, kLeastShare, 1.0 - kLeastShare) : 0.5;
  return {normal, math::dot(normal, x[3]) + (top + best * share)};
}

void SelfContact::hold_particle(int32_t p) {
  const size_t i = index(p);
  if (!surface_->is_vertex(p)) return;
  const Vec3d from = wide(reference_[i]), to = wide(rows_.x[i]), d = to - from;
  const double squared = math::dot(d, d), reach = wide(reach_[i]), safe = wide(safe_[i]);
  // The reference lies within the reach of the origin. Solve |from + t d - origin| = reach for t.
  const Vec3d off = from - wide(origin_[i]), end = off + d;
  double t = 1.0;
  if (math::dot(end, end) > reach * reach) {
    const double along = math::dot(off, d), room = reach * reach - math::dot(off, off);
    const double root = std::sqrt(along * along + squared * std::max(room, 0.0));
    t = 0.9999 * std::max(root - along, 0.0) / squared;
  }
  const geometry::Box3& region = regions_[i];
  const auto stay = [&t](double from_c, double d_c, float lo, float hi) {
    if (d_c == 0.0) return;
    const double part = ((d_c < 0.0 ? wide(lo) : wide(hi)) - from_c) / d_c;
    if (part < 1.0) t = std::min(t, 0.9999 * std::max(part, 0.0));
  };
  stay(from.x, d.x, region.lo.x, region.hi.x);
  stay(from.y, d.y, region.lo.y, region.hi.y);
  stay(from.z, d.z, region.lo.z, region.hi.z);
  const bool is_far = t < 1.0;
  if (squared > safe * safe)
    for (int32_t k = pairs_of_.begins()[i]; k < pairs_of_.begins()[i + 1]; ++k) {
      const Plane& plane = planes_of_[index(k)];
      const double after = plane.height(to);
      if (after >= 0.0) continue;
      const double before = plane.height(from);
      if (after < before) join(pairs_[index(pairs_of_.all()[index(k)] / 4)]);
      if (before >= 0.0) {
        t = std::min(t, kShare * before / (before - after));
      } else if (after < before) {
        t = 0.0;
      }
    }
  if (!(t < 1.0)) {
    is_cut_[i] = 0;
    return;
  }
  is_cut_[i] = is_far ? kByReach : kByPlane;
  wish_[i] = rows_.x[i];
  Vec4f x = narrow_row(from + d * t);
  // Rounding must not bring a particle nearer to a plane that has no room left.
  for (int32_t k = pairs_of_.begins()[i]; t > 0.0 && k < pairs_of_.begins()[i + 1]; ++k) {
    const Plane& plane = planes_of_[index(k)];
    if (plane.height(wide(x)) >= std::min(plane.height(from), 0.0)) continue;
    x = reference_[i];
    break;
  }
  const Vec4f& start = rows_.start[i];
  rows_.x[i] = x;
  if (!slots_.is_kinematic(p)) rows_.moved[i] = {x.x - start.x, x.y - start.y, x.z - start.z, 0.0f};
}

void SelfContact::hold(int64_t first_group, int64_t end_group) {
  for_particles(first_group, end_group, [&](int32_t p) { hold_particle(p); });
}

void SelfContact::detect_again() {
  std::vector<char> is_due(index(worlds_), 0);
  bool any = false;
  for (const int32_t p : vertices_) {
    const size_t w = index(world_[index(p)]);
    if (is_cut_[index(p)] != kByReach || detections_[w] >= kDetections) continue;
    is_due[w] = 1;
    any = true;
  }
  if (any) {
    for (const int32_t p : vertices_) {
      const size_t i = index(p);
      if (is_due[index(world_[i])] == 0) continue;
      origin_[i] = reference_[i] = rows_.x[i];
      if (is_cut_[i] == 0) wish_[i] = rows_.x[i];
    }
    for (int32_t w = 0; w < worlds_; ++w) {
      if (is_due[index(w)] == 0) continue;
      ++detections_[index(w)];
      set_reach(w);
    }
    detect(is_due);
  }
  place_again(is_due);
  for (const int32_t p : vertices_) {
    const size_t i = index(p);
    const bool is_back = is_cut_[i] != 0 && slots_.is_kinematic(p);
    is_cut_[i] = 0;
    if (!is_back) continue;
    rows_.x[i] = wish_[i];
    hold_particle(p);
  }
}

// Computes new planes at the current positions for the pairs of particles that a plane stopped.
// Worlds with is_new[world] already have new planes.
void SelfContact::place_again(std::span<const char> is_new) {
  std::vector<size_t> due;
  std::vector<int32_t> moved;
  for (const int32_t p : vertices_) {
    if (is_cut_[index(p)] == 0 || is_new[index(world_[index(p)])] != 0) continue;
    for (const int32_t item : pairs_of_.items(p)) {
      due.push_back(index(item / 4));
      for (const int32_t q : pairs_[due.back()].particle) {
        reference_[index(q)] = rows_.x[index(q)];
        if (is_cut_[index(q)] == 0) wish_[index(q)] = rows_.x[index(q)];
        moved.push_back(q);
      }
    }
  }
  std::sort(due.begin(), due.end());
  due.erase(std::unique(due.begin(), due.end()), due.end());
  for (const size_t k : due) planes_[k] = plane_between(pairs_[k]);
  std::sort(moved.begin(), moved.end());
  moved.erase(std::unique(moved.begin(), moved.end()), moved.end());
  for (const int32_t p : moved) set_planes(p);
}

}  // namespace novaphy::vbd
