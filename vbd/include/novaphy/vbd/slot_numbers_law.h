// The numbers of a slot (slot_layout_law.h) that the material and rest shape of its element give:
// weights and law. The scalar is a float, carries a derivative (tangent_law.h), or is an
// expression, of which the build derives the transpose (tools/vbd_adjoints).
//
// Freestanding: device code reads it too.
#pragma once

#include "novaphy/math/matrix.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/slot_layout_law.h"
#include "novaphy/vbd/tetrahedron_law.h"

namespace novaphy::vbd {

// The parameters of an element are the first columns of its rows of some arrays of the model.
constexpr int kParameterArrays = 4;
constexpr int kParameters[kRoles] = {3, 9, 4, 4, 13};
constexpr int kDampingParameter[kRoles] = {1, 7, 1, 1, 11};

// Calls body(parameter, array, index in the array) for the parameters of an element.
template <Role role, class Body>
void for_parameters(int64_t element, const Body& body) {
  int k = 0;
  const auto read = [&](int array, int columns, int width) {
    for (int c = 0; c < columns; ++c) body(k++, array, element * width + c);
  };
  if constexpr (role == kSpring) {
    read(0, 1, 1);  // stiffness
    read(1, 1, 1);  // damping
    read(2, 1, 1);  // rest length
  } else if constexpr (role == kTriangle) {
    read(0, 4, 4);  // pose
    read(1, 1, 1);  // area
    read(2, 3, 5);  // material
    read(3, 1, 1);  // activation
  } else if constexpr (role == kTetrahedron) {
    read(0, 9, 9);  // pose
    read(1, 3, 3);  // material
    read(2, 1, 1);  // activation
  } else {
    read(0, 2, 2);  // material
    read(1, 1, 1);  // rest length
    read(2, 1, 1);  // rest angle
  }
}

// Weights of the corners behind `corner`: their rows of the inverse rest matrix {n, n}. The row of
// corner 0 is minus the sum of the others.
template <int n, class T, class Put>
void put_weights(int corner, const T* pose, const Put& put) {
  for (int m = 0; m < n; ++m)
    for (int c = 0; c < n; ++c) {
      const int of = (corner + 1 + m) % (n + 1);
      if (of > 0) {
        put(n * m + c, pose[n * (of - 1) + c]);
      } else {
        T sum = pose[c];
        for (int r = 1; r < n; ++r) sum = sum + pose[n * r + c];
        put(n * m + c, -sum);
      }
    }
}

// Calls put(k, value) for the k-th number. `corner`: of the element, which the particle is.
template <Role role, class T, class Put>
void put_slot_numbers([[maybe_unused]] int corner, const T* p, const T& h, const Put& put) {
  constexpr int law = law_begin(role);
  if constexpr (role == kSpring) {
    put(law, p[0]);
    put(law + 1, p[1] / h);
    put(law + 2, p[2]);
  } else if constexpr (role == kTriangle) {
    put_weights<2>(corner, p, put);
    const MembraneLaw<T> of = membrane_law(p[4], p[5], p[6], p[8], p[7] / h);
    put(law, of.mu);
    put(law + 1, of.ln);
    put(law + 2, of.alpha);
    put(law + 3, of.kd_by_h);
  } else if constexpr (role == kTetrahedron) {
    put_weights<3>(corner, p, put);
    const Mat33<T> pose = {{{p[0], p[1], p[2]}, {p[3], p[4], p[5]}, {p[6], p[7], p[8]}}};
    const T volume = T(1.0f) / (math::determinant(pose) * T(6.0f));
    const TetrahedronLaw<T> of = tetrahedron_law(volume, p[9], p[10], p[12], p[11] / h);
    put(law, of.mu);
    put(law + 1, of.ln);
    put(law + 2, of.alpha);
    put(law + 3, of.kd_by_h);
  } else {
    put(law, p[0] * p[2]);
    put(law + 1, (p[1] / h) * p[2]);
    put(law + 2, p[3]);
  }
}

}  // namespace novaphy::vbd
