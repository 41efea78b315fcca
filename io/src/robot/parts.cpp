// Display shapes of meshes with several materials.
#include "robot.h"

namespace novaphy::detail {

void add_parts(const RobotShape& whole, MeshParts& known, std::vector<RobotShape>& to) {
  constexpr size_t kMost = 64;
  auto& parts = known[whole.surface];
  if (parts.empty())
    for (Mesh& part : parts_by_color(*whole.surface))
      parts.push_back(std::make_shared<const Mesh>(std::move(part)));
  if (parts.size() > kMost) return to.push_back(whole);
  for (size_t k = 0; k < parts.size(); ++k) {
    RobotShape& shape = to.emplace_back(whole);
    if (k > 0) shape.label += "/part_" + std::to_string(k);
    shape.surface = parts[k];
    shape.color.reset();
    if (const auto& c = parts[k]->color) shape.color = Vec4f{c->x, c->y, c->z, 1.0f};
  }
}

}  // namespace novaphy::detail
