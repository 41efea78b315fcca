// The material of two touching shapes (core/sim/shape_config.h, ShapeMixing).
//
// A coefficient of the pair is a x_A + b x_B (plus a constant). x_A and x_B are the coefficients of
// the shapes A and B. The fractions a and b are below. The fractions are constant in derivatives.
// Steps, adjoints and tangents share them. If both mu are equal, each shape has the fraction 1/2.
// Source: MuJoCo documentation, Computation, contact parameters.
#pragma once

#include "novaphy/dynamics/articulation/pgs.h"

namespace novaphy::articulation {

struct PairParts {
  float friction[2] = {0.5f, 0.5f};
  float restitution[2] = {0.5f, 0.5f};
  float softness[2] = {0.5f, 0.5f};  // fractions for ke and kd
  float more_friction = 0.0f;
};
// The gradients by the coefficients of both shapes, with the fractions applied.
struct MaterialGradient {
  float mu[2] = {}, restitution[2] = {}, ke[2] = {}, kd[2] = {};
};

// Returns the fractions of a pair. `mixing`: the four numbers of ShapeMixing of each shape. `mu`:
// friction of each shape.
inline PairParts pair_parts(const float* mixing_a, const float* mixing_b, float mu_a, float mu_b) {
  PairParts to;
  const float *const mixing[2] = {mixing_a, mixing_b}, mu[2] = {mu_a, mu_b};
  const float weight = mixing_a[1] + mixing_b[1], inverse_mass = mixing_a[2] + mixing_b[2];
  if (!(mixing_a[1] > 0.0f && mixing_b[1] > 0.0f)) return to;
  const float mass = inverse_mass > 0.0f ? 1.0f / inverse_mass : 1.0f;
  const bool slips = !(mu_a > 0.0f) && !(mu_b > 0.0f);
  float has[2];
  for (int i = 0; i < 2; ++i) has[i] = mu[i] > 0.0f || slips ? mu[i] : mixing[i][3];
  for (int i = 0; i < 2; ++i) {
    const float ahead = mixing[i][0] - mixing[1 - i][0];
    const float over = ahead != 0.0f ? ahead : has[i] - has[1 - i];
    const float part = over > 0.0f ? 1.0f : over < 0.0f ? 0.0f : 0.5f;
    // A missing mu is a default number of the shape, without a gradient.
    const bool constant = ahead == 0.0f && !slips && !(mu[i] > 0.0f);
    to.friction[i] = constant ? 0.0f : part;
    to.more_friction += constant ? part * has[i] : 0.0f;
    to.softness[i] = (ahead > 0.0f ? 1.0f : ahead < 0.0f ? 0.0f : mixing[i][1] / weight) * mass;
  }
  return to;
}

// Arrays of materials with one row per shape. `mixing` has four numbers per row.
template <class T>
struct MaterialsOf {
  const T *mu, *restitution, *ke, *kd;
  const float* mixing;
};
using ShapeMaterials = MaterialsOf<float>;

// `value_of`: converts T to float.
template <class T, class ValueOf>
PairParts pair_parts(const MaterialsOf<T>& of, int32_t a, int32_t b, const ValueOf& value_of) {
  return pair_parts(of.mixing + 4 * int64_t{a}, of.mixing + 4 * int64_t{b}, value_of(of.mu[a]),
                    value_of(of.mu[b]));
}
template <class T>
ContactMaterial<T> pair_material(const MaterialsOf<T>& of, const PairParts& parts, int32_t a,
                                 int32_t b) {
  const auto sum = [&](const T* x, const float* part) {
    return T(part[0]) * x[a] + T(part[1]) * x[b];
  };
  return {sum(of.mu, parts.friction) + T(parts.more_friction),
          sum(of.restitution, parts.restitution), sum(of.ke, parts.softness),
          sum(of.kd, parts.softness)};
}

}  // namespace novaphy::articulation
