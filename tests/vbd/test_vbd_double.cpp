// The sweeps of VBD in double precision, from the same headers. With the colors of Newton's scenes
// and Newton's springs (not projected), their derivative is that of vbd_gradients.npz.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "newton_scene.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_contact_law.h"

namespace novaphy {
namespace {

using testing::NewtonVbdScene;
using testing::Npz;
using namespace vbd;

// A double with its derivative along one direction.
struct Dual {
  double v = 0.0, d = 0.0;
  Dual() = default;
  explicit Dual(double value, double slope = 0.0) : v(value), d(slope) {}
  friend Dual operator+(Dual a, Dual b) { return Dual(a.v + b.v, a.d + b.d); }
  friend Dual operator-(Dual a, Dual b) { return Dual(a.v - b.v, a.d - b.d); }
  friend Dual operator*(Dual a, Dual b) { return Dual(a.v * b.v, a.d * b.v + a.v * b.d); }
  friend Dual operator/(Dual a, Dual b) { return Dual(a.v / b.v, (a.d - a.v / b.v * b.d) / b.v); }
  friend Dual operator-(Dual a) { return Dual(-a.v, -a.d); }
  friend bool operator<(Dual a, Dual b) { return a.v < b.v; }
  friend bool operator>(Dual a, Dual b) { return a.v > b.v; }
  friend bool operator>=(Dual a, Dual b) { return a.v >= b.v; }
  friend Dual select(bool c, Dual a, Dual b) { return c ? a : b; }
  friend Dual min(Dual a, Dual b) { return a.v <= b.v ? a : b; }
  friend Dual max(Dual a, Dual b) { return a.v >= b.v ? a : b; }
  friend Dual sqrt(Dual a) {
    const double root = std::sqrt(a.v);
    return Dual(root, root > 0.0 ? a.d / (2.0 * root) : 0.0);
  }
  friend Dual atan2(Dual y, Dual x) {
    const double square = x.v * x.v + y.v * y.v;
    return Dual(std::atan2(y.v, x.v), square > 0.0 ? (y.d * x.v - x.d * y.v) / square : 0.0);
  }
};
using Point = Vec3<Dual>;

Point point(const Vec3f& value, const Vec3f& slope = {}) {
  return {Dual(static_cast<double>(value.x), static_cast<double>(slope.x)),
          Dual(static_cast<double>(value.y), static_cast<double>(slope.y)),
          Dual(static_cast<double>(value.z), static_cast<double>(slope.z))};
}
Dual real(float value) { return Dual(static_cast<double>(value)); }

class DoubleStep {
 public:
  DoubleStep(const NewtonVbdScene& of, size_t t)
      : scene(of), m(*of.model), h(of.file["dt_f64"].scalar<double>()), touching(of.contacts(t)) {}

  // A step from positions and velocities to positions and velocities.
  void run(std::vector<Point>& q, std::vector<Point>& qd, int iterations) {
    start = q;
    target = q;
    for (size_t p = 0; p < q.size(); ++p)
      if (!is_kinematic(p))
        target[p] = q[p] + (qd[p] + point(m.gravity.data()[0]) * Dual(h)) * Dual(h);
    x = target;
    for (int k = 0; k < iterations; ++k)
      for (const std::vector<int32_t>& group : scene.groups()) {
        const std::vector<Point> before = x;
        std::vector<Point> after = x;
        for (const int32_t i : group) {
          const auto p = static_cast<size_t>(i);
          if (is_kinematic(p)) continue;
          const Block<Dual> block = block_at(p);
          after[p] = x[p] + solve_block(factorize(block, Dual(1e-6)), block.f);
        }
        x = after;
      }
    for (size_t p = 0; p < q.size(); ++p) qd[p] = (x[p] - start[p]) / Dual(h);
    q = x;
  }
  bool is_kinematic(size_t p) const { return !(m.particle_inv_mass.data()[p] > 0.0f); }

 private:
  // Adds the block of an element for one corner; `others`: in the order of its slot.
  template <Role role, class Numbers>
  void add(Block<Dual>& block, size_t p, const int32_t (&others)[kOthers[role]],
           const Numbers& numbers) const {
    SlotInputs<role, Dual> in, before;
    in.own = x[p];
    before.own = start[p];
    for (int k = 0; k < kOthers[role]; ++k) {
      in.others[k] = x[static_cast<size_t>(others[k])];
      before.others[k] = start[static_cast<size_t>(others[k])];
    }
    for (size_t k = 0; k < numbers.size(); ++k) in.numbers[k] = before.numbers[k] = numbers[k];
    SlotOf<role>::put_start(
        before, [&](int k, const Dual& value) { in.numbers[start_begin(role) + k] = value; });
    if constexpr (role == kSpring) {
      block = block + Spring::block<Block, false>(in, true);
    } else {
      block = block + block_of(in, true);
    }
  }

  void add_springs(Block<Dual>& block, size_t p) const {
    const auto* const ends = static_cast<const int32_t*>(m.particle_spring_indices.raw());
    for (size_t e = 0; e < m.particle_spring_indices.rows(); ++e)
      for (size_t c = 0; c < 2; ++c)
        if (ends[2 * e + c] == static_cast<int32_t>(p))
          add<kSpring>(block, p, {ends[2 * e + 1 - c]},
                       std::vector{real(m.particle_spring_stiffness.data()[e]),
                                   real(m.particle_spring_damping.data()[e]) / Dual(h),
                                   real(m.particle_spring_rest_length.data()[e])});
  }
  void add_triangles(Block<Dual>& block, size_t p) const {
    const auto* const corner = static_cast<const int32_t*>(m.particle_tri_indices.raw());
    for (size_t e = 0; e < m.particle_tri_indices.rows(); ++e)
      for (size_t c = 0; c < 3; ++c) {
        const float* const law = m.particle_tri_material.data() + 5 * e;
        if (corner[3 * e + c] != static_cast<int32_t>(p) ||
            (law[0] == 0.0f && law[1] == 0.0f && law[2] == 0.0f))
          continue;
        const Mat22f& pose = m.particle_tri_pose.data()[e];
        std::vector<Dual> numbers;
        for (size_t k = 1; k < 3; ++k)
          for (int column = 0; column < 2; ++column) {
            const size_t of = (c + k) % 3;
            numbers.push_back(of == 0 ? -(real(pose.m[0][column]) + real(pose.m[1][column]))
                                      : real(pose.m[of - 1][column]));
          }
        put_neo_hookean(0, real(m.particle_tri_area.data()[e]), real(law[0]), real(law[1]), Dual(),
                        real(law[2]) / Dual(h),
                        [&](int, const Dual& number) { numbers.push_back(number); });
        add<kTriangle>(block, p, {corner[3 * e + (c + 1) % 3], corner[3 * e + (c + 2) % 3]},
                       numbers);
      }
  }
  void add_hinges(Block<Dual>& block, size_t p) const {
    const auto* const corner = static_cast<const int32_t*>(m.particle_edge_indices.raw());
    for (size_t e = 0; e < m.particle_edge_indices.rows(); ++e)
      for (size_t c = 0; c < 4; ++c) {
        const int32_t* const of = corner + 4 * e;
        const float* const law = m.particle_edge_material.data() + 2 * e;
        if (of[c] != static_cast<int32_t>(p) || of[0] < 0 || of[1] < 0 ||
            (law[0] == 0.0f && law[1] == 0.0f))
          continue;
        const Dual length = real(m.particle_edge_rest_length.data()[e]);
        const std::vector numbers = {real(law[0]) * length, real(law[1]) / Dual(h) * length,
                                     real(m.particle_edge_rest_angle.data()[e])};
        const size_t turned = c % 2;  // odd corners read the hinge from its other side
        const int32_t seen[4] = {of[turned], of[1 ^ turned], of[2 ^ turned], of[3 ^ turned]};
        if (c < 2) {
          add<kHingeOpposite>(block, p, {seen[1], seen[2], seen[3]}, numbers);
        } else {
          add<kHingeEnd>(block, p, {seen[0], seen[1], seen[3]}, numbers);
        }
      }
  }
  void add_tetrahedra(Block<Dual>& block, size_t p) const {
    const auto* const corner = static_cast<const int32_t*>(m.particle_tet_indices.raw());
    for (size_t e = 0; e < m.particle_tet_indices.rows(); ++e)
      for (size_t c = 0; c < 4; ++c) {
        if (corner[4 * e + c] != static_cast<int32_t>(p)) continue;
        const Mat33f& pose = m.particle_tet_pose.data()[e];
        const float* const law = m.particle_tet_material.data() + 3 * e;
        Dual rest[3][3];
        for (int r = 0; r < 3; ++r)
          for (int column = 0; column < 3; ++column) rest[r][column] = real(pose.m[r][column]);
        std::vector<Dual> numbers;
        for (size_t k = 1; k < 4; ++k)
          for (int column = 0; column < 3; ++column) {
            const size_t of = (c + k) % 4;
            numbers.push_back(of == 0 ? -(rest[0][column] + rest[1][column] + rest[2][column])
                                      : rest[of - 1][column]);
          }
        const Point rows[3] = {{rest[0][0], rest[0][1], rest[0][2]},
                               {rest[1][0], rest[1][1], rest[1][2]},
                               {rest[2][0], rest[2][1], rest[2][2]}};
        const Dual volume =
            Dual(1.0) / (math::dot(rows[0], math::cross(rows[1], rows[2])) * Dual(6.0));
        put_neo_hookean(0, volume, real(law[0]), real(law[1]), Dual(), real(law[2]) / Dual(h),
                        [&](int, const Dual& number) { numbers.push_back(number); });
        add<kTetrahedron>(
            block, p,
            {corner[4 * e + (c + 1) % 4], corner[4 * e + (c + 2) % 4], corner[4 * e + (c + 3) % 4]},
            numbers);
      }
  }
  void add_contacts(Block<Dual>& block, size_t p) const {
    for (int32_t k = 0; k < *touching.soft_contact_count.data(); ++k) {
      if (touching.soft_contact_particle.data()[k] != static_cast<int32_t>(p)) continue;
      const auto s = static_cast<size_t>(touching.soft_contact_shape.data()[k]);
      const auto mean = [](float a, float b) { return (real(a) + real(b)) * Dual(0.5); };
      const ParticleContact<Dual> contact = {
          point(touching.soft_contact_body_pos.data()[k]),
          point(touching.soft_contact_normal.data()[k]),
          {},
          real(m.particle_radius.data()[p]) + real(m.shape_margin.data()[s]),
          mean(m.soft_contact_ke, m.shape_material_ke.data()[s]),
          mean(m.soft_contact_kd, m.shape_material_kd.data()[s]) / Dual(h),
          sqrt(real(m.soft_contact_mu) * real(m.shape_material_mu.data()[s])),
          Dual(1e-2 * h)};
      block = block + particle_contact_block(x[p], start[p], contact);
    }
  }
  Block<Dual> block_at(size_t p) const {
    Block<Dual> block =
        inertia_block(x[p], target[p], real(m.particle_mass.data()[p]) / Dual(h * h));
    add_springs(block, p);
    add_triangles(block, p);
    add_hinges(block, p);
    add_tetrahedra(block, p);
    add_contacts(block, p);
    return block;
  }

  const NewtonVbdScene& scene;
  const Model& m;
  const double h;
  const Contacts touching;
  std::vector<Point> start, target, x;
};

class VbdInDouble : public ::testing::TestWithParam<const char*> {};

TEST_P(VbdInDouble, TheDerivativeOfTenSweepsIsThatOfTheFile) {
  const std::string name = GetParam();
  const NewtonVbdScene scene(("newton_vbd_" + name + ".npz").c_str());
  const Npz file = testing::golden("vbd_gradients.npz");
  const auto t = static_cast<size_t>(file[name + "_t"].scalar<int32_t>());
  const size_t n = scene.particles();
  const auto from_q = scene.q(t), from_qd = scene.file["qd_60"].as<Vec3f>();
  const auto w_q = file[name + "_w_q"].as<Vec3f>(), w_qd = file[name + "_w_qd"].as<Vec3f>();
  const auto out = file[name + "_K10_out_q"].as<double>();
  const auto grad_q = file[name + "_K10_grad_q"].as<double>(),
             grad_qd = file[name + "_K10_grad_qd"].as<double>();
  std::mt19937 random_engine(5);
  std::normal_distribution<float> normal;
  for (int trial = 0; trial < 3; ++trial) {
    DoubleStep step(scene, t);
    std::vector<Point> q, qd;
    double expected = 0.0;
    for (size_t p = 0; p < n; ++p) {
      Vec3f slopes[2];
      for (int k = 0; k < 2; ++k)
        if (trial != 1 - k)  // by positions, by velocities, by both
          slopes[k] = {normal(random_engine), normal(random_engine), normal(random_engine)};
      for (size_t c = 0; c < 3; ++c)
        expected += grad_q[3 * p + c] * static_cast<double>((&slopes[0].x)[c]) +
                    grad_qd[3 * p + c] * static_cast<double>((&slopes[1].x)[c]);
      q.push_back(point(from_q[p], slopes[0]));
      qd.push_back(point(from_qd[p], slopes[1]));
    }
    const std::vector<Point> starts = q, start_velocities = qd;
    step.run(q, qd, 10);
    double found = 0.0, off = 0.0;
    for (size_t p = 0; p < n; ++p) {
      const Dual* const x = &q[p].x;
      const Dual* const v = &qd[p].x;
      for (size_t c = 0; c < 3; ++c) {
        off = std::max(off, std::abs(x[c].v - out[3 * p + c]));
        found += static_cast<double>((&w_q[p].x)[c]) * x[c].d +
                 static_cast<double>((&w_qd[p].x)[c]) * v[c].d;
      }
    }
    EXPECT_LT(off, 1e-9) << trial;
    EXPECT_NEAR(found, expected, 1e-8 * std::abs(expected)) << trial;
    // The derivative is also that of differences of the sweeps. Wider differences cross more
    // branches. Positions are moved by velocities times the step.
    const double width = trial == 1 ? 1e-7 : 5e-9;
    double losses[2] = {};
    for (int side = 0; side < 2; ++side) {
      std::vector<Point> a = starts, b = start_velocities;
      const auto move = [&](Point& to) {
        for (Dual* c : {&to.x, &to.y, &to.z})
          *c = Dual(c->v + (side == 0 ? 1.0 : -1.0) * width * c->d);
      };
      for (size_t p = 0; p < n; ++p) {
        move(a[p]);
        move(b[p]);
      }
      step.run(a, b, 10);
      for (size_t p = 0; p < n; ++p)
        for (size_t c = 0; c < 3; ++c)
          losses[side] += static_cast<double>((&w_q[p].x)[c]) * (&a[p].x)[c].v +
                          static_cast<double>((&w_qd[p].x)[c]) * (&b[p].x)[c].v;
    }
    const double difference = (losses[0] - losses[1]) / (2.0 * width);
    EXPECT_NEAR(found, difference, 1e-6 * std::abs(difference)) << trial;
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, VbdInDouble, ::testing::Values("soft", "cloth"));

}  // namespace
}  // namespace novaphy
