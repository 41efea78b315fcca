// Contacts whose normals come from a search (diff_articulation_motion.h).
#include <algorithm>

#include "diff_articulation_motion.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/semi_implicit/moving_contact_trace.h"

namespace novaphy::diff::detail {
namespace {

namespace art = articulation;
using Feature = ContactFeature<bool, float>;

// Returns the pose of a body at the start of a step.
Transformf pose_of(const Step& s, const ArticulationArguments& in, int32_t body) {
  const ArticulationRows* const rows = rows_of_step(s);
  for (int64_t t = 0; body >= 0 && t < s.count; ++t) {
    const art::Tree<float> tree = articulation_tree(in, rows[t]);
    for (int32_t i = 0; i < rows[t].link_count; ++i) {
      if (tree.links[i].body != body) continue;
      std::vector<uint64_t> work(static_cast<size_t>(
          art::workspace_bytes<float>(rows[t].link_count, rows[t].dof_count) / 8 + 1));
      auto ws = art::make_workspace<float>(work.data(), rows[t].link_count, rows[t].dof_count);
      art::link_frames(tree, articulation_inputs(in).q, ws);
      return {ws.links[i].p + ws.links[i].origin, ws.links[i].q};
    }
  }
  return {{}, Quatf::identity()};
}

ContactShape<bool, float> shape_of(const Model& m, int32_t shape) {
  const auto is = [&](GeoType type) {
    return m.shape_type.data()[shape] == static_cast<int32_t>(type);
  };
  return contact_shape<GeoType, bool, float>(is, m.shape_transform.data()[shape],
                                             m.shape_scale.data()[shape]);
}

// Whether the law of nearest points holds for a contact (witness_points_trace.h). A plane or a face
// of a box gives the normal without a search.
bool is_searched(const Step& s, const ArticulationArguments& in, const KeptContacts& kept,
                 int32_t row) {
  const Model& m = *s.model;
  const ContactShape<bool, float> a = shape_of(m, kept.shape0[row]),
                                  b = shape_of(m, kept.shape1[row]);
  const Vec3f n = kept.normal[row], at_a = kept.point0[row], at_b = kept.point1[row];
  const Transformf of_a = pose_of(s, in, m.shape_body.data()[kept.shape0[row]]),
                   of_b = pose_of(s, in, m.shape_body.data()[kept.shape1[row]]);
  const Feature first =
      contact_feature_of(a, of_a, at_a, math::transform_point(of_b, at_b), n, true);
  const Feature second =
      contact_feature_of(b, of_b, at_b, math::transform_point(of_a, at_a), n, false);
  if ((a.is_polytope && second.witness.is_curved) || (b.is_polytope && first.witness.is_curved))
    return true;
  return first.witness.is_known && second.witness.is_known &&
         (first.witness.is_curved || second.witness.is_curved) && !first.is_along &&
         !second.is_along;
}

}  // namespace

bool holds_searched(const Step& s, const ArticulationArguments& in) {
  if (!s.contacts.defined()) return false;
  const KeptContacts kept = kept_contacts(s);
  const ContactEvents& found = s.motion->found;
  const bool lands = std::ranges::any_of(found.events, [](const auto& e) { return e.lands; });
  for (int32_t i = 0; i < *kept.count; ++i) {
    const bool bounces = !lands && std::ranges::binary_search(found.hits, i);
    if (kept.impulses[i].x > 0.0f && !bounces && is_searched(s, in, kept, i)) return true;
  }
  return false;
}

}  // namespace novaphy::diff::detail
