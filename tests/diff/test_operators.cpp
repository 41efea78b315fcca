// The differentiable operators. Values are compared with the float templates of the forward solver.
// Gradients by every input of the coverage tables are compared with central differences and by the
// adjoint dot-product identity.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "dynamics/golden_scene.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy::testing {
namespace {

using nova::Shape;
using nova::Tensor;

constexpr float kDt = 0.01f;

// Particles that penetrate tilted shapes of all four types, or are apart from them, away from the
// kinks of the law.
std::shared_ptr<Model> make_model() {
  ModelBuilder builder;
  const float s = std::sin(0.2f), c = std::cos(0.2f);
  ShapeConfig cfg{.ke = 60.0f, .kd = 3.0f, .kf = 2.0f, .mu = 0.4f};
  builder.add_ground_plane({.cfg = cfg});
  Transformf tilted;
  tilted.q = {s, 0.0f, 0.0f, c};
  tilted.p = {2.0f, 0.0f, 1.0f};
  cfg.ke = 80.0f;
  cfg.mu = 0.9f;
  builder.add_shape_box(-1, {.xform = tilted, .hx = 0.5f, .hy = 0.6f, .hz = 0.4f, .cfg = cfg});
  tilted.p = {-2.0f, 0.3f, 1.5f};
  builder.add_shape_sphere(-1, {.xform = tilted, .radius = 0.5f, .cfg = cfg});
  tilted.p = {0.0f, 3.0f, 1.2f};
  builder.add_shape_capsule(-1, {.xform = tilted, .radius = 0.4f, .half_height = 0.5f, .cfg = cfg});
  const Vec3f spots[] = {{0.3f, 0.2f, 0.05f}, {2.1f, 0.15f, 1.46f}, {-2.2f, 0.7f, 1.8f},
                         {0.35f, 3.2f, 1.1f}, {0.0f, -3.0f, 2.0f},  {-1.0f, -1.0f, 0.02f}};
  std::mt19937 random(7);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  for (const Vec3f& x : spots)
    builder.add_particle(x, {2.0f + u(random), -2.0f + u(random), -1.5f + 0.5f * u(random)},
                         1.5f + 0.5f * u(random), 0.12f);
  auto model = builder.finalize(Device::cpu());
  model->soft_contact_ke = 90.0f;
  model->soft_contact_kd = 2.0f;
  model->soft_contact_kf = 1.5f;
  model->soft_contact_mu = 0.6f;
  return model;
}

Tensor random_tensor(Shape shape, uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> u(-1.0f, 1.0f);
  int64_t n = 1;
  for (int64_t d : shape) n *= d;
  std::vector<float> values(static_cast<size_t>(n));
  for (float& v : values) v = u(random);
  return Tensor::from_host(std::span<const float>(values), std::move(shape));
}

// A scalar that depends on every value.
Tensor weighted(const Tensor& t, uint32_t seed) {
  return nova::dot(t, random_tensor(t.shape(), seed));
}

class Operators : public ::testing::Test {
 protected:
  Operators()
      : model(make_model()),
        q(Tensor::view(model->particle_q)),
        qd(Tensor::view(model->particle_qd)),
        f(random_tensor(q.shape(), 3)) {
    inputs = {q,
              qd,
              f,
              diff::model_particle_mass_tensor(*model),
              diff::model_particle_radius_tensor(*model),
              diff::model_gravity_tensor(*model),
              diff::model_shape_material_ke_tensor(*model),
              diff::model_shape_material_kd_tensor(*model),
              diff::model_shape_material_kf_tensor(*model),
              diff::model_shape_material_mu_tensor(*model)};
  }

  // Central differences for all inputs at once. Masses are edited in place; their inverse follows.
  void expect_gradients(const std::function<Tensor()>& value) {
    const auto result = nova::gradcheck([&](const std::vector<Tensor>&) { return value(); }, inputs,
                                        {.epsilon = 1e-3f, .rtol = 5e-3f, .atol = 2e-3f});
    EXPECT_TRUE(result.ok) << result.worst << ", relative " << result.max_rel_error;
  }

  // <J u, v> = <u, J^T v>, with J u by central differences along u.
  void expect_dot_product_identity(const std::function<Tensor()>& output) {
    const Tensor v = random_tensor(output().shape(), 11);
    for (const Tensor& x : inputs) x.set_requires_grad(true);
    nova::Tape tape;
    {
      const nova::TapeScope scope(tape);
      tape.backward(output(), v);
    }
    double right = 0.0;
    std::vector<std::vector<float>> before, along;
    for (size_t k = 0; k < inputs.size(); ++k) {
      before.push_back(inputs[k].to_host());
      along.push_back(random_tensor(inputs[k].shape(), 20 + static_cast<uint32_t>(k)).to_host());
      const std::vector<float> g = inputs[k].grad().to_host();
      for (size_t i = 0; i < g.size(); ++i)
        right += static_cast<double>(g[i]) * static_cast<double>(along[k][i]);
    }
    const nova::NoGrad no_grad;
    constexpr float kStep = 1e-3f;
    auto at = [&](float h) {
      for (size_t k = 0; k < inputs.size(); ++k) {
        std::vector<float> x = before[k];
        for (size_t i = 0; i < x.size(); ++i) x[i] += h * along[k][i];
        inputs[k].copy_from_host(x.data(), x.size() * sizeof(float));
      }
      return output().to_host();
    };
    const std::vector<float> up = at(kStep), down = at(-kStep), seed = v.to_host();
    at(0.0f);
    double left = 0.0, scale = 0.0;
    for (size_t i = 0; i < up.size(); ++i) {
      const double ju = (static_cast<double>(up[i]) - static_cast<double>(down[i])) /
                        (2.0 * static_cast<double>(kStep));
      left += ju * static_cast<double>(seed[i]);
      scale += std::fabs(ju * static_cast<double>(seed[i]));
    }
    EXPECT_NEAR(left, right, 5e-3 * scale);
  }

  Tensor contact_forces() {
    return diff::eval_static_particle_shape_contact_forces_generated(*model, q, qd, f, 0.05f);
  }

  std::shared_ptr<Model> model;
  Tensor q, qd, f;
  std::vector<Tensor> inputs;
};

TEST_F(Operators, StaticContactForcesHaveTheBitsOfTheForwardEngine) {
  SimState state = model->state(), next = model->state();
  state.particle_f.copy_from_host(f.to_host().data(),
                                  static_cast<size_t>(f.size()) * sizeof(float));
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  Contacts contacts = pipeline.contacts();
  pipeline.collide(state, contacts);
  EXPECT_GE(contacts.active_soft_contact_count(), 5);
  SolverSemiImplicit solver(model);
  solver.step(state, next, nullptr, &contacts, kDt);
  EXPECT_TRUE(same_bits<float>(contact_forces().to_host(),
                               std::span(reinterpret_cast<const float*>(state.particle_f.data()),
                                         static_cast<size_t>(f.size()))));
  const auto [q_out, qd_out] =
      diff::integrate_particles_generated(*model, q, qd, contact_forces(), kDt);
  EXPECT_TRUE(same_bits<float>(q_out.to_host(),
                               std::span(reinterpret_cast<const float*>(next.particle_q.data()),
                                         static_cast<size_t>(q.size()))));
  EXPECT_TRUE(same_bits<float>(qd_out.to_host(),
                               std::span(reinterpret_cast<const float*>(next.particle_qd.data()),
                                         static_cast<size_t>(q.size()))));
}

TEST_F(Operators, TheFusedOperatorHasTheBitsOfItsParts) {
  const auto [q1, qd1] = diff::integrate_particles_generated(*model, q, qd, contact_forces(), kDt);
  const auto [q2, qd2] =
      diff::integrate_particles_with_static_contacts_generated(*model, q, qd, f, 0.05f, kDt);
  EXPECT_TRUE(same_bits<float>(q2.to_host(), q1.to_host()));
  EXPECT_TRUE(same_bits<float>(qd2.to_host(), qd1.to_host()));
}

TEST_F(Operators, StaticContactForcesHaveTheGradientOfDifferences) {
  expect_gradients([&] { return weighted(contact_forces(), 5); });
}
TEST_F(Operators, StaticContactForcesKeepTheDotProductIdentity) {
  expect_dot_product_identity([&] { return contact_forces(); });
}
TEST_F(Operators, IntegrationHasTheGradientOfDifferences) {
  expect_gradients([&] {
    const auto [x, v] = diff::integrate_particles_generated(*model, q, qd, f, 0.3f);
    return nova::add(weighted(x, 5), weighted(v, 6));
  });
}
TEST_F(Operators, IntegrationKeepsTheDotProductIdentity) {
  expect_dot_product_identity(
      [&] { return diff::integrate_particles_generated(*model, q, qd, f, 0.3f).second; });
}
TEST_F(Operators, IntegrationAtTheVelocityLimitHasTheGradientOfDifferences) {
  model->particle_max_velocity = 1.5f;
  expect_gradients([&] {
    const auto [x, v] = diff::integrate_particles_generated(*model, q, qd, f, 0.3f);
    return nova::add(weighted(x, 5), weighted(v, 6));
  });
}
TEST_F(Operators, TheFusedOperatorHasTheGradientOfDifferences) {
  expect_gradients([&] {
    const auto [x, v] =
        diff::integrate_particles_with_static_contacts_generated(*model, q, qd, f, 0.05f, 0.1f);
    return nova::add(weighted(x, 5), weighted(v, 6));
  });
}
TEST_F(Operators, TheFusedOperatorKeepsTheDotProductIdentity) {
  expect_dot_product_identity([&] {
    return diff::integrate_particles_with_static_contacts_generated(*model, q, qd, f, 0.05f, 0.1f)
        .second;
  });
}

TEST_F(Operators, ParticleMassZeroPassesNoGradient) {
  std::vector<float> mass = model->particle_mass.to_host();
  mass[0] = 0.0f;
  model->particle_mass.copy_from_host(std::span<const float>(mass));
  diff::update_inverse_mass(*model);
  EXPECT_EQ(model->particle_inv_mass.to_host()[0], 0.0f);
  const Tensor m = diff::model_particle_mass_tensor(*model, true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  tape.backward(nova::sum(diff::integrate_particles_generated(*model, q, qd, f, kDt).second));
  EXPECT_EQ(m.grad().to_host()[0], 0.0f);
  EXPECT_NE(m.grad().to_host()[1], 0.0f);
}

TEST_F(Operators, LossesHaveTheirClosedFormAndGradient) {
  const std::vector<float> x = q.to_host();
  const Vec3f target{0.25f, -1.0f, 2.0f}, d = Vec3f{x[3], x[4], x[5]} - target;
  EXPECT_EQ(diff::particle_point_loss_generated(q, 1, target.x, target.y, target.z).item(),
            math::dot(d, d));
  EXPECT_EQ(diff::vec3_point_loss_generated(Tensor::from_host(std::span(x).subspan(3, 3), {3}),
                                            target.x, target.y, target.z)
                .item(),
            math::dot(d, d));
  Vec3f sum{};
  const auto n = static_cast<float>(model->particle_count());
  for (size_t k = 0; k < x.size(); k += 3) sum = sum + Vec3f{x[k], x[k + 1], x[k + 2]} / n;
  const std::vector<float> centroid = diff::particle_centroid_generated(q).to_host();
  EXPECT_EQ((Vec3f{centroid[0], centroid[1], centroid[2]}), sum);
  const auto check = [&](const std::function<Tensor(const std::vector<Tensor>&)>& loss) {
    const auto result = nova::gradcheck(loss, {q}, {.rtol = 2e-3f});
    EXPECT_TRUE(result.ok) << result.worst;
  };
  check([](const std::vector<Tensor>& in) {
    return diff::particle_point_loss_generated(in[0], 2, 0.1f, 0.2f, 0.3f);
  });
  check([](const std::vector<Tensor>& in) {
    return diff::vec3_point_loss_generated(diff::particle_centroid_generated(in[0]), 0.1f, 0.2f,
                                           0.3f);
  });
}

TEST_F(Operators, ClampPassesTheGradientInsideAndAtItsBounds) {
  const float values[] = {-2.0f, -1.0f, 0.5f, 1.0f, 3.0f};
  const Tensor x = Tensor::from_host(std::span<const float>(values), {5});
  x.set_requires_grad(true);
  nova::Tape tape;
  const nova::TapeScope scope(tape);
  const Tensor y = diff::clamp_f32_generated(x, -1.0f, 1.0f);
  EXPECT_EQ(y.to_host(), (std::vector<float>{-1.0f, -1.0f, 0.5f, 1.0f, 1.0f}));
  tape.backward(nova::sum(y));
  EXPECT_EQ(x.grad().to_host(), (std::vector<float>{0.0f, 1.0f, 1.0f, 1.0f, 0.0f}));
}

TEST_F(Operators, BadInputNamesTheArgument) {
  using namespace diff;
  const Tensor wide({model->particle_count(), 4}), few({2, 3}), ints({6, 3}, nova::DType::I32);
  EXPECT_ERROR(integrate_particles_generated(*model, wide, qd, f, kDt), ErrorKind::Value,
               "particle_q");
  EXPECT_ERROR(integrate_particles_generated(*model, q, few, f, kDt), ErrorKind::Value,
               "particle_qd");
  EXPECT_ERROR(integrate_particles_generated(*model, q, qd, ints, kDt), ErrorKind::Type,
               "particle_f");
  for (float dt : {0.0f, -1.0f, NAN, INFINITY})
    EXPECT_ERROR(integrate_particles_generated(*model, q, qd, f, dt), ErrorKind::Value, "dt");
  EXPECT_ERROR(eval_static_particle_shape_contact_forces_generated(*model, q, qd, f, -1.0f),
               ErrorKind::Value, "soft_contact_margin");
  EXPECT_ERROR(particle_point_loss_generated(q, 6, 0, 0, 0), ErrorKind::Index, "particle_index");
  EXPECT_ERROR(particle_point_loss_generated(q, 0, NAN, 0, 0), ErrorKind::Value, "target");
  EXPECT_ERROR(clamp_f32_generated(q, 1.0f, 0.0f), ErrorKind::Value, "lower");
  EXPECT_ERROR(vec3_point_loss_generated(q, 0, 0, 0), ErrorKind::Value, "point");
}

}  // namespace
}  // namespace novaphy::testing
