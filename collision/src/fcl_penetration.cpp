#include "fcl_penetration.h"

#include <ccd/ccd.h>
#include <fcl/geometry/shape/convex.h>
#include <fcl/narrowphase/detail/gjk_solver_libccd.h>

#include <vector>

namespace novaphy::detail {

static_assert(sizeof(ccd_real_t) == sizeof(double), "libccd must be built with CCD_DOUBLE");

bool has_fcl() { return true; }

struct FclHull::Impl {
  fcl::Convexd convex;
};

namespace {

fcl::Convexd make_convex(const geometry::HullView& hull) {
  auto vertices = std::make_shared<std::vector<fcl::Vector3d>>();
  for (int32_t i = 0; i < hull.vertex_count; ++i)
    vertices->emplace_back(hull.vertices[i].x, hull.vertices[i].y, hull.vertices[i].z);
  auto faces = std::make_shared<std::vector<int>>();
  for (int32_t f = 0; f < hull.face_count; ++f) {
    faces->push_back(hull.face_starts[f + 1] - hull.face_starts[f]);
    faces->insert(faces->end(), hull.face_vertices + hull.face_starts[f],
                  hull.face_vertices + hull.face_starts[f + 1]);
  }
  return fcl::Convexd(vertices, hull.face_count, faces);
}

}  // namespace

FclHull::FclHull(const geometry::HullView& hull)
    : impl_(std::make_unique<const Impl>(Impl{make_convex(hull)})) {}
FclHull::~FclHull() = default;
FclHull::FclHull(FclHull&&) noexcept = default;

std::optional<FclHull::Penetration> FclHull::penetration(const FclHull& other,
                                                         const Transformf& pose) const try {
  const fcl::detail::GJKSolver_libccd<double> solver;
  fcl::Transform3d at = fcl::Transform3d::Identity();
  at.linear() = fcl::Quaterniond(pose.q.w, pose.q.x, pose.q.y, pose.q.z).normalized().matrix();
  at.translation() = fcl::Vector3d(pose.p.x, pose.p.y, pose.p.z);
  std::vector<fcl::ContactPoint<double>> contacts;
  if (!solver.shapeIntersect(impl_->convex, fcl::Transform3d::Identity(), other.impl_->convex, at,
                             &contacts) ||
      contacts.empty())
    return std::nullopt;
  const fcl::Vector3d& n = contacts[0].normal;
  return Penetration{
      {static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z())},
      contacts[0].penetration_depth};
} catch (...) {
  return std::nullopt;
}

}  // namespace novaphy::detail
