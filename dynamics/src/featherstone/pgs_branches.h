// The branches of converged contacts, as derivatives take them (pgs_contacts_vjp.cpp).
#pragma once

#include <vector>

#include "novaphy/dynamics/articulation/pgs.h"

namespace novaphy {

inline constexpr float kSlides = 1e-5f;      // relative: nearer to the cone is on it
inline constexpr double kRegularity = 1e-7;  // of redundant rows, relative to their diagonal

struct ContactBranch {
  bool active = false;
  bool slides[2] = {false, false};  // of the tangents; of a cone both or none
};
ContactBranch branch_of(const articulation::PgsContact<float>& contact, bool cone);

// B and R of a contact; rows are equations, columns n, t1, t2. `slip` {2}: along the tangents.
struct ContactBlocks {
  double b[3][3] = {}, r[3][3] = {};
};
ContactBlocks blocks_of(const articulation::PgsContact<float>& contact, const ContactBranch& branch,
                        bool cone, const double* slip);
// How the rows change with the friction coefficient: where a tangent slides, the impulse along n
// times the direction of its slip.
void rows_by_friction(const articulation::PgsContact<float>& contact, const ContactBranch& branch,
                      bool cone, const double* slip, double* to);

// x of A x = b for A {n, n + 1} with b as the last column, which x replaces. By rows, with pivots.
void solve_dense(std::vector<double>& a, size_t n);

}  // namespace novaphy
