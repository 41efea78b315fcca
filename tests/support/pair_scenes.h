// Difficult scenes for a broad phase, which must find the rows of the exhaustive search.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "novaphy/core/sim/model_builder.h"

namespace novaphy::testing {

// A name, shapes, and the bodies whose poses are NaN at first.
struct PairScene {
  std::string name;
  ModelBuilder builder;
  std::vector<size_t> lost = {};
};

namespace pair_scenes {

inline void add_sphere(ModelBuilder& builder, const Vec3f& at, float radius, int group = 1) {
  const int32_t body = builder.add_body({.xform = {at, Quatf::identity()}});
  builder.add_shape_sphere(body, {.radius = radius, .cfg = ShapeConfig{.collision_group = group}});
}

// Spheres in a cube, so dense that each touches a few.
inline ModelBuilder cloud(int count, const Vec3f& middle, float side, float radius,
                          uint32_t seed = 3) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(-0.5f, 0.5f);
  ModelBuilder builder;
  for (int k = 0; k < count; ++k)
    add_sphere(builder,
               middle + Vec3f{side * unit(random), side * unit(random), side * unit(random)},
               radius, k % 11 == 0 ? -1 - k : 1);
  return builder;
}

}  // namespace pair_scenes

inline std::vector<PairScene> hard_pair_scenes() {
  using namespace pair_scenes;
  std::vector<PairScene> scenes;
  ModelBuilder one_cell;
  for (int k = 0; k < 45; ++k) add_sphere(one_cell, {1.0f, 2.0f, 3.0f}, 0.1f);
  scenes.push_back({"all shapes in one cell", one_cell});
  ModelBuilder crowd = cloud(300, {}, 3.0f, 0.06f);
  for (int k = 0; k < 30; ++k) add_sphere(crowd, {0.0f, 0.0f, 0.3f}, 0.1f);
  scenes.push_back({"a crowd among others", crowd});

  ModelBuilder large = cloud(560, {}, 2.0f, 0.06f);
  large.add_ground_plane();
  add_sphere(large, {0.0f, 0.0f, -50.0f}, 50.0f);
  large.add_shape_box(-1, {.hx = 30.0f, .hy = 30.0f, .hz = 30.0f});
  large.add_shape_collision_filter_pair(7, large.shape_count() - 1);
  scenes.push_back({"shapes as large as the world", large});

  ModelBuilder sizes;
  std::mt19937 random(4);
  std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
  for (int k = 0; k < 45; ++k) {
    const float radius = std::pow(10.0f, 3.0f * unit(random));
    add_sphere(sizes, Vec3f{unit(random), unit(random), unit(random)} * (1.5f * radius), radius);
  }
  scenes.push_back({"sizes of 1e6 to 1", sizes});

  scenes.push_back({"far from the origin", cloud(200, {1.0e5f, -2.0e5f, 1.0e5f}, 1.2f, 0.06f)});
  ModelBuilder outlier = cloud(200, {}, 1.2f, 0.06f);
  add_sphere(outlier, {1.0e30f, 0.0f, -1.0e30f}, 0.1f);
  scenes.push_back({"one shape far from all others", outlier});

  PairScene lost{"poses that are NaN", cloud(200, {}, 1.2f, 0.06f)};
  for (size_t b = 0; b < 200; b += 5) lost.lost.push_back(b);
  scenes.push_back(lost);

  ModelBuilder worlds;
  worlds.add_ground_plane();
  add_sphere(worlds, {0.0f, 0.0f, -4.0f}, 4.0f);
  for (uint32_t w = 0; w < 5; ++w)
    worlds.add_world(cloud(w == 2 ? 530 : 30, {0.0f, 0.0f, 0.2f}, w == 2 ? 2.0f : 0.5f, 0.06f, w));
  scenes.push_back({"worlds of other sizes and shapes of all of them", worlds});
  return scenes;
}

// Poses at first, and where the lost ones are found again and the others have moved.
inline std::vector<std::vector<Transformf>> poses_of(const PairScene& scene,
                                                     const SimState& state) {
  const std::vector<Transformf> start = state.body_q.to_host();
  std::vector<Transformf> first = start, then = start;
  for (const size_t b : scene.lost) first[b].p.y = std::numeric_limits<float>::quiet_NaN();
  for (size_t b = 0; b < then.size(); b += 2) {
    then[b].p.x += 0.05f;
    std::swap(then[b].p, then[then.size() - 1 - b].p);
  }
  return {first, then};
}

}  // namespace novaphy::testing
