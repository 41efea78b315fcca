// The numbers of a slot (slot_layout_law.h) that the material and rest shape of its element give
// it: weights and law. `corner`: of the element, which the particle is; `number(k)`: a reference to
// the k-th number.
//
// Freestanding: device code reads it too.
#pragma once

#include "novaphy/math/matrix.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/tetrahedron_law.h"

namespace novaphy::vbd {

template <class Number>
void put_spring_numbers(float ke, float kd, float rest, float h, const Number& number) {
  number(0) = ke;
  number(1) = kd / h;
  number(2) = rest;
}

// Of the rows of the inverse rest matrix, that of corner 0 is minus the sum of the others.
template <class Number>
void put_triangle_numbers(int32_t corner, const Mat22f& pose, float area, const float* material,
                          float activation, float h, const Number& number) {
  Vec2f rows[3];
  for (int c = 1; c < 3; ++c) rows[c] = {pose.m[c - 1][0], pose.m[c - 1][1]};
  rows[0] = {-(rows[1].x + rows[2].x), -(rows[1].y + rows[2].y)};
  for (int m = 0; m < 2; ++m) {
    const Vec2f& row = rows[(corner + 1 + m) % 3];
    number(2 * m) = row.x;
    number(2 * m + 1) = row.y;
  }
  const MembraneLaw<float> law =
      membrane_law(area, material[0], material[1], activation, material[2] / h);
  number(4) = law.mu;
  number(5) = law.ln;
  number(6) = law.alpha;
  number(7) = law.kd_by_h;
}

template <class Number>
void put_hinge_numbers(const float* material, float rest_length, float rest_angle, float h,
                       const Number& number) {
  number(0) = material[0] * rest_length;
  number(1) = (material[1] / h) * rest_length;
  number(2) = rest_angle;
}

template <class Number>
void put_tetrahedron_numbers(int32_t corner, const Mat33f& pose, const float* material,
                             float activation, float h, const Number& number) {
  Vec3f rows[4];
  for (int c = 1; c < 4; ++c) rows[c] = math::row(pose, c - 1);
  rows[0] = -((rows[1] + rows[2]) + rows[3]);
  for (int m = 0; m < 3; ++m) {
    const Vec3f& row = rows[(corner + 1 + m) % 4];
    number(3 * m) = row.x;
    number(3 * m + 1) = row.y;
    number(3 * m + 2) = row.z;
  }
  const float volume = 1.0f / (math::determinant(pose) * 6.0f);
  const TetrahedronLaw<float> law =
      tetrahedron_law(volume, material[0], material[1], activation, material[2] / h);
  number(9) = law.mu;
  number(10) = law.ln;
  number(11) = law.alpha;
  number(12) = law.kd_by_h;
}

}  // namespace novaphy::vbd
