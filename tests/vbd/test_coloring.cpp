// ModelBuilder::color and set_coloring.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "novaphy/core/sim/model_builder.h"
#include "novaphy/vbd/solver_vbd.h"
#include "support/bits.h"

namespace novaphy {
namespace {

ModelBuilder cloth(int size, bool springs = false) {
  ModelBuilder b;
  b.add_cloth_grid({.dim_x = size, .dim_y = size, .mass = 0.1f, .add_springs = springs});
  return b;
}

// Expects that the corners of each element have different colors.
template <class Row>
void expect_proper(const std::vector<int32_t>& colors, const std::vector<Row>& rows) {
  const auto* corners = reinterpret_cast<const int32_t*>(rows.data());
  const size_t n = sizeof(Row) / sizeof(int32_t);
  size_t equal = 0;
  for (size_t e = 0; e < rows.size(); ++e)
    for (size_t c = 0; c < n; ++c)
      for (size_t d = 0; d < c; ++d) {
        const int32_t p = corners[e * n + c], q = corners[e * n + d];
        equal +=
            p >= 0 && q >= 0 && colors[static_cast<size_t>(p)] == colors[static_cast<size_t>(q)];
      }
  EXPECT_EQ(equal, 0u);
}

TEST(Coloring, ElementsHaveCornersOfDifferentColorsInBalancedGroups) {
  ModelBuilder b = cloth(20, true);
  b.add_soft_grid({.placement = {.pos = {0.0f, 0.0f, 3.0f}}, .dim_x = 4, .dim_y = 5, .dim_z = 6});
  b.color();
  const auto model = b.finalize(Device::cpu());
  const std::vector<int32_t> colors = model->particle_colors.to_host();
  expect_proper(colors, model->particle_spring_indices.to_host());
  expect_proper(colors, model->particle_tri_indices.to_host());
  expect_proper(colors, model->particle_tet_indices.to_host());
  std::vector<Vec4i> hinges;
  for (const Vec4i& e : model->particle_edge_indices.to_host())
    if (e.x >= 0 && e.y >= 0) hinges.push_back(e);
  hinges.resize(static_cast<size_t>(20 * 20));  // the hinges of the cloth, which are stiff
  expect_proper(colors, hinges);
  const auto groups = model->particle_color_groups();
  size_t total = 0, smallest = colors.size(), largest = 0;
  for (const auto& group : groups) {
    EXPECT_TRUE(std::is_sorted(group.begin(), group.end()));
    total += group.size();
    smallest = std::min(smallest, group.size());
    largest = std::max(largest, group.size());
  }
  EXPECT_EQ(total, colors.size());
  EXPECT_LE(static_cast<double>(largest), 1.2 * static_cast<double>(smallest));
  EXPECT_LE(groups.size(), 10u);

  b.color();
  EXPECT_EQ(b.finalize(Device::cpu())->particle_colors.to_host(), colors);
}

TEST(Coloring, ParticlesWithoutElementsAndEmptyBuildersAreColored) {
  ModelBuilder b;
  b.color();
  EXPECT_TRUE(b.finalize(Device::cpu())->particle_color_groups().empty());
  for (int i = 0; i < 5; ++i) b.add_particle({static_cast<float>(i), 0.0f, 0.0f}, {}, 1.0f);
  b.color();
  EXPECT_EQ(b.finalize(Device::cpu())->particle_color_groups().size(), 1u);
}

TEST(Coloring, BuildersInsideOfBuildersKeepTheirColors) {
  ModelBuilder part = cloth(4);
  part.color();
  const auto one = part.finalize(Device::cpu())->particle_colors.to_host();
  ModelBuilder b;
  b.replicate(part, 3, {2.0f, 0.0f, 0.0f});
  const auto all = b.finalize(Device::cpu())->particle_colors.to_host();
  ASSERT_EQ(all.size(), 3 * one.size());
  for (size_t p = 0; p < all.size(); ++p) EXPECT_EQ(all[p], one[p % one.size()]);
}

TEST(Coloring, GivenGroupsAreTakenAndChecked) {
  ModelBuilder b;
  for (int i = 0; i < 4; ++i) b.add_particle({static_cast<float>(i), 0.0f, 0.0f}, {}, 1.0f);
  b.add_spring(0, 1, 10.0f, 0.0f);
  using Groups = std::vector<std::vector<int32_t>>;
  b.set_coloring(Groups{{0, 2}, {1, 3}});
  EXPECT_EQ(b.finalize(Device::cpu())->particle_color_groups(), (Groups{{0, 2}, {1, 3}}));
  EXPECT_ERROR(b.set_coloring(Groups{{0, 2}, {1}}), ErrorKind::Value, "particle 3");
  EXPECT_ERROR(b.set_coloring(Groups{{0, 2}, {1, 3, 2}}), ErrorKind::Value, "groups 0 and 1");
  EXPECT_ERROR(b.set_coloring(Groups{{0, 2}, {1, 4}}), ErrorKind::Index, "0 to 3, got 4");
  EXPECT_ERROR(b.set_coloring(Groups{{0, 2}, {1, 3}, {}}), ErrorKind::Value, "groups[2]");
  EXPECT_ERROR(b.set_coloring(Groups{{0, 1}, {2, 3}}), ErrorKind::Value, "spring 0");
  // The refused ones changed nothing.
  EXPECT_EQ(b.finalize(Device::cpu())->particle_color_groups(), (Groups{{0, 2}, {1, 3}}));
  b.set_coloring(Groups{{0, 1}, {2, 3}}, true);
  EXPECT_EQ(b.finalize(Device::cpu())->particle_color_groups(), (Groups{{0, 1}, {2, 3}}));
}

TEST(Coloring, ElementsThatAreAddedAfterwardsAreChecked) {
  ModelBuilder b;
  for (int i = 0; i < 3; ++i) b.add_particle({static_cast<float>(i), 0.0f, 0.0f}, {}, 1.0f);
  b.color();
  b.add_spring(0, 1, 10.0f, 0.0f);
  EXPECT_ERROR(b.finalize(Device::cpu()), ErrorKind::Value, "finalize: spring 0");
  b.color();
  const auto model = b.finalize(Device::cpu());
  b.add_particle({5.0f, 0.0f, 0.0f}, {}, 1.0f);
  EXPECT_EQ(b.finalize(Device::cpu())->particle_colors.to_host()[3], -1);
  EXPECT_ERROR(SolverVBD(b.finalize(Device::cpu())), ErrorKind::Value, "ModelBuilder.color()");
}

}  // namespace
}  // namespace novaphy
