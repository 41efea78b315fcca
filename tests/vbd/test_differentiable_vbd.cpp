// Compares the derivative of a step of VBD with vbd_gradients.npz, and with differences of the
// step. The file has the derivatives of the same sweeps in double precision. A separate program
// computed the file, and was checked by central differences.
#include <gtest/gtest.h>

#include <cmath>

#include "everything_scene.h"
#include "newton_scene.h"
#include "novaphy/core/parallel.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::EverythingScene;
using testing::NewtonVbdScene;
using testing::Npz;
using testing::rows_of;
using testing::same_bits;
using testing::zeros;

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
std::span<const float> flat(const DeviceArray<Vec3f>& rows) {
  return {&rows.data()->x, 3 * rows.rows()};
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
  const Contacts contacts = scene.contacts(t);
  const VbdStepInputs in = {.q = rows_of(scene.q(t)),
                            .qd = rows_of(scene.file["qd_60"].as<Vec3f>()),
                            .f = zeros<Vec3f>(n),
                            .contacts = &contacts,
                            .dt = scene.dt()};
  DifferentiableVbd step(scene.model, {.iterations = 10});
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), q_bar = zeros<Vec3f>(n),
             qd_bar = zeros<Vec3f>(n), f_bar = zeros<Vec3f>(n);
  step.forward(in, q, qd);
  EXPECT_LT(relative_error(flat(q), file[name("K10_out_q")].as<double>()), 1e-6);

  const auto tet_rows = zeros<float>(scene.model->particle_tet_material.to_host().size());
  step.backward(in, rows_of(file[name("w_q")].as<Vec3f>()), rows_of(file[name("w_qd")].as<Vec3f>()),
                {.particle_q = q_bar,
                 .particle_qd = qd_bar,
                 .particle_f = f_bar,
                 .particle_tet_material = tet_rows});
  const std::vector<float> tet_bar = tet_rows.to_host();
  EXPECT_LT(relative_error(flat(q_bar), file[name("K10_grad_q")].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(qd_bar), file[name("K10_grad_qd")].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(f_bar), file[name("K10_grad_f")].as<double>()), 1e-3);
  if (!tet_bar.empty()) {
    const auto expected = file[name("K10_grad_tet")].as<double>();
    EXPECT_LT(relative_error(tet_bar, expected), 1e-3);
  }
}

// Four steps of 5 sweeps, all with the contacts of the first.
TEST_P(VbdGradients, OfSeveralStepsAreThoseOfDoublePrecision) {
  const NewtonVbdScene scene(("newton_vbd_" + std::string(GetParam()) + ".npz").c_str());
  const Npz file = testing::golden("vbd_gradients.npz");
  const auto first = static_cast<size_t>(file[name("t")].scalar<int32_t>());
  constexpr size_t kSteps = 4;
  const size_t n = scene.particles();
  std::vector<DeviceArray<Vec3f>> q = {rows_of(scene.q(first))},
                                  qd = {rows_of(scene.file["qd_60"].as<Vec3f>())};
  std::vector<Contacts> contacts;
  for (size_t s = 0; s < kSteps; ++s) contacts.push_back(scene.contacts(first));
  const auto inputs = [&](size_t s) {
    return VbdStepInputs{
        .q = q[s], .qd = qd[s], .f = zeros<Vec3f>(n), .contacts = &contacts[s], .dt = scene.dt()};
  };
  DifferentiableVbd step(scene.model, {.iterations = 5});
  for (size_t s = 0; s < kSteps; ++s) {
    q.push_back(zeros<Vec3f>(n));
    qd.push_back(zeros<Vec3f>(n));
    step.forward(inputs(s), q[s + 1], qd[s + 1]);
  }
  EXPECT_LT(relative_error(flat(q[kSteps]), file[name("T4K5_out_q")].as<double>()), 1e-6);

  auto q_bar = rows_of(file[name("w_q")].as<Vec3f>()),
       qd_bar = rows_of(file[name("w_qd")].as<Vec3f>());
  std::vector<float> tet_bar(scene.model->particle_tet_material.to_host().size());
  for (size_t s = kSteps; s-- > 0;) {
    const auto by_q = zeros<Vec3f>(n), by_qd = zeros<Vec3f>(n);
    const auto by_tet = zeros<float>(tet_bar.size());
    step.backward(inputs(s), q_bar, qd_bar,
                  {.particle_q = by_q, .particle_qd = by_qd, .particle_tet_material = by_tet});
    q_bar = by_q;
    qd_bar = by_qd;
    for (size_t i = 0; i < tet_bar.size(); ++i) tet_bar[i] += by_tet.data()[i];
  }
  EXPECT_LT(relative_error(flat(q_bar), file[name("T4K5_grad_q")].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(qd_bar), file[name("T4K5_grad_qd")].as<double>()), 1e-3);
  if (!tet_bar.empty()) {
    EXPECT_LT(relative_error(tet_bar, file[name("T4K5_grad_tet")].as<double>()), 1e-3);
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, VbdGradients, ::testing::Values("soft", "cloth"));

// The derivative along a direction (a fraction of the values) and by central differences.
class Along {
 public:
  explicit Along(double size) : size_(size) {}
  // The values are moved by size * direction(i). `write` puts them where the step reads them.
  template <class Write>
  void check(const char* name, std::vector<float> values, const std::vector<float>& bars,
             const EverythingScene& scene, DifferentiableVbd& step, const Write& write) {
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

TEST(DifferentiableVbd, EveryGradientIsThatOfDifferences) {
  EverythingScene scene;
  ASSERT_GT(scene.contacts->active_soft_contact_count(), 0);
  DifferentiableVbd step(scene.model, {.iterations = 6});
  const Model& m = *scene.model;
  const size_t n = scene.q.size();
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), f = zeros<Vec3f>(n);
  const auto floats = [](const Array& array) {
    return zeros<float>(array.bytes() / sizeof(float));
  };
  auto ke = floats(m.particle_spring_stiffness), kd = floats(m.particle_spring_stiffness),
       rest = floats(m.particle_spring_stiffness);
  auto tri = floats(m.particle_tri_material), tri_act = floats(m.particle_tri_activation);
  auto edge = floats(m.particle_edge_material), angle = floats(m.particle_edge_rest_angle);
  auto tet = floats(m.particle_tet_material), tet_act = floats(m.particle_tet_activation);
  step.backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd),
                {.particle_q = q,
                 .particle_qd = qd,
                 .particle_f = f,
                 .particle_spring_stiffness = ke,
                 .particle_spring_damping = kd,
                 .particle_spring_rest_length = rest,
                 .particle_tri_material = tri,
                 .particle_tri_activation = tri_act,
                 .particle_edge_material = edge,
                 .particle_edge_rest_angle = angle,
                 .particle_tet_material = tet,
                 .particle_tet_activation = tet_act});

  const auto state = [&](const char* name, std::vector<Vec3f>& values,
                         const DeviceArray<Vec3f>& bars, double size) {
    const auto own = flat(values), by = flat(bars);
    Along(size).check(
        name, {own.begin(), own.end()}, {by.begin(), by.end()}, scene, step,
        [&](const std::vector<float>& v) { std::copy(v.begin(), v.end(), &values[0].x); });
  };
  state("particle_q", scene.q, q, 2e-4);
  state("particle_qd", scene.qd, qd, 1e-2);
  state("particle_f", scene.f, f, 2e-2);
  const auto numbers = [&](const char* name, const DeviceArray<float>& array,
                           const DeviceArray<float>& bars, double size) {
    DeviceArray<float> handle = array;
    Along(size).check(
        name, array.to_host(), bars.to_host(), scene, step,
        [&](const std::vector<float>& v) { handle.copy_from_host(std::span<const float>(v)); });
  };
  numbers("particle_spring_stiffness", m.particle_spring_stiffness, ke, 4.0);
  numbers("particle_spring_damping", m.particle_spring_damping, kd, 0.1);
  numbers("particle_spring_rest_length", m.particle_spring_rest_length, rest, 0.01);
  numbers("particle_tri_activation", scene.control.particle_tri_activation, tri_act, 0.01);
  numbers("particle_edge_rest_angle", m.particle_edge_rest_angle, angle, 0.01);
  numbers("particle_tet_activation", scene.control.particle_tet_activation, tet_act, 0.01);
  numbers("particle_tet_material", m.particle_tet_material, tet, 1.0);
  // Columns are tested one by one, because their units differ.
  const auto column = [&](const char* name, const DeviceArray<float>& array,
                          const DeviceArray<float>& bars, size_t width, size_t c, double size) {
    std::vector<float> own, by;
    std::vector<size_t> places;  // materials that are 0 stay so
    const std::vector<float> all = array.to_host();
    for (size_t i = c; i < all.size(); i += width) {
      if (all[i] == 0.0f) continue;
      own.push_back(all[i]);
      by.push_back(bars.data()[i]);
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

// The previous velocity is chosen so that the part of gravity is not clamped at 0 or 1. Every third
// particle has no previous velocity.
TEST(DifferentiableVbd, TheAdaptiveGuessHasGradientsByAllThatItReads) {
  EverythingScene scene;
  const size_t n = scene.q.size();
  const VbdOptions options = {.iterations = 1, .initial_guess = VbdInitialGuess::Adaptive};
  DifferentiableVbd step(scene.model, options);
  const float gh = 9.81f / 60.0f;
  for (size_t p = 0; p < n; ++p) {
    const float part = 0.5f + 0.3f * std::sin(static_cast<float>(p));
    const Vec3f v = scene.qd[p];
    scene.last.push_back({v.x + 0.1f, v.y - 0.2f, v.z + gh * part, p % 3 == 0 ? 0.0f : 1.0f});
  }
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), f = zeros<Vec3f>(n),
             gravity = zeros<Vec3f>(scene.model->gravity.rows());
  const auto last_rows = zeros<float>(4 * n), mass = zeros<float>(n);
  step.backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd),
                {.particle_q = q,
                 .particle_qd = qd,
                 .particle_f = f,
                 .last_velocity = last_rows,
                 .gravity = gravity,
                 .particle_mass = mass});
  const std::vector<float> last = last_rows.to_host();
  for (size_t p = 0; p < n; ++p) {
    EXPECT_EQ(last[4 * p + 3], 0.0f);
    EXPECT_EQ(last[4 * p + 2] == 0.0f, p % 3 == 0 || scene.model->particle_mass.data()[p] == 0.0f);
  }
  const auto state = [&](const char* name, float* values, size_t count,
                         const std::vector<float>& bars, double size) {
    Along(size).check(name, {values, values + count}, bars, scene, step,
                      [&](const std::vector<float>& v) { std::copy(v.begin(), v.end(), values); });
  };
  const auto bars = [](const DeviceArray<Vec3f>& rows) {
    return std::vector<float>(flat(rows).begin(), flat(rows).end());
  };
  state("particle_q", &scene.q[0].x, 3 * n, bars(q), 2e-4);
  state("particle_qd", &scene.qd[0].x, 3 * n, bars(qd), 1e-2);
  state("particle_f", &scene.f[0].x, 3 * n, bars(f), 2e-2);
  // The flags stay constant.
  std::vector<float> velocities, by_velocities;
  for (size_t k = 0; k < 4 * n; ++k)
    if (k % 4 != 3) {
      velocities.push_back((&scene.last[0].x)[k]);
      by_velocities.push_back(last[k]);
    }
  Along(1e-2).check("last_velocity", velocities, by_velocities, scene, step,
                    [&](const std::vector<float>& v) {
                      for (size_t k = 0; k < v.size(); ++k) (&scene.last[k / 3].x)[k % 3] = v[k];
                    });
  DeviceArray<Vec3f> field = scene.model->gravity;
  Along(0.05).check("gravity", bars(field), bars(gravity), scene, step,
                    [&](const std::vector<float>& v) {
                      std::vector<Vec3f> rows(v.size() / 3);
                      std::copy(v.begin(), v.end(), &rows[0].x);
                      field.copy_from_host(std::span<const Vec3f>(rows));
                    });

  // Forwards along the velocities before and those now, the same: <J d, w> = <d, J^T w>.
  const auto q_slope = zeros<Vec3f>(n), qd_slope = zeros<Vec3f>(n);
  std::vector<float> along(4 * n);
  std::vector<Vec3f> along_qd(n);
  double expected = 0.0, found = 0.0, size = 0.0;
  for (size_t k = 0; k < 4 * n; ++k) {
    along[k] = k % 4 == 3 ? 0.0f : std::sin(0.7f * static_cast<float>(k));
    expected += static_cast<double>(along[k]) * static_cast<double>(last[k]);
  }
  for (size_t k = 0; k < 3 * n; ++k) {
    (&along_qd[0].x)[k] = std::sin(1.3f * static_cast<float>(k));
    const double term = static_cast<double>((&along_qd[0].x)[k]) * flat(qd)[k];
    expected += term;
    size += std::abs(term);
  }
  step.tangent(scene.inputs(), {.particle_qd = rows_of(along_qd), .last_velocity = rows_of(along)},
               q_slope, qd_slope);
  for (size_t k = 0; k < 3 * n; ++k)
    found += static_cast<double>(flat(q_slope)[k]) * (&scene.w_q[0].x)[k] +
             static_cast<double>(flat(qd_slope)[k]) * (&scene.w_qd[0].x)[k];
  EXPECT_NEAR(found, expected, 1e-5 * size);

  // A solution has no gradient with respect to the guess.
  DifferentiableVbd solved(scene.model,
                           {.iterations = 20, .initial_guess = VbdInitialGuess::Adaptive},
                           {.implicit = true});
  const auto by_last = rows_of(std::vector<float>(4 * n, 1.0f));
  solved.backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd),
                  {.last_velocity = by_last});
  EXPECT_EQ(by_last.to_host(), std::vector<float>(4 * n));
}

TEST(DifferentiableVbd, GradientsHaveTheSameBitsForAnyThreadsAndInstructionSet) {
  EverythingScene scene;
  const size_t n = scene.q.size();
  const int before = num_threads();
  std::vector<std::vector<Vec3f>> all;
  const auto run = [&] {
    DifferentiableVbd step(scene.model, {.iterations = 4});
    const auto q = zeros<Vec3f>(n);
    step.backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd), {.particle_q = q});
    all.push_back(q.to_host());
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

TEST(DifferentiableVbd, OptionsWithoutAGradientAreRefusedByName) {
  const auto model = EverythingScene::make();
  EXPECT_ERROR(DifferentiableVbd(model, {.acceleration = 0.5f}), ErrorKind::NotImplemented,
               "acceleration");
  EXPECT_ERROR(DifferentiableVbd(model, {.tolerance = 0.5f}), ErrorKind::NotImplemented,
               "tolerance");
  EXPECT_ERROR(DifferentiableVbd(model, {.safeguard = true}), ErrorKind::NotImplemented,
               "safeguard");
}

}  // namespace
}  // namespace novaphy
