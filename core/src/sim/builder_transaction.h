// Transaction: removes what a function added to a builder if the function throws. A refused mesh
// thus leaves the builder unchanged.
#pragma once

#include "novaphy/core/sim/model_builder.h"

namespace novaphy {

class ModelBuilder::Transaction {
 public:
  explicit Transaction(ModelBuilder& builder)
      : builder_(builder),
        particles_(builder.particle_q.size()),
        springs_(builder.springs_.indices.size()),
        triangles_(builder.triangles_.indices.size()),
        edges_(builder.edges_.indices.size()),
        tetrahedra_(builder.tetrahedra_.indices.size()) {}
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;
  ~Transaction() {
    if (!kept_) undo();
  }
  void keep() { kept_ = true; }

 private:
  void undo() {
    ModelBuilder& b = builder_;
    shrink(particles_, b.particle_q, b.particle_qd, b.particle_mass, b.particle_radius,
           b.particle_flags, b.particle_world);
    shrink(springs_, b.springs_.indices, b.springs_.rest_length, b.springs_.stiffness,
           b.springs_.damping, b.springs_.control, b.springs_.tension_only);
    shrink(triangles_, b.triangles_.indices, b.triangles_.pose, b.triangles_.area);
    shrink(triangles_ * 5, b.triangles_.material);
    shrink(edges_, b.edges_.indices, b.edges_.rest_angle, b.edges_.rest_length);
    shrink(edges_ * 2, b.edges_.material);
    shrink(tetrahedra_, b.tetrahedra_.indices, b.tetrahedra_.pose, b.tetrahedra_.volume,
           b.tetrahedra_.is_lame);
    shrink(tetrahedra_ * 3, b.tetrahedra_.material);
  }
  template <class... Vectors>
  static void shrink(size_t size, Vectors&... vectors) {
    (vectors.resize(size), ...);
  }

  ModelBuilder& builder_;
  size_t particles_, springs_, triangles_, edges_, tetrahedra_;
  bool kept_ = false;
};

}  // namespace novaphy
