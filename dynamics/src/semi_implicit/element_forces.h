// ElementForces: the forces of springs, triangles, bending edges and tetrahedra, in two passes
// without a data race. First every element writes its forces on its particles. Then every particle
// sums its forces in the order springs, triangles, edges, tetrahedra, and within each kind in the
// order of the elements.
#pragma once

#include <vector>

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "particle_rows.h"

namespace novaphy {

class ElementForces {
 public:
  // Returns whether the model has elements.
  static bool any(const Model& model);

  // Evaluates all elements. Activations come from the control, or from the model if `control` is
  // null. Reuses its memory. ErrorKind::Index: an element names a particle that does not exist.
  void evaluate(const Model& model, const Control* control, const Vec3f* q, const Vec3f* qd);
  // Returns f plus the forces of the particle's elements.
  Vec3f add(int64_t particle, Vec3f f) const {
    for (const Table& table : tables_) {
      if (table.rows.empty()) continue;
      for (const int32_t item : table.rows.items(particle))
        f = f + table.forces[static_cast<size_t>(item)];
    }
    return f;
  }
  void reset();

 private:
  struct Table {
    ParticleRows rows;
    std::vector<Vec3f> forces;  // one per entry of the table of indices
    void update(const Array& indices, int32_t particles, const char* name,
                bool may_be_absent = false);
  };
  Table tables_[4];  // springs, triangles, edges, tetrahedra
};

}  // namespace novaphy
