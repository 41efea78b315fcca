// The derivatives of a step of VBD, unrolled and implicit, with respect to every input. Tangents
// are compared with differences of the step, and with adjoints.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "everything_scene.h"
#include "newton_scene.h"
#include "novaphy/core/parallel.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::EverythingScene;
using testing::NewtonVbdScene;
using testing::Npz;
using testing::rows_of;
using testing::zeros;

// One array that a step reads: its values, and where its derivatives are.
struct Input {
  const char* name;
  std::vector<float> values;
  std::function<void(const std::vector<float>&)> write;
  Array VbdStepDerivatives::*derivative;
  double step;     // step of the differences
  size_t columns;  // columns of a row; `column` is the one that moves, or -1: all
  int column = -1;
};

std::vector<Input> inputs_of(EverythingScene& scene) {
  std::vector<Input> all;
  const auto vectors = [&](const char* name, std::vector<Vec3f>& rows,
                           Array VbdStepDerivatives::*derivative, double step) {
    float* const first = &rows[0].x;
    all.push_back({name,
                   {first, first + 3 * rows.size()},
                   [first](const std::vector<float>& v) { std::copy(v.begin(), v.end(), first); },
                   derivative,
                   step,
                   3});
  };
  const auto numbers = [&](const char* name, const Array& array,
                           Array VbdStepDerivatives::*derivative, double step, size_t columns = 1,
                           int column = -1) {
    Input input = {name, {}, {}, derivative, step, columns, column};
    input.values.resize(array.bytes() / sizeof(float));
    array.copy_to_host(input.values.data(), array.bytes());
    input.write = [own = array](const std::vector<float>& v) mutable {
      own.copy_from_host(v.data(), v.size() * sizeof(float));
    };
    all.push_back(std::move(input));
  };
  using D = VbdStepDerivatives;
  const Model& m = *scene.model;
  const Control& c = scene.control;
  vectors("particle_q", scene.q, &D::particle_q, 2e-4);
  vectors("particle_qd", scene.qd, &D::particle_qd, 1e-2);
  vectors("particle_f", scene.f, &D::particle_f, 2e-2);
  if (!scene.targets.empty()) vectors("targets", scene.targets, &D::targets, 1e-3);
  numbers("gravity", m.gravity, &D::gravity, 0.5, 3);
#define NUMBERS(name, array, ...) numbers(#name, array, &D::name, __VA_ARGS__)
  NUMBERS(particle_mass, m.particle_mass, 1e-3);
  NUMBERS(particle_radius, m.particle_radius, 2e-4);
  NUMBERS(particle_spring_stiffness, m.particle_spring_stiffness, 4.0);
  NUMBERS(particle_spring_damping, m.particle_spring_damping, 0.1);
  NUMBERS(particle_spring_rest_length, m.particle_spring_rest_length, 0.01);
  NUMBERS(particle_tri_pose, m.particle_tri_pose, 0.05, 4);
  NUMBERS(particle_tri_area, m.particle_tri_area, 2e-4);
  for (const int column : {0, 1, 2})
    NUMBERS(particle_tri_material, m.particle_tri_material, column < 2 ? 1.0 : 0.02, 5, column);
  NUMBERS(particle_tri_activation, c.particle_tri_activation, 0.01);
  for (const int column : {0, 1})
    NUMBERS(particle_edge_material, m.particle_edge_material, column == 0 ? 0.05 : 2e-3, 2, column);
  NUMBERS(particle_edge_rest_angle, m.particle_edge_rest_angle, 0.01);
  NUMBERS(particle_edge_rest_length, m.particle_edge_rest_length, 5e-3);
  NUMBERS(particle_tet_pose, m.particle_tet_pose, 0.05, 9);
  for (const int column : {0, 1, 2})
    NUMBERS(particle_tet_material, m.particle_tet_material, column < 2 ? 5.0 : 0.3, 3, column);
  NUMBERS(particle_tet_activation, c.particle_tet_activation, 0.01);
  NUMBERS(shape_margin, m.shape_margin, 2e-4);
  NUMBERS(shape_material_ke, m.shape_material_ke, 4.0);
  NUMBERS(shape_material_kd, m.shape_material_kd, 0.05);
  NUMBERS(shape_material_mu, m.shape_material_mu, 0.02);
#undef NUMBERS
  return all;
}

// Returns a direction of unit size. Values that are 0 (elements or materials without effect) stay
// 0.
std::vector<float> direction_of(const Input& input, bool everything) {
  std::vector<float> d(input.values.size());
  for (size_t i = 0; i < d.size(); ++i) {
    if (input.column >= 0 && i % input.columns != static_cast<size_t>(input.column)) continue;
    if (!everything && input.values[i] == 0.0f) continue;
    d[i] = std::sin(1.0f + 2.7f * static_cast<float>(i));
  }
  return d;
}

double dot(const std::vector<Vec3f>& a, const std::vector<Vec3f>& b) {
  double sum = 0.0;
  for (size_t p = 0; p < a.size(); ++p)
    sum += static_cast<double>(a[p].x) * b[p].x + static_cast<double>(a[p].y) * b[p].y +
           static_cast<double>(a[p].z) * b[p].z;
  return sum;
}
double size_of(const std::vector<Vec3f>& a) { return std::sqrt(dot(a, a)); }

enum class Kind { Unrolled, Coarse, Implicit };

class VbdDerivatives : public ::testing::TestWithParam<Kind> {
 protected:
  VbdDerivatives() : scene(implicit() ? 0.0f : 1.0f) {
    const auto held =
        static_cast<size_t>(DifferentiableVbd(scene.model, {.iterations = 1}).kinematic_count());
    const float* mass = scene.model->particle_mass.data();
    for (size_t p = 0; p < scene.q.size(); ++p)
      if (mass[p] == 0.0f)
        scene.targets.push_back(scene.q[p] +
                                Vec3f{0.01f, 0.0f, 0.005f * static_cast<float>(p % 3)});
    EXPECT_EQ(scene.targets.size(), held);
  }
  static bool implicit() { return GetParam() == Kind::Implicit; }
  // The stages of a Newton that has to reach the rounding of float32. Few iterations with coarse
  // steps, whose matrix then has a part in the derivatives.
  std::unique_ptr<DifferentiableVbd> make(double tolerance = 1e-6) const {
    return std::make_unique<DifferentiableVbd>(
        scene.model,
        VbdOptions{.iterations = implicit()                   ? 20
                                 : GetParam() == Kind::Coarse ? 3
                                                              : 6,
                   .coarse = GetParam() == Kind::Coarse},
        VbdGradientOptions{.implicit = implicit(), .tolerance = static_cast<float>(tolerance)});
  }
  EverythingScene scene;
};

TEST_P(VbdDerivatives, ForwardsTheyAreThoseOfDifferencesByEveryInput) {
  ASSERT_GT(scene.contacts->active_soft_contact_count(), 0);
  const auto step = make();
  const size_t n = scene.q.size();
  int checked = 0;
  for (Input& input : inputs_of(scene)) {
    const std::string name = std::string(input.name) + " " + std::to_string(input.column);
    // A contact that begins changes the matrix of coarse steps at once.
    if (GetParam() == Kind::Coarse &&
        (name.starts_with("particle_q") || name.find("radius") != name.npos ||
         name.find("margin") != name.npos))
      input.step *= 0.3;
    const std::vector<float> d =
        direction_of(input, input.column < 0 && std::string_view(input.name) != "particle_mass");
    const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), slope_rows = zeros<Vec3f>(n);
    VbdStepDerivatives tangents;
    tangents.*input.derivative = rows_of(d);
    step->tangent(scene.inputs(), tangents, slope_rows, qd);
    const std::vector<Vec3f> slope = slope_rows.to_host();
    std::vector<Vec3f> sides[2];
    // A damping of 0 may only grow.
    const bool one_sided = implicit() && name.starts_with("shape_material_kd");
    const double back = one_sided ? 0.0 : -input.step, width = input.step - back;
    for (int side = 0; side < 2; ++side) {
      std::vector<float> moved = input.values;
      for (size_t i = 0; i < moved.size(); ++i)
        moved[i] += static_cast<float>(side == 0 ? input.step : back) * d[i];
      input.write(moved);
      step->forward(scene.inputs(), q, qd);
      sides[side] = q.to_host();
    }
    input.write(input.values);
    std::vector<Vec3f> error(n), expected(n);
    for (size_t p = 0; p < n; ++p) {
      expected[p] = (sides[0][p] - sides[1][p]) * static_cast<float>(1.0 / width);
      error[p] = slope[p] - expected[p];
    }
    // A part of a hundredth, or the rounding of the positions of the two sides.
    const double rounding = 2e-7 * std::sqrt(static_cast<double>(n)) / input.step;
    EXPECT_LT(size_of(error), 1e-2 * size_of(expected) + rounding) << name;
    EXPECT_GT(size_of(expected), 5.0 * rounding) << name << ": too small to tell";
    ++checked;
  }
  EXPECT_EQ(checked, 29);
}

TEST_P(VbdDerivatives, ForwardsAndBackwardsAreTransposed) {
  const auto step = make();
  const size_t n = scene.q.size();
  for (const Input& input : inputs_of(scene)) {
    const std::vector<float> d = direction_of(input, true);
    const auto slope_rows = zeros<Vec3f>(n), qd_rows = zeros<Vec3f>(n);
    VbdStepDerivatives tangents;
    tangents.*input.derivative = rows_of(d);
    step->tangent(scene.inputs(), tangents, slope_rows, qd_rows);
    const std::vector<Vec3f> slope = slope_rows.to_host(), qd_slope = qd_rows.to_host();
    const double forwards = dot(scene.w_q, slope) + dot(scene.w_qd, qd_slope);
    const auto bar_rows = zeros<float>(d.size());
    VbdStepDerivatives gradients;
    gradients.*input.derivative = bar_rows;
    step->backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd), gradients);
    const std::vector<float> bar = bar_rows.to_host();
    double backwards = 0.0;
    for (size_t i = 0; i < d.size(); ++i)
      backwards += static_cast<double>(bar[i]) * static_cast<double>(d[i]);
    const double scale =
        size_of(scene.w_q) * size_of(slope) + size_of(scene.w_qd) * size_of(qd_slope);
    EXPECT_NEAR(forwards, backwards, 1e-5 * scale) << input.name << " " << input.column;
    EXPECT_GT(scale, 0.0) << input.name;
  }
}

TEST_P(VbdDerivatives, HaveTheSameBitsForAnyThreads) {
  const size_t n = scene.q.size();
  const int before = num_threads();
  std::vector<std::vector<Vec3f>> all;
  for (const int threads : {1, 2, 7}) {
    set_num_threads(threads);
    const auto step = make(1e-4);
    const auto q = zeros<Vec3f>(n), slope = zeros<Vec3f>(n), qd_slope = zeros<Vec3f>(n);
    step->backward(scene.inputs(), rows_of(scene.w_q), rows_of(scene.w_qd), {.particle_q = q});
    step->tangent(scene.inputs(), {.particle_qd = rows_of(scene.qd)}, slope, qd_slope);
    all.push_back(q.to_host());
    all.back().insert(all.back().end(), slope.data(), slope.data() + n);
  }
  set_num_threads(before);
  for (const auto& rows : all) EXPECT_TRUE(testing::same_bits<Vec3f>(rows, all[0]));
}

INSTANTIATE_TEST_SUITE_P(Kinds, VbdDerivatives,
                         ::testing::Values(Kind::Unrolled, Kind::Coarse, Kind::Implicit),
                         [](const auto& test) {
                           return std::string(test.param == Kind::Unrolled ? "Unrolled"
                                              : test.param == Kind::Coarse ? "Coarse"
                                                                           : "Implicit");
                         });

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
std::span<const float> flat(const DeviceArray<Vec3f>& rows) {
  return {&rows.data()->x, 3 * rows.rows()};
}

// The solution of Newton's substep 60 and its derivative, which the file has in double precision.
class ImplicitVbd : public ::testing::TestWithParam<const char*> {};

TEST_P(ImplicitVbd, DerivativesAreThoseOfTheSolution) {
  const std::string name = GetParam();
  const NewtonVbdScene scene(("newton_vbd_" + name + ".npz").c_str());
  const Npz file = testing::golden("vbd_gradients.npz");
  const auto t = static_cast<size_t>(file[name + "_t"].scalar<int32_t>());
  const size_t n = scene.particles();
  const Contacts contacts = scene.contacts(t);
  const VbdStepInputs in = {.q = rows_of(scene.q(t)),
                            .qd = rows_of(scene.file["qd_60"].as<Vec3f>()),
                            .f = zeros<Vec3f>(n),
                            .contacts = &contacts,
                            .dt = scene.dt()};
  DifferentiableVbd step(scene.model, {.iterations = 20}, {.implicit = true, .tolerance = 1e-5f});
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), q_bar = zeros<Vec3f>(n),
             qd_bar = zeros<Vec3f>(n);
  step.forward(in, q, qd);
  // The file damps the whole approach of contacts that begin in the step (particle_contact_law.h).
  EXPECT_LT(relative_error(flat(q), file[name + "_star_q"].as<double>()), 3e-6);
  const auto tet_rows = zeros<float>(scene.model->particle_tet_material.to_host().size());
  step.backward(in, rows_of(file[name + "_w_q"].as<Vec3f>()),
                rows_of(file[name + "_w_qd"].as<Vec3f>()),
                {.particle_q = q_bar, .particle_qd = qd_bar, .particle_tet_material = tet_rows});
  const std::vector<float> tet_bar = tet_rows.to_host();
  EXPECT_LT(relative_error(flat(q_bar), file[name + "_implicit_grad_q"].as<double>()), 1e-3);
  EXPECT_LT(relative_error(flat(qd_bar), file[name + "_implicit_grad_qd"].as<double>()), 1e-3);
  if (!tet_bar.empty()) {
    EXPECT_LT(relative_error(tet_bar, file[name + "_implicit_grad_tet"].as<double>()), 1e-3);
  }
  const VbdGradientInfo info = step.info();
  EXPECT_EQ(info.label, "implicit");
  EXPECT_TRUE(info.converged);
  EXPECT_LE(info.primal.relative, std::max(1e-5, 2.0 * info.primal.floor));
  EXPECT_LE(info.linear_residual, 1e-5);
  EXPECT_GT(info.linear_sweeps, 0);
  RecordProperty("linear_sweeps", info.linear_sweeps);
}

INSTANTIATE_TEST_SUITE_P(Scenes, ImplicitVbd, ::testing::Values("soft", "cloth"));

TEST(ImplicitVbd, WhatIsNotSolvedIsAnErrorUnlessAllowed) {
  EverythingScene scene;
  const size_t n = scene.q.size();
  const auto q = zeros<Vec3f>(n), qd = zeros<Vec3f>(n), bar = zeros<Vec3f>(n);
  VbdGradientOptions options = {.implicit = true, .newton_iterations = 0};
  EXPECT_ERROR(
      DifferentiableVbd(scene.model, {.iterations = 2}, options).forward(scene.inputs(), q, qd),
      ErrorKind::Runtime, "the step was not solved");
  options = {.implicit = true, .krylov_sweeps = 1, .allow_unconverged = true};
  DifferentiableVbd allowed(scene.model, {.iterations = 2}, options);
  allowed.backward(scene.inputs(), rows_of(scene.w_q), Array(), {.particle_q = bar});
  EXPECT_FALSE(allowed.info().converged);
  EXPECT_GT(allowed.info().linear_residual, 1e-4);
  options = {.implicit = true, .krylov_sweeps = 1};
  DifferentiableVbd few(scene.model, {.iterations = 400}, options);
  EXPECT_ERROR(few.backward(scene.inputs(), rows_of(scene.w_q), Array(), {.particle_q = bar}),
               ErrorKind::Runtime, "the linear system of the gradient was not solved");
  EXPECT_ERROR(DifferentiableVbd(scene.model, {.iterations = 0}, {.implicit = true}),
               ErrorKind::Value, "iterations");
  EXPECT_ERROR(DifferentiableVbd(scene.model, {}, {.tolerance = 0.0f}), ErrorKind::Value,
               "gradient_tolerance");
}

}  // namespace
}  // namespace novaphy
