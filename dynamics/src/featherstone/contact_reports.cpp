// The functions of ContactSteps that report on the last step.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "contact_steps.h"
#include "novaphy/core/error.h"

namespace novaphy {

namespace art = articulation;

int32_t ContactSteps::sweeps() const {
  int32_t most = 0;
  for (const IslandNode& node : last_nodes()) most = std::max(most, node.result.sweeps);
  return most;
}
float ContactSteps::residual() const {
  float most = 0.0f;
  for (const IslandNode& node : last_nodes()) most = std::max(most, node.result.residual);
  return most;
}
std::vector<IslandNode> ContactSteps::last_nodes() const {
  if (!has_run_) return {};
  const std::vector<int32_t> words = nodes_.to_host();
  std::vector<IslandNode> nodes(words.size() * sizeof(int32_t) / sizeof(IslandNode));
  std::memcpy(static_cast<void*>(nodes.data()), words.data(), words.size() * sizeof(int32_t));
  return nodes;
}

int32_t ContactSteps::hardest_row(int32_t root) const {
  const GroupStep s = group_of_tree(*last_, root);
  const IslandNode& node = s.a.nodes[root];
  int32_t at = -1;
  float most = -1.0f;
  const auto take = [&](float size, int32_t row) {
    if (size <= most) return;
    most = size;
    at = row;
  };
  for (int32_t n = 0; n < node.rows; ++n)
    take(s.all.now[s.places(root)[n]].normal, s.a.contacts[s.places(root)[n]]);
  if (node.rows == 0)
    for_friction(s, root, [&](const art::PgsJointFriction<float>& f, int32_t dof) {
      take(std::abs(f.impulse), -1 - dof);
    });
  return at;
}

FarIsland ContactSteps::far_island(float tolerance) const {
  FarIsland far;
  const std::span<IslandNode> nodes = has_run_ ? nodes_here() : std::span<IslandNode>();
  for (size_t i = 0; i < nodes.size(); ++i) {
    const art::IslandResult& of = nodes[i].result;
    if (art::far_from_converged(of.residual, of.largest, tolerance) && of.residual > far.residual)
      far = {of.sweeps, of.residual, of.largest, hardest_row(static_cast<int32_t>(i))};
  }
  return far;
}

namespace {

std::string pair_of_shapes(const Model& m, int32_t a, int32_t b) {
  return "shapes '" + m.shape_label[static_cast<size_t>(a)] + "' and '" +
         m.shape_label[static_cast<size_t>(b)] + "'";
}

}  // namespace

std::string describe(const FarIsland& of, const Model& m, const Articulations& articulations,
                     const int32_t* shape0, const int32_t* shape1) {
  std::string text;
  for (const MessagePart& part :
       {MessagePart("the last of "), MessagePart(of.sweeps),
        MessagePart(" sweeps changed velocities by "), MessagePart(of.residual),
        MessagePart(" m/s, the largest impulse by "), MessagePart(of.largest),
        MessagePart(" m/s, at ")})
    text.append(part.text());
  return text + (of.at < 0 ? articulations.dof_name(m, -1 - of.at)
                           : pair_of_shapes(m, shape0[of.at], shape1[of.at]));
}

std::string ContactSteps::largest_force() const {
  if (kept_.rows() == 0) return {};
  const auto* const kept = reinterpret_cast<const art::KeptContact*>(kept_.range()->data());
  const auto* const most = std::max_element(
      kept, kept + kept_begin_.data()[groups_],
      [](const art::KeptContact& a, const art::KeptContact& b) { return a.normal < b.normal; });
  if (most == kept + kept_begin_.data()[groups_] || !(most->normal > 0.0f)) return {};
  return std::string(MessagePart(most->normal / kept_dt_.data()[0]).text()) + " N between " +
         pair_of_shapes(model_, most->shape0, most->shape1);
}

}  // namespace novaphy
