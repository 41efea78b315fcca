// The differentiable forces of elements have the bits of the forward solver. Their gradients by
// every input in the table of diff_elements.h agree with central differences, and satisfy the
// adjoint dot-product identity. The special cases in the formulas' head comments are tested too.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <set>
#include <utility>

#include "elements_scene.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/diff_elements.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/bits.h"

namespace novaphy::testing {
namespace {

using nova::Tensor;

// One operator: the elements that act, its function, and its inputs after particle_f.
struct Operator {
  const char* name;
  std::function<Tensor(const Model&, const std::vector<Tensor>&)> eval;
  std::function<std::vector<Tensor>(const Model&)> parameters;
};
const Operator kOperators[] = {
    {"springs",
     [](const Model& m, const std::vector<Tensor>& in) {
       return diff::eval_spring_forces_generated(m, in[0], in[1], in[2], in[3], in[4], in[5]);
     },
     [](const Model& m) -> std::vector<Tensor> {
       return {diff::model_spring_stiffness_tensor(m), diff::model_spring_damping_tensor(m),
               diff::model_spring_rest_length_tensor(m)};
     }},
    {"triangles",
     [](const Model& m, const std::vector<Tensor>& in) {
       return diff::eval_triangle_forces_generated(m, in[0], in[1], in[2], in[3], in[4]);
     },
     [](const Model& m) -> std::vector<Tensor> {
       return {diff::model_tri_activation_tensor(m), diff::model_tri_material_tensor(m)};
     }},
    {"edges",
     [](const Model& m, const std::vector<Tensor>& in) {
       return diff::eval_bending_forces_generated(m, in[0], in[1], in[2], in[3], in[4]);
     },
     [](const Model& m) -> std::vector<Tensor> {
       return {diff::model_edge_material_tensor(m), diff::model_edge_rest_angle_tensor(m)};
     }},
    {"tetrahedra",
     [](const Model& m, const std::vector<Tensor>& in) {
       return diff::eval_tetrahedra_forces_generated(m, in[0], in[1], in[2], in[3], in[4]);
     },
     [](const Model& m) -> std::vector<Tensor> {
       return {diff::model_tet_activation_tensor(m), diff::model_tet_material_tensor(m)};
     }},
};

std::vector<Tensor> inputs_of(const Operator& op, const Model& m) {
  std::vector<Tensor> in = {Tensor::view(m.particle_q), Tensor::view(m.particle_qd),
                            random_tensor({m.particle_count(), 3}, 3)};
  for (Tensor& t : op.parameters(m)) in.push_back(std::move(t));
  return in;
}

class ElementOperator : public ::testing::TestWithParam<Operator> {
 protected:
  std::shared_ptr<Model> model = make_elements_model();
  std::vector<Tensor> in = inputs_of(GetParam(), *model);
  Tensor eval() { return GetParam().eval(*model, in); }
};
INSTANTIATE_TEST_SUITE_P(Elements, ElementOperator, ::testing::ValuesIn(kOperators),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(ElementOperator, HasTheGradientOfDifferences) {
  const Tensor weights = random_tensor({model->particle_count(), 3}, 5);
  const auto result =
      nova::gradcheck([&](const std::vector<Tensor>&) { return nova::dot(eval(), weights); }, in,
                      {.epsilon = 2e-3f, .rtol = 4e-3f, .atol = 2e-3f});
  EXPECT_TRUE(result.ok) << result.worst << ", relative " << result.max_rel_error;
}

// <J u, v> = <u, J^T v>, with J u by central differences along u.
TEST_P(ElementOperator, KeepsTheDotProductIdentity) {
  const Tensor v = random_tensor({model->particle_count(), 3}, 11);
  for (const Tensor& x : in) x.set_requires_grad(true);
  nova::Tape tape;
  {
    const nova::TapeScope scope(tape);
    tape.backward(eval(), v);
  }
  const nova::NoGrad no_grad;
  double right = 0.0;
  std::vector<std::vector<float>> before, along;
  for (size_t k = 0; k < in.size(); ++k) {
    before.push_back(in[k].to_host());
    along.push_back(random_tensor(in[k].shape(), 20 + static_cast<uint32_t>(k)).to_host());
    const std::vector<float> g = in[k].grad().to_host();
    for (size_t i = 0; i < g.size(); ++i)
      right += static_cast<double>(g[i]) * static_cast<double>(along[k][i]);
  }
  constexpr float kStep = 1e-3f;
  const auto at = [&](float h) {
    for (size_t k = 0; k < in.size(); ++k) {
      std::vector<float> x = before[k];
      for (size_t i = 0; i < x.size(); ++i) x[i] += h * along[k][i];
      in[k].copy_from_host(x.data(), x.size() * sizeof(float));
    }
    return eval().to_host();
  };
  const std::vector<float> up = at(kStep), down = at(-kStep), seed = v.to_host();
  at(0.0f);
  double left = 0.0, scale = 0.0;
  for (size_t i = 0; i < up.size(); ++i) {
    const double term = (static_cast<double>(up[i]) - static_cast<double>(down[i])) /
                        (2.0 * static_cast<double>(kStep)) * static_cast<double>(seed[i]);
    left += term;
    scale += std::fabs(term);
  }
  EXPECT_GT(scale, 0.0);
  EXPECT_NEAR(left, right, 2e-3 * scale);
}

// Stored, and then added to. Where the sum is compiled, so is everything.
TEST_P(ElementOperator, HasTheSameGradientsWhateverElseIsAskedFor) {
  const Tensor weights = random_tensor({model->particle_count(), 3}, 7);
  const auto gradients = [&](uint32_t wanted, nova::KeepGradients keep) {
    for (size_t k = 0; k < in.size(); ++k) {
      in[k].zero_grad();
      in[k].set_requires_grad((wanted >> k & 1) != 0);
    }
    for (int time = 0; time < 2; ++time) {
      nova::Tape tape(keep);
      const nova::TapeScope scope(tape);
      tape.backward(eval(), weights);
    }
    std::vector<std::vector<float>> found(in.size());
    for (size_t k = 0; k < in.size(); ++k)
      if ((wanted >> k & 1) != 0) found[k] = in[k].grad().to_host();
    return found;
  };
  std::set<uint64_t> before;  // made by other tests of this process
  for (const nova::KernelInfo& info : nova::kernel_info()) before.insert(info.hash);
  const uint32_t all = (uint32_t{1} << in.size()) - 1;
  const auto expected = gradients(all, nova::KeepGradients::All);
  for (const auto keep : {nova::KeepGradients::All, nova::KeepGradients::Leaves})
    for (uint32_t wanted = 1; wanted <= all; ++wanted) {
      const auto found = gradients(wanted, keep);
      for (size_t k = 0; k < in.size(); ++k) {
        if ((wanted >> k & 1) == 0) continue;
        EXPECT_EQ(found[k], expected[k]) << "input " << k << " of " << wanted;
      }
    }
  const std::vector<nova::KernelInfo> used = nova::kernel_info();
  const bool native = std::any_of(used.begin(), used.end(), [](const nova::KernelInfo& info) {
    return info.name == "sum_element_forces" && info.how == "native";
  });
  for (const nova::KernelInfo& info : used)
    if (native && !before.contains(info.hash)) {
      EXPECT_EQ(info.how, "native") << info.name;
    }
}

// All kinds one after the other, against one step of the forward solver.
TEST(Elements, ForcesHaveTheBitsOfTheForwardEngine) {
  const auto model = make_elements_model();
  SimState state = model->state(), next = model->state();
  const Tensor applied = random_tensor({model->particle_count(), 3}, 3);
  state.particle_f.copy_from_host(applied.to_host().data(), state.particle_f.bytes());
  SolverSemiImplicit solver(model);
  solver.step(state, next, nullptr, nullptr, 0.01f);
  Tensor f = applied;
  for (const Operator& op : kOperators) {
    std::vector<Tensor> in = inputs_of(op, *model);
    in[2] = f;
    f = op.eval(*model, in);
  }
  const std::vector<Vec3f> forces = state.particle_f.to_host();
  EXPECT_TRUE(same_bits<float>(
      f.to_host(), std::span(reinterpret_cast<const float*>(forces.data()), forces.size() * 3)));
}

// A model of one element at given positions and velocities.
struct One {
  std::shared_ptr<Model> model;
  std::vector<Tensor> in;
  const Operator& op;

  One(const Operator& o, const std::function<void(ModelBuilder&)>& add, std::vector<Vec3f> rest,
      std::vector<Vec3f> q, std::vector<Vec3f> qd)
      : op(o) {
    ModelBuilder builder(Axis::Z, 0.0f);
    for (const Vec3f& x : rest) builder.add_particle(x, {}, 1.0f);
    add(builder);
    model = builder.finalize(Device::cpu());
    model->particle_q.copy_from_host(std::span<const Vec3f>(q));
    model->particle_qd.copy_from_host(std::span<const Vec3f>(qd));
    in = inputs_of(op, *model);
    in[2].fill_(0.0f);
  }
  std::vector<float> forces() const { return op.eval(*model, in).to_host(); }
  // Gradients of a weighted sum of the forces, by input; all finite.
  std::vector<std::vector<float>> gradients(uint32_t seed = 5) const {
    for (const Tensor& x : in) x.set_requires_grad(true);
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    const Tensor out = op.eval(*model, in);
    tape.backward(out, random_tensor(out.shape(), seed));
    std::vector<std::vector<float>> all;
    for (const Tensor& x : in) {
      all.push_back(x.grad().to_host());
      for (const float g : all.back()) EXPECT_TRUE(std::isfinite(g)) << op.name;
    }
    return all;
  }
  void expect_differences(float rtol = 4e-3f) const {
    const Tensor weights = random_tensor({model->particle_count(), 3}, 5);
    const auto result = nova::gradcheck(
        [&](const std::vector<Tensor>&) { return nova::dot(op.eval(*model, in), weights); }, in,
        {.epsilon = 1e-3f, .rtol = rtol, .atol = 2e-3f});
    EXPECT_TRUE(result.ok) << op.name << ": " << result.worst;
  }
};

const std::vector<Vec3f> kTetrahedron = {
    {0.0f, 0.0f, 0.0f}, {1.0f, 0.1f, 0.0f}, {0.2f, 0.9f, 0.1f}, {0.1f, 0.2f, 1.1f}};
const std::vector<Vec3f> kSlow = {
    {0.3f, -0.2f, 0.1f}, {-0.4f, 0.1f, 0.2f}, {0.2f, 0.5f, -0.3f}, {0.1f, -0.1f, 0.4f}};
const Operator &kSprings = kOperators[0], &kTriangles = kOperators[1], &kEdges = kOperators[2],
               &kTetrahedra = kOperators[3];

std::function<void(ModelBuilder&)> tetrahedron(float mu, float lambda, float damp) {
  return [=](ModelBuilder& b) { b.add_tetrahedron(0, 1, 2, 3, mu, lambda, damp); };
}

TEST(Tetrahedron, AtRestHasNoForceAndTheRightGradient) {
  const One one(kTetrahedra, tetrahedron(3.0f, 5.0f, 0.0f), kTetrahedron, kTetrahedron,
                std::vector<Vec3f>(4));
  for (const float f : one.forces()) EXPECT_NEAR(f, 0.0f, 2e-6f);
  one.expect_differences();
}
TEST(Tetrahedron, InvertedAndFlatOnesAreSmooth) {
  std::vector<Vec3f> inverted = kTetrahedron, flat = kTetrahedron;
  inverted[3].z = -0.8f;
  flat[1].z = flat[2].z = flat[3].z = 0.0f;
  for (const auto& q : {inverted, flat}) {
    const One one(kTetrahedra, tetrahedron(3.0f, 5.0f, 0.6f), kTetrahedron, q, kSlow);
    one.gradients();
    one.expect_differences();
  }
  std::vector<Vec3f> point(4);  // F = 0
  One(kTetrahedra, tetrahedron(3.0f, 5.0f, 0.6f), kTetrahedron, point, kSlow).gradients();
}
TEST(Tetrahedron, ZeroVolumetricStiffnessIsAFiniteLimit) {
  std::vector<Vec3f> q = kTetrahedron;
  q[3].z = 1.4f;
  const One none(kTetrahedra, tetrahedron(0.0f, 0.0f, 0.0f), kTetrahedron, q, kSlow);
  for (const float f : none.forces()) EXPECT_EQ(f, 0.0f);
  none.gradients();
  const One shear(kTetrahedra, tetrahedron(3.0f, 0.0f, 0.0f), kTetrahedron, q, kSlow);
  double norm = 0.0;
  for (const float f : shear.forces()) norm += static_cast<double>(f) * static_cast<double>(f);
  EXPECT_GT(norm, 0.1);  // the deviatoric part stays
  const auto gradients = shear.gradients();
  EXPECT_NE(gradients[4][0], 0.0f);  // k_mu
  EXPECT_EQ(gradients[4][1], 0.0f);  // k_lambda: exactly 0
  EXPECT_EQ(gradients[3][0], 0.0f);  // activation: of a stiffness of 0
  // The force lacks the volumetric part: it is the force of a small lambda without its term.
  const One damped(kTetrahedra, tetrahedron(0.0f, 0.0f, 0.5f), kTetrahedron, q, kSlow);
  norm = 0.0;
  for (const float f : damped.forces()) norm += std::fabs(static_cast<double>(f));
  EXPECT_GT(norm, 0.01);  // damping stays
}

const std::vector<Vec3f> kTriangle = {{0.0f, 0.0f, 0.0f}, {1.0f, 0.1f, 0.0f}, {0.2f, 0.9f, 0.1f}};
std::function<void(ModelBuilder&)> triangle(const TriMaterial& material) {
  return [=](ModelBuilder& b) { b.add_triangle(0, 1, 2, material); };
}

TEST(Triangle, AtZeroVelocityDragAndLiftAreNothingAndPassNothing) {
  const One one(kTriangles, triangle({0.0f, 0.0f, 0.0f, 2.0f, 3.0f}), kTriangle, kTriangle,
                std::vector<Vec3f>(3));
  for (const float f : one.forces()) EXPECT_EQ(f, 0.0f);
  const auto gradients = one.gradients();
  for (const size_t input : {size_t{0}, size_t{1}})
    for (const float g : gradients[input]) EXPECT_EQ(g, 0.0f);
  EXPECT_EQ(gradients[4][3], 0.0f);  // drag
  EXPECT_EQ(gradients[4][4], 0.0f);  // lift
}
TEST(Triangle, DragAndLiftInMotionHaveTheGradientOfDifferences) {
  const std::vector<Vec3f> v = {{0.8f, 0.3f, 0.5f}, {0.9f, 0.2f, 0.7f}, {0.7f, 0.4f, 0.6f}};
  One(kTriangles, triangle({0.0f, 0.0f, 0.0f, 2.0f, 3.0f}), kTriangle, kTriangle, v)
      .expect_differences();
  // Drag is against the velocity.
  const One drag(kTriangles, triangle({0.0f, 0.0f, 0.0f, 2.0f, 0.0f}), kTriangle, kTriangle, v);
  const std::vector<float> f = drag.forces();
  float power = 0.0f;
  for (size_t k = 0; k < 3; ++k)
    power += f[3 * k] * v[k].x + f[3 * k + 1] * v[k].y + f[3 * k + 2] * v[k].z;
  EXPECT_LT(power, -0.1f);
}
TEST(Triangle, MotionAlongTheNormalAndNoAreaAreFinite) {
  const std::vector<Vec3f> flat = {{0.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}};
  const std::vector<Vec3f> along(3, Vec3f{0.0f, 0.0f, 0.5f});
  const TriMaterial all = {1.0f, 2.0f, 0.3f, 2.0f, 3.0f};
  One(kTriangles, triangle(all), flat, flat, along).gradients();
  const std::vector<Vec3f> line = {{0.0f, 0.0f, 0.0f}, {1.0f, 0.0f, 0.0f}, {2.0f, 0.0f, 0.0f}};
  One(kTriangles, triangle(all), flat, line, along).gradients();
}
TEST(Triangle, WithoutAreaStiffnessTheAreaForceIsOff) {
  std::vector<Vec3f> q = kTriangle;
  q[1].x = 1.3f;
  const One one(kTriangles, triangle({2.0f, 0.0f, 0.5f, 0.0f, 0.0f}), kTriangle, q,
                {kSlow[0], kSlow[1], kSlow[2]});
  const auto gradients = one.gradients();
  EXPECT_EQ(gradients[3][0], 0.0f);  // activation
  EXPECT_EQ(gradients[4][1], 0.0f);  // ka
}

// Opposite vertices 0 and 1, the edge from 2 to 3 along y.
std::vector<Vec3f> hinge(float angle) {
  return {{-1.0f, 0.4f, 0.0f},
          {std::cos(angle), 0.6f, std::sin(angle)},
          {0.0f, 0.0f, 0.0f},
          {0.0f, 1.0f, 0.0f}};
}
TEST(Hinge, StraightAndFoldedOnesHaveTheGradientOfDifferences) {
  const auto add = [](ModelBuilder& b) { b.add_edge(0, 1, 2, 3, 0.2f, EdgeMaterial{1.5f, 0.4f}); };
  for (const float angle : {0.0f, 0.7f, -0.7f, 1.5707963f, 2.9f}) {
    const One one(kEdges, add, hinge(0.0f), hinge(angle), kSlow);
    one.gradients();
    one.expect_differences(8e-3f);
  }
}
TEST(Hinge, AtRestHasNoForceToTheBit) {
  for (const float angle : {0.0f, 0.31f, -1.1f, 2.2f}) {
    const auto add = [](ModelBuilder& b) { b.add_edge(0, 1, 2, 3, {}, EdgeMaterial{1e4f, 0.0f}); };
    const One one(kEdges, add, hinge(angle), hinge(angle), std::vector<Vec3f>(4));
    for (const float f : one.forces()) EXPECT_EQ(f, 0.0f) << angle;
    EXPECT_NEAR(std::fabs(one.model->particle_edge_rest_angle.to_host()[0]), std::fabs(angle),
                1e-6f);
  }
}
TEST(Hinge, ABorderAndADegenerateHingeHaveNoForceAndPassNothing) {
  const auto border = [](ModelBuilder& b) {
    b.add_edge(0, -1, 2, 3, {}, EdgeMaterial{1.5f, 0.4f});
  };
  std::vector<Vec3f> collapsed = hinge(0.5f);
  collapsed[3] = collapsed[2];
  const auto full = [](ModelBuilder& b) { b.add_edge(0, 1, 2, 3, 0.2f, EdgeMaterial{1.5f, 0.4f}); };
  for (const One& one : {One(kEdges, border, hinge(0.5f), hinge(0.9f), kSlow),
                         One(kEdges, full, hinge(0.5f), collapsed, kSlow)}) {
    for (const float f : one.forces()) EXPECT_EQ(f, 0.0f);
    const auto gradients = one.gradients();
    for (const size_t input : {size_t{0}, size_t{1}, size_t{3}, size_t{4}})
      for (const float g : gradients[input]) EXPECT_EQ(g, 0.0f);
  }
}

TEST(Spring, EndsInOnePointHaveNoForce) {
  const auto add = [](ModelBuilder& b) { b.add_spring(0, 1, 3.0f, 0.5f); };
  const One one(kSprings, add, {{}, {1.0f, 0.0f, 0.0f}}, {{}, {}}, {kSlow[0], kSlow[1]});
  for (const float f : one.forces()) EXPECT_EQ(f, 0.0f);
  one.gradients();
}

// Without damping the forces do not depend on velocities. The damping still has a gradient.
TEST(Damping, OfZeroNeedsNoVelocitiesAndHasAGradient) {
  struct Case {
    const Operator& op;
    std::function<void(ModelBuilder&)> add;
    std::vector<Vec3f> rest, q;
    size_t input, column;  // where the damping is
  };
  std::vector<Vec3f> stretched = kTetrahedron;
  stretched[3].z = 1.4f;
  const Case cases[] = {
      {kSprings, [](ModelBuilder& b) { b.add_spring(0, 1, 3.0f, 0.0f); }, kTetrahedron, stretched,
       4, 0},
      {kEdges,
       [](ModelBuilder& b) {
         b.add_edge(0, 1, 2, 3, 0.2f, EdgeMaterial{1.5f, 0.0f});
       },
       hinge(0.0f), hinge(0.7f), 3, 1},
      {kTetrahedra, tetrahedron(3.0f, 5.0f, 0.0f), kTetrahedron, stretched, 4, 2}};
  for (const Case& c : cases) {
    SCOPED_TRACE(c.op.name);
    const One one(c.op, c.add, c.rest, c.q, kSlow);
    one.expect_differences(8e-3f);
    const auto gradients = one.gradients();
    EXPECT_GT(std::fabs(gradients[c.input][c.column]), 1e-2f);
    for (const float g : gradients[1]) EXPECT_EQ(g, 0.0f);
    const float nan = std::nanf("");
    const One lost(c.op, c.add, c.rest, c.q, std::vector<Vec3f>(4, Vec3f{nan, nan, nan}));
    EXPECT_EQ(lost.forces(), one.forces());
  }
}

TEST(TetMaterials, AreAssignedWithTheirGradients) {
  const Tensor base = random_tensor({3, 3}, 1);
  const std::vector<float> b = base.to_host();
  const Tensor own = random_tensor({6}, 2), shared = random_tensor({2}, 3);
  const std::vector<float> o = own.to_host(), s = shared.to_host();
  EXPECT_EQ(diff::assign_tet_materials_generated(own, base, 3).to_host(),
            (std::vector<float>{o[0], o[1], b[2], o[2], o[3], b[5], o[4], o[5], b[8]}));
  EXPECT_EQ(diff::assign_tet_materials_generated(shared, base, 3).to_host(),
            (std::vector<float>{s[0], s[1], b[2], s[0], s[1], b[5], s[0], s[1], b[8]}));
  EXPECT_EQ(diff::assign_tet_materials_generated(own.reshape({3, 2}), base, 3).to_host(),
            diff::assign_tet_materials_generated(own, base, 3).to_host());
  const Tensor weights = random_tensor({3, 3}, 4);
  for (const Tensor& params : {own, shared}) {
    const auto result = nova::gradcheck(
        [&](const std::vector<Tensor>& in) {
          return nova::dot(diff::assign_tet_materials_generated(in[0], in[1], 3), weights);
        },
        {params, base}, {.rtol = 2e-3f});
    EXPECT_TRUE(result.ok) << result.worst;
  }
  EXPECT_ERROR(diff::assign_tet_materials_generated(random_tensor({4}, 1), base, 3),
               ErrorKind::Value, "material_params");
  EXPECT_ERROR(diff::assign_tet_materials_generated(own, random_tensor({3, 2}, 1), 3),
               ErrorKind::Value, "base_tet_materials");
  EXPECT_ERROR(diff::assign_tet_materials_generated(Tensor({6}, nova::DType::I32), base, 3),
               ErrorKind::Type, "material_params");
}

TEST(Elements, BadInputNamesTheArgument) {
  const auto model = make_elements_model();
  for (const Operator& op : kOperators) {
    const std::vector<Tensor> good = inputs_of(op, *model);
    for (size_t k = 0; k < good.size(); ++k) {
      std::vector<Tensor> in = good;
      in[k] = random_tensor({good[k].rows() + 1, 3}, 1);
      EXPECT_ERROR(op.eval(*model, in), ErrorKind::Value, "expected {");
      in[k] = Tensor(good[k].shape(), nova::DType::I32);
      EXPECT_ERROR(op.eval(*model, in), ErrorKind::Type, "float32");
      in[k] = Tensor();
      EXPECT_ERROR(op.eval(*model, in), ErrorKind::Type, "float32");
    }
  }
}

// A kernel would read a missing row as zeros: a particle at the origin.
TEST(Elements, OfAParticleThatIsNotThereAreRefusedByNameAndEntry) {
  const auto spoil = [](Array& indices, int32_t value) {
    std::vector<int32_t> entries(indices.bytes() / sizeof(int32_t));
    indices.copy_to_host(entries.data(), indices.bytes());
    const int32_t before = std::exchange(entries[1], value);
    indices.copy_from_host(entries.data(), indices.bytes());
    return before;
  };
  const auto model = make_elements_model();
  diff::DiffSemiImplicitSolver solver(model, {.enable_tetrahedra = true,
                                              .enable_triangles = true,
                                              .enable_springs = true,
                                              .enable_bending = true});
  SimState a = model->state(), b = model->state();
  diff::Trajectory trajectory(model, 2);
  solver.step(a, b, nullptr, nullptr, 0.01f);
  const std::pair<Array*, const char*> tables[] = {
      {&model->particle_spring_indices, "model.particle_spring_indices: entry 1"},
      {&model->particle_tri_indices, "model.particle_tri_indices: entry 1"},
      {&model->particle_edge_indices, "model.particle_edge_indices: entry 1"},
      {&model->particle_tet_indices, "model.particle_tet_indices: entry 1"}};
  for (const auto& [table, text] : tables) {
    for (const int32_t bad : {-7, 9999}) {
      const int32_t good = spoil(*table, bad);
      EXPECT_ERROR(solver.step(a, b, nullptr, nullptr, 0.01f), ErrorKind::Index, text);
      EXPECT_ERROR(solver.rollout(trajectory, nullptr, nullptr, 0.01f), ErrorKind::Index, text);
      {
        nova::ScopedCapture capture;
        EXPECT_ERROR(solver.rollout(trajectory, nullptr, nullptr, 0.01f), ErrorKind::Index, text);
      }
      spoil(*table, good);
    }
  }
  const Operator& springs = kOperators[0];
  const std::vector<Tensor> in = inputs_of(springs, *model);
  springs.eval(*model, in);
  spoil(model->particle_spring_indices, -7);
  EXPECT_ERROR(springs.eval(*model, in), ErrorKind::Index,
               "model.particle_spring_indices: entry 1");
}

}  // namespace
}  // namespace novaphy::testing
