// The counts of a model: the number of particles, bodies, shapes, joints and so on.
#pragma once

#include <cstdint>

namespace novaphy {

// X(name, doc)
// clang-format off
#define NOVAPHY_MODEL_COUNTS(X)                                                                   \
  X(particle_count, "particles")                                                                  \
  X(body_count, "rigid bodies")                                                                   \
  X(shape_count, "shapes")                                                                        \
  X(joint_count, "joints")                                                                        \
  X(joint_dof_count, "joint degrees of freedom")                                                  \
  X(joint_coord_count, "joint coordinates")                                                       \
  X(articulation_count, "articulations")                                                          \
  X(actuator_count, "actuators")                                                                  \
  X(actuator_state_count, "activations of the actuators that have dynamics")                      \
  X(spring_count, "springs")                                                                      \
  X(tri_count, "triangles")                                                                       \
  X(edge_count, "bending edges")                                                                  \
  X(tet_count, "tetrahedra")                                                                      \
  X(world_count, "worlds, at least 1")                                                            \
  X(mesh_vertex_count, "vertices of the meshes and hulls of shapes")                              \
  X(mesh_triangle_count, "triangles of the meshes and hulls of shapes")
// clang-format on

#define NOVAPHY_COUNT_MEMBER(name, doc) int32_t name = 0;
#define NOVAPHY_COUNT_GETTER(name, doc) \
  int32_t name() const { return counts_.name; }

struct ModelCounts {
  NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_MEMBER)
  bool operator==(const ModelCounts&) const = default;
};

}  // namespace novaphy
