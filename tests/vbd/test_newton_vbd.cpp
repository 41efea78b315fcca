// SolverVBD against Newton 1.8.0's (cpu), with Newton's colors: forces and Hessians of single
// elements, the iterates of a substep, and substeps that start from Newton's state.
#include <gtest/gtest.h>

#include "newton_scene.h"
#include "novaphy/math/matrix.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "slots.h"

namespace novaphy {
namespace {

using testing::largest_distance;
using testing::NewtonVbdScene;
using testing::Npz;
using vbd::Block;

// Relative to the largest entry of the element's forces or Hessians. The forces of an edge that is
// bent by less than a degree are a small difference of angles.
constexpr float kTolerance = 1e-5f, kEdgeTolerance = 2e-5f;

// Compares the blocks of an element's corners with Newton's.
class Units {
 public:
  Units(const Npz& file, const char* kind, size_t corners)
      : f_(file["unit_" + std::string(kind) + "_f"].as<Vec3f>()),
        h_(file["unit_" + std::string(kind) + "_h"].as<Mat33f>()),
        corners_(corners) {}
  size_t count() const { return f_.size() / corners_; }
  // Largest difference relative to the largest entry, of forces and of Hessians.
  void compare(size_t element, const std::vector<Block<float>>& blocks,
               float tolerance = kTolerance) {
    ++compared;
    float f_size = 0.0f, h_size = 0.0f, f_error = 0.0f, h_error = 0.0f;
    for (size_t c = 0; c < corners_; ++c) {
      const Vec3f& f = f_[element * corners_ + c];
      const Mat33f& h = h_[element * corners_ + c];
      const Block<float>& b = blocks[c];
      const float own[3][3] = {{b.h00, b.h01, b.h02}, {b.h01, b.h11, b.h12}, {b.h02, b.h12, b.h22}};
      f_size = std::max(f_size, math::length(f));
      f_error = std::max(f_error, math::length(f - b.f));
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          h_size = std::max(h_size, std::abs(h.m[i][j]));
          h_error = std::max(h_error, std::abs(h.m[i][j] - own[i][j]));
        }
    }
    EXPECT_LE(f_error, tolerance * f_size) << "force of element " << element;
    EXPECT_LE(h_error, tolerance * h_size) << "Hessian of element " << element;
  }

  size_t compared = 0;

 private:
  std::span<const Vec3f> f_;
  std::span<const Mat33f> h_;
  size_t corners_;
};

TEST(NewtonVbdUnits, TrianglesAreNewtons) {
  const Npz file = testing::golden("newton_vbd_cloth.npz");
  const auto x = file["unit_tri_x"].as<Vec3f>(), xn = file["unit_tri_xprev"].as<Vec3f>();
  const auto pose = file["unit_tri_pose"].as<Mat22f>();
  const auto area = file["unit_tri_area"].as<float>();
  const auto material = file["unit_tri_mat"].as<Vec3f>();
  const float dt = file["unit_dt"].scalar<float>();
  Units units(file, "tri", 3);
  for (size_t e = 0; e < units.count(); ++e) {
    const auto& d = pose[e].m;
    const std::span<const Vec3f> at(&x[3 * e], 3), before(&xn[3 * e], 3);
    const auto slot = [&](int c) {
      return testing::slot_of<vbd::kTriangle, float>(
          c, at, before,
          {d[0][0], d[0][1], d[1][0], d[1][1], area[e], material[e].x, material[e].y, material[e].z,
           0.0f},
          dt);
    };
    // A degenerate triangle without area has no normal.
    const auto f = vbd::Triangle::columns(slot(0));
    const auto strain = vbd::Triangle::strain(f);
    if (vbd::Triangle::area_ratio(math::cross(f.f0, f.f1)) < 1e-3f * (strain.c00 + strain.c11))
      continue;
    std::vector<Block<float>> blocks;
    for (int c = 0; c < 3; ++c) blocks.push_back(vbd::block_of(slot(c), true));
    units.compare(e, blocks);
  }
  EXPECT_EQ(units.compared, units.count() - 4);
}

TEST(NewtonVbdUnits, BendingEdgesAreNewtons) {
  const Npz file = testing::golden("newton_vbd_cloth.npz");
  const auto x = file["unit_edge_x"].as<Vec3f>(), xn = file["unit_edge_xprev"].as<Vec3f>();
  const auto index = file["unit_edge_idx"].as<Vec4i>();
  const auto rest = file["unit_edge_ang"].as<float>(), length = file["unit_edge_len"].as<float>();
  const auto material = file["unit_edge_mat"].as<Vec2f>();
  const float dt = file["unit_dt"].scalar<float>();
  Units units(file, "edge", 4);
  for (size_t e = 0; e < units.count(); ++e) {
    const int32_t id[4] = {index[e].x, index[e].y, index[e].z, index[e].w};
    if (id[0] < 0 || id[1] < 0) continue;
    Vec3f at[4], before[4];
    for (size_t c = 0; c < 4; ++c) {
      at[c] = x[static_cast<size_t>(id[c])];
      before[c] = xn[static_cast<size_t>(id[c])];
    }
    const auto block = [&](auto is, int c) {
      return vbd::block_of(
          testing::slot_of<decltype(is)::role, float>(
              c, at, before, {material[e].x, material[e].y, rest[e], length[e]}, dt),
          true);
    };
    std::vector<Block<float>> blocks;
    for (int c = 0; c < 4; ++c)
      blocks.push_back(c < 2 ? block(vbd::RoleIs<vbd::kHingeOpposite>(), c)
                             : block(vbd::RoleIs<vbd::kHingeEnd>(), c));
    units.compare(e, blocks, kEdgeTolerance);
  }
  EXPECT_GT(units.compared, 50u);
}

TEST(NewtonVbdUnits, TetrahedraAreNewtons) {
  const Npz file = testing::golden("newton_vbd_soft.npz");
  const auto x = file["unit_tet_x"].as<Vec3f>(), xn = file["unit_tet_xprev"].as<Vec3f>();
  const auto pose = file["unit_tet_pose"].as<Mat33f>();
  const auto material = file["unit_tet_mat"].as<Vec3f>();
  const float dt = file["unit_dt"].scalar<float>();
  Units units(file, "tet", 4);
  for (size_t e = 0; e < units.count(); ++e) {
    Vec3f rows[4];
    for (int c = 1; c < 4; ++c) rows[c] = math::row(pose[e], c - 1);
    rows[0] = -((rows[1] + rows[2]) + rows[3]);
    // A sliver that is hundreds of times longer than wide at rest loses the digits.
    float size = 0.0f;
    for (int c = 1; c < 4; ++c) size = std::max(size, math::length(rows[c]));
    if (size > 100.0f * std::cbrt(math::determinant(pose[e]))) continue;
    std::vector<Block<float>> blocks;
    const auto& d = pose[e].m;
    const std::span<const Vec3f> at(&x[4 * e], 4), before(&xn[4 * e], 4);
    for (int c = 0; c < 4; ++c)
      blocks.push_back(
          vbd::block_of(testing::slot_of<vbd::kTetrahedron, float>(
                            c, at, before,
                            {d[0][0], d[0][1], d[0][2], d[1][0], d[1][1], d[1][2], d[2][0], d[2][1],
                             d[2][2], material[e].x, material[e].y, material[e].z, 0.0f},
                            dt),
                        true));
    units.compare(e, blocks);
  }
  EXPECT_EQ(units.compared, units.count() - 1);
}

// Newton's Hessian has no projection. With the projection only springs under tension agree.
TEST(NewtonVbdUnits, SpringsAreNewtons) {
  const Npz file = testing::golden("newton_vbd_soft.npz");
  const auto x = file["unit_spring_x"].as<Vec3f>(), xn = file["unit_spring_xprev"].as<Vec3f>();
  const auto rest = file["unit_spring_rest"].as<float>(), ke = file["unit_spring_ke"].as<float>(),
             kd = file["unit_spring_kd"].as<float>();
  const float dt = file["unit_dt"].scalar<float>();
  Units units(file, "spring", 2);
  size_t stretched = 0;
  for (size_t e = 0; e < units.count(); ++e) {
    const std::span<const Vec3f> at(&x[2 * e], 2), before(&xn[2 * e], 2);
    const auto slot = [&](int c) {
      return testing::slot_of<vbd::kSpring, float>(c, at, before, {ke[e], kd[e], rest[e]}, dt);
    };
    const auto block = [&](int c) { return vbd::Spring::block<vbd::Block, false>(slot(c), true); };
    units.compare(e, {block(0), block(1)});
    if (vbd::Spring::length(slot(0)) < rest[e]) continue;
    ++stretched;
    units.compare(e, {vbd::block_of(slot(0), true), vbd::block_of(slot(1), true)});
  }
  EXPECT_GT(stretched, 10u);
}

TEST(NewtonVbdUnits, ContactsAreNewtons) {
  const Npz file = testing::golden("newton_vbd_soft.npz");
  const auto n = file["unit_contact_n"].as<Vec3f>(), u = file["unit_contact_u"].as<Vec3f>(),
             material = file["unit_contact_mat"].as<Vec3f>();
  const auto distance = file["unit_contact_dist"].as<float>(),
             radius = file["unit_contact_rad"].as<float>();
  const float dt = file["unit_dt"].scalar<float>();
  const float slip = file["unit_contact_eps"].scalar<float>() * dt;
  Units units(file, "contact", 1);
  size_t resting = 0;
  for (size_t e = 0; e < units.count(); ++e) {
    const Vec3f origin{};
    const vbd::ParticleContact<float> contact = {
        n[e] * -distance[e], n[e],          -u[e], radius[e], material[e].x,
        material[e].y / dt,  material[e].z, slip};
    const auto block = vbd::particle_contact_block(origin, origin, contact);
    const Vec3f along = u[e] - n[e] * math::dot(n[e], u[e]);
    if (math::dot(along, along) > 0.0f || material[e].z == 0.0f) {
      units.compare(e, {block});
      continue;
    }
    // Without slip Newton leaves friction out. Here the friction is that of the least slip.
    ++resting;
    const Vec3f aside = math::cross(n[e], n[e].x * n[e].x < 0.5f ? Vec3f{1, 0, 0} : Vec3f{0, 1, 0});
    vbd::ParticleContact<float> creeping = contact;
    creeping.travel = contact.travel - aside * (1e-4f * slip);
    const auto near = vbd::particle_contact_block(origin, origin, creeping);
    const auto trace = [](const Block<float>& b) { return b.h00 + b.h11 + b.h22; };
    EXPECT_NEAR(trace(block), trace(near), 2e-4f * trace(near)) << e;
  }
  EXPECT_GT(resting, 0u);
}

class NewtonVbdRun : public ::testing::TestWithParam<const char*> {};

std::vector<Vec3f> velocity(std::span<const Vec3f> from, std::span<const Vec3f> to, float dt) {
  std::vector<Vec3f> v;
  for (size_t p = 0; p < from.size(); ++p) v.push_back((to[p] - from[p]) / dt);
  return v;
}

// Every substep of which the file has the state before, its velocity, and the positions after.
TEST_P(NewtonVbdRun, SubstepsFromNewtonsStateAreNewtons) {
  const NewtonVbdScene scene(GetParam());
  SolverVBD solver(scene.model, {.iterations = scene.iterations()});
  SimState in = scene.model->state(), out = scene.model->state();
  size_t compared = 0;
  for (size_t t = 0; t < 8; ++t) {
    in.particle_q.copy_from_host(scene.q(t));
    if (t > 0)
      in.particle_qd.copy_from_host(
          std::span<const Vec3f>(velocity(scene.q(t - 1), scene.q(t), scene.dt())));
    const Contacts contacts = scene.contacts(t);
    solver.step(in, out, nullptr, &contacts, scene.dt());
    const auto expected = velocity(scene.q(t), scene.q(t + 1), scene.dt());
    EXPECT_LE(largest_distance(out.particle_q.to_host(), scene.q(t + 1)), 1e-6f) << t;
    EXPECT_LE(largest_distance(out.particle_qd.to_host(), expected), 1e-3f) << t;
    ++compared;
  }
  EXPECT_EQ(compared, 8u);
}

// The iterates of substeps in free fall, at touch-down and in sliding contact. The velocity leads
// from the state to the first iterate.
TEST_P(NewtonVbdRun, IteratesAreNewtons) {
  const NewtonVbdScene scene(GetParam());
  const Vec3f g = scene.model->gravity.to_host()[0];
  size_t sliding = 0;
  for (const size_t t : {size_t{0}, size_t{40}, size_t{50}, size_t{100}, size_t{120}}) {
    const std::string name = "sweep" + std::to_string(t) + "_q";
    if (!scene.file.contains(name)) continue;
    const auto iterates = scene.file[name].as<Vec3f>();
    SimState in = scene.model->state(), out = scene.model->state();
    in.particle_q.copy_from_host(scene.q(t));
    std::vector<Vec3f> v = velocity(scene.q(t), iterates.first(scene.particles()), scene.dt());
    for (Vec3f& u : v) u = u - g * scene.dt();
    in.particle_qd.copy_from_host(std::span<const Vec3f>(v));
    const Contacts contacts = scene.contacts(t);
    sliding += static_cast<size_t>(contacts.active_soft_contact_count());
    for (int32_t k = 0; k <= scene.iterations(); ++k) {
      SolverVBD solver(scene.model, {.iterations = k});
      solver.step(in, out, nullptr, &contacts, scene.dt());
      const auto expected =
          iterates.subspan(static_cast<size_t>(k) * scene.particles(), scene.particles());
      EXPECT_LE(largest_distance(out.particle_q.to_host(), expected), 1e-6f)
          << name << ", iteration " << k;
    }
  }
  EXPECT_GT(sliding, 10u);
}

INSTANTIATE_TEST_SUITE_P(Scenes, NewtonVbdRun,
                         ::testing::Values("newton_vbd_cloth.npz", "newton_vbd_soft.npz"));

}  // namespace
}  // namespace novaphy
