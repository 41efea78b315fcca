// The fluid of the worlds of a builder, and the boxes of its bodies that the fluid acts on.
#include <algorithm>
#include <cmath>

#include "builder_checks.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/principal_axes.h"

namespace novaphy {
namespace {

using Axes = std::array<Vec3<double>, 3>;

// Returns a quaternion of the rotation matrix with the columns `a`. Its largest component is
// computed first.
Quatf quaternion_of(const Axes& a) {
  const double trace = a[0].x + a[1].y + a[2].z;
  const double squares[4] = {1.0 + 2.0 * a[0].x - trace, 1.0 + 2.0 * a[1].y - trace,
                             1.0 + 2.0 * a[2].z - trace, 1.0 + trace};
  const auto k = std::max_element(squares, squares + 4) - squares;
  const double twist[3] = {a[1].z - a[2].y, a[2].x - a[0].z, a[0].y - a[1].x};
  const double sums[3] = {a[2].y + a[1].z, a[0].z + a[2].x, a[1].x + a[0].y};
  const double rows[4][4] = {{squares[0], sums[2], sums[1], twist[0]},
                             {sums[2], squares[1], sums[0], twist[1]},
                             {sums[1], sums[0], squares[2], twist[2]},
                             {twist[0], twist[1], twist[2], squares[3]}};
  const double scale = 0.5 / std::sqrt(squares[k]);
  const auto at = [&](size_t i) { return static_cast<float>(rows[k][i] * scale); };
  return {at(0), at(1), at(2), at(3)};
}

// The box of uniform density with the mass and inertia of a body.
struct Box {
  Vec3f size{};
  Quatf frame = Quatf::identity();
};
Box equivalent_box(float mass, const Mat33f& inertia, const std::optional<Quatf>& frame) {
  Box box;
  if (!(mass > 0.0f)) return box;
  Mat33<double> m;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) m.m[i][j] = inertia.m[i][j];
  Axes axes = {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}};
  if (frame) {
    box.frame = *frame;
    const Quat<double> q{frame->x, frame->y, frame->z, frame->w};
    for (Vec3<double>& axis : axes) axis = math::rotate(q, axis);
  } else if (m.m[0][1] != 0.0 || m.m[0][2] != 0.0 || m.m[1][2] != 0.0) {
    const math::PrincipalAxes p = math::principal_axes(m);
    for (size_t k = 0; k < 3; ++k) axes[k] = {p.axes[0][k], p.axes[1][k], p.axes[2][k]};
    box.frame = quaternion_of(axes);
  }
  double moments[3];
  for (size_t k = 0; k < 3; ++k) moments[k] = math::dot(axes[k], math::multiply(m, axes[k]));
  const double sum = moments[0] + moments[1] + moments[2];
  const auto side = [&](int k) {
    return static_cast<float>(std::sqrt(std::max(6.0 * (sum - 2.0 * moments[k]) / mass, 0.0)));
  };
  box.size = {side(0), side(1), side(2)};
  return box;
}

}  // namespace

namespace detail {
void check_fluid(std::string_view function, const Fluid& fluid) {
  check_not_negative({function, "fluid.density"}, fluid.density);
  check_not_negative({function, "fluid.viscosity"}, fluid.viscosity);
  check_finite({function, "fluid.wind"}, fluid.wind);
}
}  // namespace detail

void ModelBuilder::upload_fluid(Model& m, const BodyMasses& masses) const {
  detail::check_fluid("finalize", fluid);
  std::vector<Vec3f> size;
  std::vector<Quatf> frame;
  for (size_t b = 0; b < bodies_.size(); ++b) {
    detail::check_world_setting({"finalize", "body_world", b}, bodies_[b].world, "fluid", fluid,
                                world_fluid_);
    const Box box = equivalent_box(masses.mass[b], masses.inertia[b], bodies_[b].fluid_frame);
    size.push_back(box.size);
    frame.push_back(box.frame);
  }
  m.body_fluid_box.copy_from_host(std::span<const Vec3f>(size));
  m.body_fluid_frame.copy_from_host(std::span<const Quatf>(frame));
  std::vector<float> density, viscosity;
  std::vector<Vec3f> wind;
  for (size_t w = 0; w < std::max<size_t>(world_fluid_.size(), 1); ++w) {
    const Fluid& of = world_fluid_.empty() ? fluid : world_fluid_[w];
    density.push_back(of.density);
    viscosity.push_back(of.viscosity);
    wind.push_back(of.wind);
  }
  m.fluid_density.copy_from_host(std::span<const float>(density));
  m.fluid_viscosity.copy_from_host(std::span<const float>(viscosity));
  m.fluid_wind.copy_from_host(std::span<const Vec3f>(wind));
}

}  // namespace novaphy
