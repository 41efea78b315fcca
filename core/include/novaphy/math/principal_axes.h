// Eigenvalues and eigenvectors of a symmetric 3x3 matrix by Jacobi rotations.
#pragma once

#include <cmath>

#include "novaphy/math/types.h"

namespace novaphy::math {

// The decomposition A = R diag(moments) R^T.
struct PrincipalAxes {
  double moments[3];
  double axes[3][3];  // R: the axes are its columns
};

inline PrincipalAxes principal_axes(const Mat33<double>& symmetric) {
  PrincipalAxes p{{}, {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}};
  Mat33<double> a = symmetric;
  for (int turn = 0; turn < 90; ++turn) {
    const int i = turn % 3 == 2 ? 1 : 0, j = turn % 3 == 0 ? 1 : 2;
    if (a.m[i][j] == 0.0) continue;
    const double theta = (a.m[j][j] - a.m[i][i]) / (2.0 * a.m[i][j]);
    const double t = (theta < 0.0 ? -1.0 : 1.0) / (std::abs(theta) + std::hypot(theta, 1.0));
    const double c = 1.0 / std::hypot(t, 1.0), s = t * c;
    for (int k = 0; k < 3; ++k) {
      const double x = a.m[k][i], y = a.m[k][j];
      a.m[k][i] = c * x - s * y;
      a.m[k][j] = s * x + c * y;
    }
    for (int k = 0; k < 3; ++k) {
      const double x = a.m[i][k], y = a.m[j][k];
      a.m[i][k] = c * x - s * y;
      a.m[j][k] = s * x + c * y;
    }
    for (auto& row : p.axes) {
      const double x = row[i], y = row[j];
      row[i] = c * x - s * y;
      row[j] = s * x + c * y;
    }
  }
  for (int k = 0; k < 3; ++k) p.moments[k] = a.m[k][k];
  return p;
}

}  // namespace novaphy::math
