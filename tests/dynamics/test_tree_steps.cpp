// Trees that step several at once, one per lane, have the bits of trees that step alone.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <random>
#include <string>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {
namespace {

// Solvers that are made while it lives use this level. Skips if the processor does not support it.
class Level {
 public:
  explicit Level(const char* name) {
    if (const char* before = std::getenv("NOVAPHY_CPU_ISA")) before_ = before;
    setenv("NOVAPHY_CPU_ISA", name, 1);
  }
  ~Level() {
    if (before_)
      setenv("NOVAPHY_CPU_ISA", before_->c_str(), 1);
    else
      unsetenv("NOVAPHY_CPU_ISA");
  }

 private:
  std::optional<std::string> before_;
};
// Builds with a sanitizer have one level.
bool has_level(const char* name) {
#if defined(__x86_64__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  if (std::strcmp(name, "avx512") == 0)
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("fma");
  if (std::strcmp(name, "avx2") == 0)
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#endif
  return std::strcmp(name, "baseline") == 0;
}

// A floating body with arms of all joints; drives, limits, clamps of effort and velocity act.
// `tail`: so many hinges more in a row.
ModelBuilder creature(int tail = 0) {
  ModelBuilder b;
  ShapeConfig surface;
  surface.mu = 0.6f;
  surface.restitution = 0.3f;
  b.add_ground_plane({.cfg = surface});
  surface.collision_group = -1;  // its shapes do not meet each other
  const auto link = [&](float radius) {
    const int32_t body = b.add_link({});
    b.add_shape_sphere(body, {.radius = radius, .cfg = surface});
    return body;
  };
  const auto at = [](float x, float y, float z) {
    return Transformf{{x, y, z}, Quatf{0.1f, -0.2f, 0.3f, 0.9273618f}};
  };
  const int32_t trunk = b.add_link({.xform = {{0, 0, 0.22f}, Quatf::identity()}});
  b.add_shape_sphere(trunk, {.radius = 0.2f, .cfg = surface});
  std::vector<int32_t> joints = {b.add_joint_free(trunk)};
  JointDofConfig dof;
  dof.axis = {0, 0.6f, 0.8f};
  dof.target_ke = 40.0f;
  dof.target_kd = 1.0f;
  dof.armature = 0.01f;
  dof.damping = 0.1f;
  dof.limit_lower = -0.4f;
  dof.limit_upper = 0.5f;
  dof.limit_ke = 200.0f;
  dof.limit_kd = 2.0f;
  dof.effort_limit = 6.0f;
  dof.velocity_limit = 5.0f;
  const int32_t hip = link(0.07f), slide = link(0.06f), shoulder = link(0.08f), foot = link(0.06f);
  joints.push_back(
      b.add_joint_revolute(trunk, hip, {.parent_xform = at(0.3f, 0, -0.1f), .dof = dof}));
  joints.push_back(b.add_joint_prismatic(hip, slide, {.parent_xform = at(0.2f, 0, 0), .dof = dof}));
  joints.push_back(b.add_joint_ball(trunk, shoulder, {.parent_xform = at(-0.3f, 0.1f, 0)}));
  joints.push_back(
      b.add_joint_revolute(shoulder, foot, {.parent_xform = at(0, 0.3f, 0), .dof = dof}));
  for (int32_t k = 0, last = foot; k < tail; ++k) {
    const int32_t next = link(0.05f);
    joints.push_back(
        b.add_joint_revolute(last, next, {.parent_xform = at(0.05f, 0.1f, 0), .dof = dof}));
    last = next;
  }
  b.add_articulation(joints);
  for (size_t k = 8; k < 11; ++k) b.joint_damping[k] = 0.5f;  // the ball joint
  return b;
}

void set(const DeviceArray<float>& array, const std::vector<float>& values) {
  DeviceArray<float> to = array;
  std::copy(values.begin(), values.end(), to.mutable_data());
}

struct World {
  std::vector<float> q, qd, f;
};
std::vector<World> random_worlds(const Model& one, size_t count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
  std::vector<World> worlds(count);
  for (World& w : worlds) {
    w.q = one.joint_q.to_host();
    for (size_t i = 0; i < w.q.size(); ++i) w.q[i] += (i < 3 ? 0.1f : 0.5f) * unit(random);
    for (const size_t o : {size_t{3}, size_t{9}}) {  // the root and the ball joint
      float length = 0.0f;
      for (size_t i = o; i < o + 4; ++i) length += w.q[i] * w.q[i];
      for (size_t i = o; i < o + 4; ++i) w.q[i] /= std::sqrt(length);
    }
    for (size_t i = 0; i < one.joint_qd.rows(); ++i) {
      w.qd.push_back(2.0f * unit(random));
      w.f.push_back(2.0f * unit(random));
    }
  }
  return worlds;
}

struct Run {
  std::vector<std::vector<float>> values;  // by world, after every step
  int32_t most_contacts = 0;
};
// All worlds in one model; `spread`: every world has a mass of its own, `place` is the first's.
Run run(const std::vector<World>& worlds, size_t place, bool spread, bool touching, int steps,
        int tail) {
  ModelBuilder one = creature(tail), all;
  all.replicate(one, static_cast<int32_t>(worlds.size()), {});
  const auto model = all.finalize();
  if (spread) {
    std::vector<float> mass = model->body_mass.to_host();
    const size_t bodies = mass.size() / worlds.size();
    for (size_t i = 0; i < mass.size(); ++i)
      mass[i] *= 1.0f + 0.01f * static_cast<float>(place + i / bodies);
    set(model->body_mass, mass);
  }
  SimState now = model->state(), next = model->state();
  Control control = model->control();
  World w;
  for (const World& x : worlds) {
    w.q.insert(w.q.end(), x.q.begin(), x.q.end());
    w.qd.insert(w.qd.end(), x.qd.begin(), x.qd.end());
    w.f.insert(w.f.end(), x.f.begin(), x.f.end());
  }
  set(now.joint_q, w.q);
  set(now.joint_qd, w.qd);
  set(control.joint_f, w.f);
  SolverFeatherstone solver(model);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  solver.step(now, next, &control, nullptr, 1e-4f);  // poses
  std::swap(now, next);
  Run r;
  r.values.resize(worlds.size());
  for (int t = 0; t < steps; ++t) {
    if (touching) pipeline.collide(now, contacts);
    solver.step(now, next, &control, touching ? &contacts : nullptr, 2e-3f);
    std::swap(now, next);
    for (const auto* array : {&now.joint_q, &now.joint_qd}) {
      const std::vector<float> x = array->to_host();
      const size_t n = x.size() / worlds.size();
      for (size_t k = 0; k < x.size(); ++k) r.values[k / n].push_back(x[k]);
    }
    const auto* body_q = &now.body_q.data()->p.x;
    const auto* body_qd = &now.body_qd.data()->linear.x;
    const size_t bodies = now.body_q.rows() / worlds.size();
    for (size_t k = 0; k < worlds.size(); ++k) {
      r.values[k].insert(r.values[k].end(), body_q + 7 * bodies * k, body_q + 7 * bodies * (k + 1));
      r.values[k].insert(r.values[k].end(), body_qd + 6 * bodies * k,
                         body_qd + 6 * bodies * (k + 1));
    }
    if (touching) {
      r.most_contacts = std::max(r.most_contacts, *contacts.rigid_contact_count.data());
    }
  }
  return r;
}

// Worlds without offsets, so that each is where it would be alone.
void expect_lanes_as_alone(bool spread, bool touching, int steps, int tail = 0) {
  const auto worlds = random_worlds(*creature(tail).finalize(), 21);
  std::vector<Run> alone;
  for (size_t i = 0; i < worlds.size(); ++i)
    alone.push_back(run({worlds[i]}, i, spread, touching, steps, tail));
  for (const char* name : {"baseline", "avx2", "avx512"}) {
    if (!has_level(name)) continue;
    const Level level(name);
    for (const int threads : {1, 3, 11}) {
      set_num_threads(threads);
      const Run together = run(worlds, 0, spread, touching, steps, tail);
      EXPECT_EQ(together.most_contacts > 21, touching);
      for (size_t i = 0; i < worlds.size(); ++i) {
        ASSERT_EQ(together.values[i].size(), alone[i].values[0].size());
        EXPECT_EQ(std::memcmp(together.values[i].data(), alone[i].values[0].data(),
                              together.values[i].size() * sizeof(float)),
                  0)
            << name << ", " << threads << " threads, world " << i;
      }
    }
  }
  set_num_threads(available_cpus());
}

TEST(TreeSteps, LanesHaveTheBitsOfTreesAlone) { expect_lanes_as_alone(false, false, 60); }
TEST(TreeSteps, LanesWithOtherMassesHaveTheBitsOfTreesAlone) {
  expect_lanes_as_alone(true, false, 20);
}
TEST(TreeSteps, LanesThatTouchHaveTheBitsOfTreesAlone) { expect_lanes_as_alone(false, true, 150); }
TEST(TreeSteps, LanesOfOtherMassesThatTouchHaveTheBitsOfTreesAlone) {
  expect_lanes_as_alone(true, true, 100);
}
TEST(TreeSteps, LanesOfLongTreesThatTouchHaveTheBitsOfTreesAlone) {
  expect_lanes_as_alone(true, true, 30, 8);
}

// Two boxes in a pile on the ground, and a ball that rolls at them with the speed `speed` + 0.1 i
// in world i. Every third world has no second box. Returns the coordinates of each world after
// every step.
std::vector<std::vector<float>> run_piles(size_t first, size_t count, float tolerance) {
  ModelBuilder all;
  ShapeConfig surface;
  surface.mu = 0.5f;
  surface.gap = 0.02f;
  for (size_t i = first; i < first + count; ++i) {
    ModelBuilder one;
    one.add_ground_plane({.cfg = surface});
    for (const float height : {0.1f, 0.3f}) {
      if (i % 3 == 2 && height > 0.1f) continue;
      one.add_shape_box(one.add_body({.xform = {{0, 0, height}, Quatf::identity()}}),
                        {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = surface});
    }
    one.add_shape_sphere(one.add_body({.xform = {{-0.2f, 0.03f, 0.09f}, Quatf::identity()}}),
                         {.radius = 0.09f, .cfg = surface});
    all.add_world(one);
  }
  const auto model = all.finalize();
  SimState now = model->state(), next = model->state();
  std::vector<float> qd = model->joint_qd.to_host();
  for (size_t k = 0, dof = 0; k < count; ++k) {
    dof += (first + k) % 3 == 2 ? 12 : 18;
    qd[dof - 6] = 1.0f + 0.1f * static_cast<float>(first + k);
  }
  set(now.joint_qd, qd);
  FeatherstoneOptions options;
  options.pgs_iterations = 200;
  options.pgs_tolerance = tolerance;
  SolverFeatherstone solver(model, options);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  std::vector<std::vector<float>> values(count);
  for (int t = 0; t < 40; ++t) {
    pipeline.collide(now, contacts);
    solver.step(now, next, nullptr, &contacts, 2e-3f);
    std::swap(now, next);
    const std::vector<float> q = now.joint_q.to_host(), rates = now.joint_qd.to_host();
    auto at = q.begin(), rate = rates.begin();
    for (size_t k = 0; k < count; ++k) {
      const std::ptrdiff_t bodies = (first + k) % 3 == 2 ? 2 : 3;
      values[k].insert(values[k].end(), at, at + 7 * bodies);
      values[k].insert(values[k].end(), rate, rate + 6 * bodies);
      at += 7 * bodies;
      rate += 6 * bodies;
    }
  }
  return values;
}

// Islands of two and three bodies share lanes with those of other worlds. With the tolerances, few
// or many islands need more sweeps than others.
TEST(TreeSteps, IslandsOfManyWorldsHaveTheBitsOfIslandsAlone) {
  constexpr size_t kWorlds = 30;
  for (const float tolerance : {1e-4f, 1e-6f}) {
    std::vector<std::vector<float>> alone;
    for (size_t i = 0; i < kWorlds; ++i) alone.push_back(run_piles(i, 1, tolerance)[0]);
    for (const char* name : {"baseline", "avx2", "avx512"}) {
      if (!has_level(name)) continue;
      const Level level(name);
      for (const int threads : {1, 3}) {
        set_num_threads(threads);
        const auto together = run_piles(0, kWorlds, tolerance);
        for (size_t i = 0; i < kWorlds; ++i) {
          ASSERT_EQ(together[i].size(), alone[i].size());
          EXPECT_EQ(
              std::memcmp(together[i].data(), alone[i].data(), together[i].size() * sizeof(float)),
              0)
              << name << ", " << threads << " threads, world " << i;
        }
      }
    }
  }
  set_num_threads(available_cpus());
}

TEST(TreeSteps, AWorldThatFailsLeavesTheNewStateAsItWas) {
  const auto worlds = random_worlds(*creature().finalize(), 20);
  ModelBuilder one = creature(), all;
  all.replicate(one, 20, {});
  const auto model = all.finalize();
  SimState now = model->state(), next = model->state();
  std::vector<float> q;
  for (const World& w : worlds) q.insert(q.end(), w.q.begin(), w.q.end());
  set(now.joint_q, q);
  SolverFeatherstone(model).step(now, next, nullptr, nullptr, 1e-3f);
  const size_t n = q.size() / 20;
  q[5 * n + 8] = std::nanf("");
  set(now.joint_q, q);
  const std::vector<float> before = next.joint_q.to_host();
  const std::vector<SpatialVectorf> rates = next.body_qd.to_host();
  try {
    SolverFeatherstone(model).step(now, next, nullptr, nullptr, 1e-3f);
    FAIL() << "expected an error";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("dof 67 (joint"), std::string::npos) << e.what();
  }
  EXPECT_EQ(next.joint_q.to_host(), before);
  const std::vector<SpatialVectorf> got = next.body_qd.to_host();
  for (size_t i = 0; i < got.size(); ++i)
    EXPECT_EQ(std::memcmp(&got[i], &rates[i], sizeof(got[i])), 0) << i;
}

}  // namespace
}  // namespace novaphy
