// Makes a cloth of a mesh from a file.
#include <fstream>
#include <iostream>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/io/mesh.h"

int main() {
  std::ofstream("square.obj") << "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
  const novaphy::Mesh mesh = novaphy::load_mesh("square.obj");

  novaphy::ModelBuilder builder;
  builder.add_cloth_mesh({.vertices = mesh.vertices, .indices = mesh.indices, .density = 0.3});
  std::cout << builder.particle_count() << " particles, " << builder.tri_count() << " triangles\n";
  return builder.particle_count() == 4 && builder.tri_count() == 2 ? 0 : 1;
}
