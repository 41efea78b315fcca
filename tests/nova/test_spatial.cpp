// Spatial algebra and small factorizations against their definitions, in double precision. The
// float code and the traced Program give the same bits.
#include <array>
#include <cmath>

#include "novaphy/math/ldlt.h"
#include "novaphy/math/spatial.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using Motion = SpatialVector<double>;
using Inertia = SpatialInertia<double>;

class Draw {
 public:
  explicit Draw(uint32_t seed) : random_(seed) {}
  double number() { return static_cast<double>(random_.uniform(-2.0f, 2.0f)); }
  Vec3<double> vector() { return {number(), number(), number()}; }
  Motion motion() { return {vector(), vector()}; }
  Transform<double> frame() {
    Quat<double> q{number(), number(), number(), number()};
    const double l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {vector(), {q.x / l, q.y / l, q.z / l, q.w / l}};
  }

 private:
  Random random_;
};

std::array<double, 6> six(const Motion& m) {
  return {m.linear.x, m.linear.y, m.linear.z, m.angular.x, m.angular.y, m.angular.z};
}
void expect_near(const Motion& a, const Motion& b, double tolerance = 1e-12) {
  for (size_t k = 0; k < 6; ++k) EXPECT_NEAR(six(a)[k], six(b)[k], tolerance);
}
void expect_near(const Inertia& a, const Inertia& b) {
  const auto x = math::to_matrix(a), y = math::to_matrix(b);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) EXPECT_NEAR(x.m[i][j], y.m[i][j], 1e-11) << i << ", " << j;
}

struct Cloud {  // points with masses
  std::vector<double> mass;
  std::vector<Vec3<double>> at;

  explicit Cloud(Draw& draw) {
    for (int k = 0; k < 5; ++k) {
      mass.push_back(2.5 + draw.number());
      at.push_back(draw.vector());
    }
  }
  // Returns momentum and moment of momentum of points that move with `motion`, by definition.
  Motion momentum(const Motion& motion) const {
    Motion sum;
    for (size_t k = 0; k < mass.size(); ++k) {
      const Vec3<double> p = (motion.linear + math::cross(motion.angular, at[k])) * mass[k];
      sum = sum + Motion{p, math::cross(at[k], p)};
    }
    return sum;
  }
  Inertia inertia() const {
    double total = 0.0;
    Vec3<double> c{};
    for (size_t k = 0; k < mass.size(); ++k) {
      total += mass[k];
      c = c + at[k] * mass[k];
    }
    c = c / total;
    Mat33<double> about_com;
    for (size_t k = 0; k < mass.size(); ++k) {
      const Vec3<double> d = at[k] - c;
      const double r[3] = {d.x, d.y, d.z};
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          about_com.m[i][j] += mass[k] * ((i == j ? math::dot(d, d) : 0.0) - r[i] * r[j]);
    }
    return math::spatial_inertia(total, c, about_com);
  }
  Cloud seen_from(const Transform<double>& frame) const {  // points of the frame, outside
    Cloud moved = *this;
    for (Vec3<double>& x : moved.at) x = math::transform_point(frame, x);
    return moved;
  }
};

TEST(Spatial, AnInertiaGivesTheMomentumOfItsPoints) {
  Draw draw(1);
  for (int k = 0; k < 20; ++k) {
    const Cloud cloud(draw);
    const Motion m = draw.motion();
    const Inertia y = cloud.inertia();
    expect_near(math::apply(y, m), cloud.momentum(m), 1e-11);
    const auto matrix = math::to_matrix(y);
    for (size_t i = 0; i < 6; ++i) {
      double row = 0.0;
      for (size_t j = 0; j < 6; ++j) row += matrix.m[i][j] * six(m)[j];
      EXPECT_NEAR(row, six(math::apply(y, m))[i], 1e-11);
    }
  }
}

TEST(Spatial, InertiasMoveAndTurnWithTheirPoints) {
  Draw draw(2);
  for (int k = 0; k < 20; ++k) {
    const Cloud cloud(draw), other(draw);
    const Transform<double> x = draw.frame();
    expect_near(math::transform_inertia(x, cloud.inertia()), cloud.seen_from(x).inertia());
    const Vec3<double> r = draw.vector();
    expect_near(math::inertia_at(cloud.inertia(), r),
                cloud.seen_from({-r, {0, 0, 0, 1}}).inertia());
    Cloud both = cloud;
    both.mass.insert(both.mass.end(), other.mass.begin(), other.mass.end());
    both.at.insert(both.at.end(), other.at.begin(), other.at.end());
    expect_near(cloud.inertia() + other.inertia(), both.inertia());
  }
}

TEST(Spatial, FramesKeepPowerAndUndoThemselves) {
  Draw draw(3);
  for (int k = 0; k < 20; ++k) {
    const Transform<double> x = draw.frame(), y = draw.frame();
    const Motion m = draw.motion(), f = draw.motion();
    expect_near(math::inverse_transform_motion(x, math::transform_motion(x, m)), m);
    expect_near(math::inverse_transform_force(x, math::transform_force(x, f)), f);
    EXPECT_NEAR(math::dot(math::transform_motion(x, m), math::transform_force(x, f)),
                math::dot(m, f), 1e-11);
    EXPECT_NEAR(math::dot(math::transform_motion(x, m), f),
                math::dot(m, math::inverse_transform_force(x, f)), 1e-11);
    expect_near(math::transform_motion(math::multiply(x, y), m),
                math::transform_motion(x, math::transform_motion(y, m)), 1e-11);
    // Moved to a point and seen from a frame at that point are the same.
    const Transform<double> at{x.p, {0, 0, 0, 1}};
    expect_near(math::motion_at(m, x.p), math::inverse_transform_motion(at, m));
    expect_near(math::force_at(f, x.p), math::inverse_transform_force(at, f));
  }
}

TEST(Spatial, CrossProductsAreTheRateOfAMovingFrame) {
  Draw draw(4);
  const Motion m = draw.motion(), a = draw.motion(), f = draw.motion();
  EXPECT_NEAR(math::dot(math::cross_motion(m, a), f), -math::dot(a, math::cross_force(m, f)),
              1e-12);
  // A frame that moves with m for a short time h, to second order in h.
  const double h = 1e-5;
  const auto moved = [&](double t) {
    const Vec3<double> half = m.angular * (0.5 * t);
    const double l = std::sqrt(1.0 + math::dot(half, half));
    return Transform<double>{m.linear * t, {half.x / l, half.y / l, half.z / l, 1.0 / l}};
  };
  const auto rate = [&](auto transform, const Motion& of) {
    return (transform(moved(h), of) - transform(moved(-h), of)) * (0.5 / h);
  };
  expect_near(rate([](auto x, auto of) { return math::transform_motion(x, of); }, a),
              math::cross_motion(m, a), 1e-7);
  expect_near(rate([](auto x, auto of) { return math::transform_force(x, of); }, f),
              math::cross_force(m, f), 1e-7);
}

TEST(Spatial, TheBiasForceAboutTheCenterOfMassIsTheGyroscopicMoment) {
  const Mat33<double> i = {{{2.0, 0.1, -0.3}, {0.1, 3.0, 0.2}, {-0.3, 0.2, 4.0}}};
  const Inertia y = math::spatial_inertia(5.0, Vec3<double>{}, i);
  const Vec3<double> v{1.0, -2.0, 0.5}, w{0.3, 0.7, -1.1};
  const Motion f = math::bias_force(y, {v, w});
  expect_near(f, {math::cross(w, v * 5.0), math::cross(w, math::rotational(y, w))});
}

template <int N>
void expect_solution(Draw& draw, double scale) {
  double a[N][N] = {}, b[N] = {}, x[N], found[N];
  double root[N][N];
  for (auto& row : root)
    for (double& entry : row) entry = draw.number();
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j)
      for (int k = 0; k < N; ++k)
        a[i][j] += scale * (root[i][k] * root[j][k] + (i == j && k == 0 ? 0.5 : 0.0));
  for (int i = 0; i < N; ++i) x[i] = draw.number();
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) b[i] += a[i][j] * x[j];
  const auto f = math::ldlt(a);
  math::solve(f, b, found);
  for (int i = 0; i < N; ++i) {
    EXPECT_GT(f.d[i], 0.0);
    EXPECT_NEAR(found[i], x[i], 1e-10);
    for (int j = 0; j <= i; ++j) {  // L D L^T is A
      double product = 0.0;
      for (int k = 0; k <= j; ++k)
        product += (i == k ? 1.0 : f.l[i][k]) * f.d[k] * (j == k ? 1.0 : f.l[j][k]);
      EXPECT_NEAR(product, a[i][j], 1e-13 * scale * N * 16);
    }
  }
}

TEST(Ldlt, SolvesPositiveDefiniteSystemsOfEverySizeAndScale) {
  Draw draw(5);
  for (const double scale : {1e-6, 1.0, 1e6})
    for (int k = 0; k < 20; ++k) {
      expect_solution<3>(draw, scale);
      expect_solution<6>(draw, scale);
    }
}

TEST(Ldlt, TellsAMatrixThatIsNotPositiveDefinite) {
  const double indefinite[3][3] = {{1.0, 2.0, 0.0}, {2.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
  EXPECT_LT(math::ldlt(indefinite).d[1], 0.0);
  const double singular[3][3] = {{1.0, 1.0, 0.0}, {1.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
  EXPECT_EQ(math::ldlt(singular).d[1], 0.0);
}

TEST(Ldlt, ReadsTheLowerTriangleAndIsExactForTheIdentity) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double a[3][3] = {{1.0, nan, nan}, {0.0, 1.0, nan}, {0.0, 0.0, 1.0}},
               b[3] = {3.0, -2.0, 7.0};
  double x[3];
  math::solve(math::ldlt(a), b, x);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(x[i], b[i]);
}

// Every function, from 33 numbers.
constexpr int32_t kNumbers = 33;
template <class T>
std::vector<T> everything(const std::array<T, kNumbers>& u) {
  const auto v = [&](size_t k) { return Vec3<T>{u[k], u[k + 1], u[k + 2]}; };
  const SpatialVector<T> a{v(0), v(3)}, b{v(6), v(9)};
  const Transform<T> x{v(12), {u[15], u[16], u[17], u[18]}};
  const Mat33<T> i = {{{u[19], u[20], u[21]}, {u[20], u[22], u[23]}, {u[21], u[23], u[24]}}};
  const SpatialInertia<T> y = math::transform_inertia(x, math::spatial_inertia(u[25], v(26), i));
  std::vector<T> out;
  const auto add = [&](const SpatialVector<T>& s) {
    for (const Vec3<T>& part : {s.linear, s.angular})
      for (const T& value : {part.x, part.y, part.z}) out.push_back(value);
  };
  add(math::cross_motion(a, b));
  add(math::cross_force(a, b));
  add(math::transform_motion(x, a));
  add(math::transform_force(x, a));
  add(math::inverse_transform_motion(x, b));
  add(math::inverse_transform_force(x, b));
  add(math::motion_at(a, v(29)));
  add(math::force_at(a, v(29)));
  add(math::bias_force(math::inertia_at(y + y, v(29)), b));
  out.push_back(math::dot(a, b));
  const auto factored = math::ldlt(math::to_matrix(y).m);
  const T right[6] = {u[0], u[1], u[2], u[3], u[4], u[5]};
  T solution[6];
  math::solve(factored, right, solution);
  for (const T& value : solution) out.push_back(value);
  return out;
}

TEST(Spatial, FloatsAndTracedProgramsHaveTheSameBits) {
  const auto width = static_cast<int32_t>(everything(std::array<float, kNumbers>{}).size());
  const Kernel kernel = nova::make_kernel("spatial", {{"u", DType::F32, kNumbers, Access::Direct}},
                                          {{"out", width}}, [](TraceContext& c) {
                                            std::array<Real, kNumbers> u;
                                            for (int32_t k = 0; k < kNumbers; ++k)
                                              u[static_cast<size_t>(k)] = c.f32(0, k);
                                            return everything(u);
                                          });
  constexpr int64_t kRows = 200;
  Random random(6);
  std::vector<float> values = random.values(kRows * kNumbers);
  const float edges[] = {0.0f, -0.0f, 1e-40f, 1e30f, -1.0f, 1e-20f};
  for (size_t k = values.size() / 2; k < values.size(); ++k)
    if (random.chance(40)) values[k] = edges[random.below(6)];
  const std::vector<float> got = kernel(kRows, {tensor(values, {kRows, kNumbers})})[0].to_host();
  for (size_t row = 0; row < kRows; ++row) {
    std::array<float, kNumbers> u;
    std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(row * kNumbers), kNumbers, u.begin());
    std::vector<float> expected = everything(u);
    for (size_t k = 0; k < expected.size(); ++k)  // the sign of a NaN is nobody's
      if (std::isnan(expected[k]) && std::isnan(got[row * expected.size() + k]))
        expected[k] = got[row * expected.size() + k];
    EXPECT_TRUE(
        same_bits<float>(std::span(got).subspan(row * expected.size(), expected.size()), expected))
        << "row " << row;
  }
}

}  // namespace
}  // namespace novaphy::testing
