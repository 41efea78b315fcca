// The derivative of a step of VBD: against vbd_gradients.npz, which holds those of the same sweeps
// in double precision (a program of its own, checked by central differences), and against
// differences of the step itself.
#include <gtest/gtest.h>

#include <cmath>

#include "newton_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/parallel.h"
#include "novaphy/vbd/unrolled_vbd.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::NewtonVbdScene;
using testing::Npz;
using testing::same_bits;

// |a - b| / |b| of flat lists.
template <class A, class B>
double relative_error(const A& actual, const B& expected) {
  double difference = 0.0, size = 0.0;
  EXPECT_EQ(std::size(actual), std::size(expected));
  for (size_t i = 0; i < std::size(expected); ++i) {
    const double a = static_cast<double>(actual[i]), b = static_cast<double>(expected[i]);
    difference += (a - b) * (a - b);
    size += b * b;
  }
  return std::sqrt(difference / size);
}
std::span<const float> flat(const std::vector<Vec3f>& rows) {
  return {&rows[0].x, 3 * rows.size()};
}

class VbdGradients : public ::testing::TestWithParam<const char*> {
 protected:
  std::string name(const char* what) const { return std::string(GetParam()) + "_" + what; }
};

// One step of 10 sweeps from Newton's substep 60, its contacts kept; loss = w_q.q + w_qd.qd.
TEST_P(VbdGradients, AreThoseOfDoublePrecision) {
  const NewtonVbdScene scene(("newton_vbd_" + std::string(GetParam()) + ".npz").c_str());
  const Npz file = testing::golden("vbd_gradients.npz");
  const auto t = static_cast<size_t>(file[name("t")].scalar<int32_t>());
  const size_t n = scene.particles();
  const std::vector<Vec3f> f(n);
  const Contacts contacts = scene.contacts(t);
  const VbdStepInputs in = {.particle_q = scene.q(t).data(),
                            .particle_qd = scene.file["qd_60"].as<Vec3f>().data(),
                            .particle_f = f.data(),
                            .contacts = &contacts,
                            .dt = scene.dt()};
  UnrolledVbd step(scene.model, {.iterations = 10});
  std::vector<Vec3f> q(n), qd(n), q_bar(n), qd_bar(n), f_bar(n);
  step.forward(in, q.data(), qd.data());
  EXPECT_LT(relative_error(flat(q), file[name("K10_out_q")].as<double>()), 1e-6);

  std::vector<float> tet_bar(scene.model->particle_tet_material.to_host().size());
  step.backward(in, file[name("w_q")].as<Vec3f>().data(), file[name("w_qd")].as<Vec3f>().data(),
                {.particle_q = q_bar.data(),
                 .particle_qd = qd_bar.data(),
                 .particle_f = f_bar.data(),
                 .particle_tet_material = tet_bar.data()});
  EXPECT_LT(relative_error(flat(q_bar), file[name("K10_grad_q")].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(qd_bar), file[name("K10_grad_qd")].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(f_bar), file[name("K10_grad_f")].as<double>()), 1e-3);
  if (!tet_bar.empty()) {
    const auto expected = file[name("K10_grad_tet")].as<double>();
    EXPECT_LT(relative_error(tet_bar, expected), 1e-3);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, VbdGradients, ::testing::Values("soft", "cloth"));

// A cloth, a block and a spring with everything that has a derivative: damping, activations, bent
// edges, a contact with friction.
struct EverythingScene {
  std::shared_ptr<Model> model;
  std::unique_ptr<Contacts> contacts;
  std::vector<Vec3f> q, qd, f, w_q, w_qd;
  Control control;

  EverythingScene() : model(make()), control(model->control()) {
    CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
    contacts = std::make_unique<Contacts>(pipeline.contacts());
    pipeline.collide(model->state(), *contacts);
    q = model->particle_q.to_host();
    const size_t n = q.size();
    for (size_t p = 0; p < n; ++p) {
      const auto wave = [p](float a) { return std::sin(a * static_cast<float>(p + 1)); };
      qd.push_back({0.5f * wave(1.3f), 0.4f * wave(2.1f), -0.5f});
      f.push_back({0.01f * wave(0.7f), 0.0f, 0.02f * wave(1.9f)});
      w_q.push_back({wave(3.1f), wave(1.7f), wave(2.3f)});
      w_qd.push_back({0.01f * wave(0.9f), 0.01f * wave(4.1f), 0.01f * wave(5.3f)});
    }
    control.particle_tri_activation.fill(0.05f);
    control.particle_tet_activation.fill(-0.03f);
  }
  static std::shared_ptr<Model> make() {
    ModelBuilder b;
    b.add_cloth_grid({.placement = {.pos = {0.0f, 0.0f, 0.5f}},
                      .dim_x = 4,
                      .dim_y = 3,
                      .cell_x = 0.1,
                      .cell_y = 0.1,
                      .mass = 0.02f,
                      .fix_left = true,
                      .tri = {.ke = 20.0f, .ka = 30.0f, .kd = 0.05f},
                      .edge = {.ke = 0.5f, .kd = 0.01f}});
    b.add_soft_grid({.placement = {.pos = {0.0f, 0.0f, 0.12f}},
                     .dim_x = 2,
                     .dim_y = 2,
                     .dim_z = 2,
                     .density = 100.0,
                     .k_mu = 300.0f,
                     .k_lambda = 500.0f,
                     .k_damp = 2.0f,
                     .particle_radius = 0.1f});
    b.add_spring(7, 30, 40.0f, 0.5f);
    b.add_ground_plane({.cfg = ShapeConfig{.ke = 100.0f, .kd = 0.0f, .mu = 0.5f}});
    for (size_t p = 0; p < b.particle_q.size(); ++p)
      b.particle_q[p].z += 0.02f * std::sin(2.0f * static_cast<float>(p));
    b.color();
    auto model = b.finalize(Device::cpu());
    model->soft_contact_ke = 100.0f;
    model->soft_contact_kd = 0.0f;
    return model;
  }
  VbdStepInputs inputs() const {
    return {q.data(),
            qd.data(),
            f.data(),
            &control.particle_tri_activation,
            &control.particle_tet_activation,
            contacts.get(),
            1.0f / 60.0f};
  }
  double loss(UnrolledVbd& step) const {
    std::vector<Vec3f> q_out(q.size()), qd_out(q.size());
    step.forward(inputs(), q_out.data(), qd_out.data());
    double sum = 0.0;
    for (size_t p = 0; p < q.size(); ++p) {
      const Vec3f &a = q_out[p], &u = w_q[p], &b = qd_out[p], &v = w_qd[p];
      sum += static_cast<double>(a.x) * u.x + static_cast<double>(a.y) * u.y +
             static_cast<double>(a.z) * u.z + static_cast<double>(b.x) * v.x +
             static_cast<double>(b.y) * v.y + static_cast<double>(b.z) * v.z;
    }
    return sum;
  }
};

// The derivative along a direction (a fraction of the values) and by central differences.
class Along {
 public:
  explicit Along(double size) : size_(size) {}
  // `values` moves by size * direction(i); `write` puts it back where the step reads it.
  template <class Write>
  void check(const char* name, std::vector<float> values, const std::vector<float>& bars,
             const EverythingScene& scene, UnrolledVbd& step, const Write& write) {
    const std::vector<float> kept = values;
    double expected = 0.0, width = 0.0;
    const auto direction = [&](size_t i) {
      return size_ * std::sin(1.0 + 2.7 * static_cast<double>(i));
    };
    double loss[2];
    for (int side = 0; side < 2; ++side) {
      for (size_t i = 0; i < values.size(); ++i)
        values[i] = static_cast<float>(static_cast<double>(kept[i]) +
                                       (side == 0 ? direction(i) : -direction(i)));
      write(values);
      loss[side] = scene.loss(step);
    }
    write(kept);
    for (size_t i = 0; i < kept.size(); ++i) {
      expected += 2.0 * direction(i) * static_cast<double>(bars[i]);
      width += std::abs(direction(i) * static_cast<double>(bars[i]));
    }
    const double actual = loss[0] - loss[1];
    EXPECT_NEAR(actual, expected, 1e-2 * std::abs(expected) + 2e-6) << name;
    EXPECT_GT(std::abs(expected), 2e-5) << name << ": too small to tell";
  }

 private:
  double size_;
};

TEST(UnrolledVbd, EveryGradientIsThatOfDifferences) {
  EverythingScene scene;
  ASSERT_GT(scene.contacts->active_soft_contact_count(), 0);
  UnrolledVbd step(scene.model, {.iterations = 6});
  const Model& m = *scene.model;
  const size_t n = scene.q.size();
  std::vector<Vec3f> q(n), qd(n), f(n);
  const auto floats = [](const Array& array) {
    return std::vector<float>(array.bytes() / sizeof(float));
  };
  auto ke = floats(m.particle_spring_stiffness), kd = ke, rest = ke;
  auto tri = floats(m.particle_tri_material), tri_act = floats(m.particle_tri_activation);
  auto edge = floats(m.particle_edge_material), angle = floats(m.particle_edge_rest_angle);
  auto tet = floats(m.particle_tet_material), tet_act = floats(m.particle_tet_activation);
  step.backward(scene.inputs(), scene.w_q.data(), scene.w_qd.data(),
                {q.data(), qd.data(), f.data(), ke.data(), kd.data(), rest.data(), tri.data(),
                 tri_act.data(), edge.data(), angle.data(), tet.data(), tet_act.data()});

  const auto state = [&](const char* name, std::vector<Vec3f>& values,
                         const std::vector<Vec3f>& bars, double size) {
    const auto own = flat(values), by = flat(bars);
    Along(size).check(
        name, {own.begin(), own.end()}, {by.begin(), by.end()}, scene, step,
        [&](const std::vector<float>& v) { std::copy(v.begin(), v.end(), &values[0].x); });
  };
  state("particle_q", scene.q, q, 2e-4);
  state("particle_qd", scene.qd, qd, 1e-2);
  state("particle_f", scene.f, f, 2e-2);
  const auto numbers = [&](const char* name, const DeviceArray<float>& array,
                           const std::vector<float>& bars, double size) {
    DeviceArray<float> handle = array;
    Along(size).check(name, array.to_host(), bars, scene, step, [&](const std::vector<float>& v) {
      handle.copy_from_host(std::span<const float>(v));
    });
  };
  numbers("particle_spring_stiffness", m.particle_spring_stiffness, ke, 4.0);
  numbers("particle_spring_damping", m.particle_spring_damping, kd, 0.1);
  numbers("particle_spring_rest_length", m.particle_spring_rest_length, rest, 0.01);
  numbers("particle_tri_activation", scene.control.particle_tri_activation, tri_act, 0.01);
  numbers("particle_edge_rest_angle", m.particle_edge_rest_angle, angle, 0.01);
  numbers("particle_tet_activation", scene.control.particle_tet_activation, tet_act, 0.01);
  numbers("particle_tet_material", m.particle_tet_material, tet, 1.0);
  // Columns apart: they have different units.
  const auto column = [&](const char* name, const DeviceArray<float>& array,
                          const std::vector<float>& bars, size_t width, size_t c, double size) {
    std::vector<float> own, by;
    std::vector<size_t> places;  // materials that are 0 stay so
    const std::vector<float> all = array.to_host();
    for (size_t i = c; i < all.size(); i += width) {
      if (all[i] == 0.0f) continue;
      own.push_back(all[i]);
      by.push_back(bars[i]);
      places.push_back(i);
    }
    DeviceArray<float> handle = array;
    Along(size).check(name, own, by, scene, step, [&](const std::vector<float>& v) {
      std::vector<float> changed = all;
      for (size_t i = 0; i < v.size(); ++i) changed[places[i]] = v[i];
      handle.copy_from_host(std::span<const float>(changed));
    });
  };
  column("tri ke", m.particle_tri_material, tri, 5, 0, 1.0);
  column("tri ka", m.particle_tri_material, tri, 5, 1, 1.0);
  column("tri kd", m.particle_tri_material, tri, 5, 2, 0.02);
  column("tet k_damp", m.particle_tet_material, tet, 3, 2, 0.5);
}

TEST(UnrolledVbd, GradientsHaveTheSameBitsForAnyThreadsAndInstructionSet) {
  EverythingScene scene;
  const size_t n = scene.q.size();
  const int before = num_threads();
  std::vector<std::vector<Vec3f>> all;
  const auto run = [&] {
    UnrolledVbd step(scene.model, {.iterations = 4});
    std::vector<Vec3f> q(n);
    step.backward(scene.inputs(), scene.w_q.data(), scene.w_qd.data(), {.particle_q = q.data()});
    all.push_back(q);
  };
  for (const int threads : {1, 2, 7}) {
    set_num_threads(threads);
    run();
  }
  set_num_threads(before);
  for (const char* level : {"baseline", "avx2", "avx512"}) {
    setenv("NOVAPHY_CPU_ISA", level, 1);
    try {
      run();
    } catch (const Error& error) {
      EXPECT_NE(std::string_view(error.what()).find("does not have it"), std::string_view::npos);
    }
  }
  unsetenv("NOVAPHY_CPU_ISA");
  for (const auto& q : all) EXPECT_TRUE(same_bits<Vec3f>(q, all[0]));
}

TEST(UnrolledVbd, OptionsWithoutAGradientAreRefusedByName) {
  const auto model = EverythingScene::make();
  EXPECT_ERROR(UnrolledVbd(model, {.acceleration = 0.5f}), ErrorKind::NotImplemented,
               "acceleration");
  EXPECT_ERROR(UnrolledVbd(model, {.tolerance = 0.5f}), ErrorKind::NotImplemented, "tolerance");
  EXPECT_ERROR(UnrolledVbd(model, {.safeguard = true}), ErrorKind::NotImplemented, "safeguard");
  EXPECT_ERROR(UnrolledVbd(model, {.initial_guess = VbdInitialGuess::Adaptive}),
               ErrorKind::NotImplemented, "adaptive");
}

}  // namespace
}  // namespace novaphy
