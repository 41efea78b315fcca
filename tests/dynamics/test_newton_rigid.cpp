// Rigid scenes of Newton 1.8.0 (cpu, dt 1/960, 480 substeps): every bit of rows, poses and twists.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "dynamics/newton_rigid_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "support/bits.h"
#include "support/npz.h"

namespace novaphy {
namespace {

using testing::golden;
using testing::Npz;
using testing::same_bits;
using Scene = testing::NewtonRigidScene;

template <class T>
std::vector<T> first(const DeviceArray<T>& array, size_t count) {
  std::vector<T> values = array.to_host();
  values.resize(count);
  return values;
}

// Zeros may differ in sign.
template <class T>
void expect_rows(const DeviceArray<T>& array, const testing::NpyArray& expected, const char* name) {
  const auto values = expected.as<T>();
  EXPECT_EQ(first(array, values.size()), std::vector<T>(values.begin(), values.end())) << name;
}

void expect_contacts(const Contacts& c, const Scene& scene, size_t t) {
  const std::string at = "contact" + std::to_string(t) + "_";
  expect_rows(c.rigid_contact_shape0, scene[at + "shape0"], "shape0");
  expect_rows(c.rigid_contact_shape1, scene[at + "shape1"], "shape1");
  expect_rows(c.rigid_contact_point0, scene[at + "point0"], "point0");
  expect_rows(c.rigid_contact_point1, scene[at + "point1"], "point1");
  expect_rows(c.rigid_contact_offset0, scene[at + "offset0"], "offset0");
  expect_rows(c.rigid_contact_offset1, scene[at + "offset1"], "offset1");
  expect_rows(c.rigid_contact_normal, scene[at + "normal"], "normal");
  expect_rows(c.rigid_contact_margin0, scene[at + "margin0"], "margin0");
  expect_rows(c.rigid_contact_margin1, scene[at + "margin1"], "margin1");
}

class NewtonRigid : public ::testing::TestWithParam<const char*> {};

TEST_P(NewtonRigid, TheRolloutAndItsRowsAreNewtonsInAllBits) {
  const Scene scene(GetParam());
  const auto model = scene.model();
  EXPECT_TRUE(same_bits(std::span<const Mat33f>(model->body_inv_inertia.to_host()),
                        scene["model_body_inv_inertia"].as<Mat33f>()));
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model, {.friction_law = FrictionLaw::Newton18});
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
  scene.load(0, now);
  const auto counts = scene["contact_count"].as<int32_t>();
  const auto stored = scene["contact_steps"].as<int32_t>();
  size_t most = 0;
  for (size_t t = 0; t < 480; ++t) {
    pipeline.collide(now, contacts);
    ASSERT_EQ(contacts.rigid_contact_count.to_host()[0], counts[t]) << t;
    most = std::max(most, static_cast<size_t>(counts[t]));
    if (std::find(stored.begin(), stored.end(), static_cast<int32_t>(t)) != stored.end())
      expect_contacts(contacts, scene, t);
    solver.step(now, next, nullptr, &contacts, scene.dt());
    ASSERT_TRUE(scene.is_at(t + 1, next));
    std::swap(now, next);
  }
  EXPECT_GE(most, 1u);
}

INSTANTIATE_TEST_SUITE_P(Scenes, NewtonRigid,
                         ::testing::Values("box_drop", "box_slope", "sphere_roll",
                                           "capsule_tumble"),
                         [](const auto& scene) { return std::string(scene.param); });

// Runs with Newton's contact rows, and compares pose and twist after the substeps in the file.
TEST(NewtonRigidRows, TwoStackedBoxesMoveAsNewtonsOnItsRows) {
  const Scene scene("stack2");
  const auto model = scene.model();
  SolverSemiImplicit solver(model, {.friction_law = FrictionLaw::Newton18});
  SimState now = model->state(), next = model->state();
  for (const int32_t t : scene["contact_steps"].as<int32_t>()) {
    const std::string at = "contact" + std::to_string(t) + "_";
    const auto rows = static_cast<int32_t>(scene[at + "shape0"].size());
    Contacts contacts({.rigid_contact_max = rows, .model_id = model->id()}, Device::cpu());
    contacts.rigid_contact_count.fill(rows);
    contacts.rigid_contact_shape0.copy_from_host(scene[at + "shape0"].as<int32_t>());
    contacts.rigid_contact_shape1.copy_from_host(scene[at + "shape1"].as<int32_t>());
    contacts.rigid_contact_point0.copy_from_host(scene[at + "point0"].as<Vec3f>());
    contacts.rigid_contact_point1.copy_from_host(scene[at + "point1"].as<Vec3f>());
    contacts.rigid_contact_normal.copy_from_host(scene[at + "normal"].as<Vec3f>());
    contacts.rigid_contact_margin0.copy_from_host(scene[at + "margin0"].as<float>());
    contacts.rigid_contact_margin1.copy_from_host(scene[at + "margin1"].as<float>());
    scene.load(static_cast<size_t>(t), now);
    solver.step(now, next, nullptr, &contacts, scene.dt());
    EXPECT_TRUE(scene.is_at(static_cast<size_t>(t) + 1, next));
  }
}

// With our rows, four a pair as Newton keeps, which are other points of the same faces.
TEST(NewtonRigidRows, TwoStackedBoxesStayAtNewtonsHeights) {
  const Scene scene("stack2");
  const auto model = scene.model();
  CollisionPipeline pipeline(model, {.contacts_per_pair = 4});
  SolverSemiImplicit solver(model, {.friction_law = FrictionLaw::Newton18});
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
  scene.load(0, now);
  const auto poses = scene["body_q"].as<Transformf>();
  for (size_t t = 0; t < 480; ++t) {
    pipeline.collide(now, contacts);
    solver.step(now, next, nullptr, &contacts, scene.dt());
    std::swap(now, next);
    const auto q = now.body_q.to_host();
    for (size_t b = 0; b < 2; ++b) ASSERT_NEAR(q[b].p.z, poses[2 * (t + 1) + b].p.z, 3e-4f) << t;
  }
}

}  // namespace
}  // namespace novaphy
