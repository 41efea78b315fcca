// What a pair of shapes A, B gives: up to eight contact points, without margins.
//
// Freestanding: read by device compilers.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy::geometry {

struct ContactPoint {
  Vec3f position{};       // m, world: midway between the two surfaces
  Vec3f normal{};         // unit, from A to B
  float distance = 0.0f;  // m, between the surfaces along the normal; < 0 is penetration
  int32_t feature = 0;    // what of the pair touches, in the numbering of the pair's types
};

inline constexpr int kMaxContactPoints = 8;

struct Manifold {
  int32_t count = 0;
  ContactPoint points[kMaxContactPoints];

  void add(const ContactPoint& point) {
    if (count < kMaxContactPoints) points[count++] = point;
  }
};

}  // namespace novaphy::geometry
