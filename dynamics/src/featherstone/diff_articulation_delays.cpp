// The delays of the events of a step (diff_articulation_motion.h), as functions of the state and of
// the joint limits. A limit as a constraint row has the gap d = side (q - limit).
#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

namespace art = articulation;

namespace {

// Returns the sum of |dp_g . v| over the groups g of an event. The delay of group g has the weight
// w_g / |dp_g . v|.
float total_approach(const ContactEvent& event) {
  float sum = 0.0f;
  for (const ContactEvent::Group& g : event.groups) sum += g.approach;
  return sum;
}

}  // namespace

size_t limit_input(float side) { return side > 0.0f ? kAt.limit_lower : kAt.limit_upper; }

bool moves_by(std::span<const nova::InputGradient> gradients) {
  return gradients[kAt.q].grad.defined() || gradients[kAt.limit_lower].grad.defined() ||
         gradients[kAt.limit_upper].grad.defined();
}

void delays_vjp(const Step& s, std::span<const float> mismatch, std::span<const double> h_before,
                std::span<const float> p_q, std::span<float> correction,
                std::span<const nova::InputGradient> gradients) {
  for (const ContactEvent& event : s.motion->found.events) {
    double s_all = 0.0;
    for (const int32_t tree : event.trees) s_all += double{mismatch[static_cast<size_t>(tree)]};
    list_mismatch(event, h_before, s_all);
    const double approach = total_approach(event);
    const bool apart = event.is_apart();
    std::vector<double> by_push(event.groups.size());
    double rest = s_all;
    for (size_t g = 0; apart && g < event.groups.size(); ++g) {
      for_dofs(s, event, [&](size_t at, size_t row) {
        by_push[g] += double{p_q[row]} * event.groups[g].push[at];
      });
      rest -= by_push[g];
    }
    for (size_t g = 0; g < event.groups.size(); ++g) {
      const ContactEvent::Group& group = event.groups[g];
      const double by = apart ? by_push[g] / group.approach + rest / approach : s_all / approach;
      for_dofs(s, event, [&](size_t at, size_t row) {
        correction[row] += static_cast<float>(by * group.normal_push[at]);
      });
      if (group.dof >= 0)
        add_gradient(gradients[limit_input(group.side)], group.dof, -by * double{group.side});
    }
  }
}

void delays_jvp(const Step& s, const ArticulationArguments& in, std::span<const Tensor> moved,
                std::span<float> delay, std::span<float> jump) {
  const ArticulationRows* const rows = rows_of_step(s);
  for (const ContactEvent& event : s.motion->found.events) {
    const double approach = total_approach(event);
    double all = 0.0;
    std::vector<double> own(event.groups.size());
    for (size_t g = 0; g < event.groups.size(); ++g) {
      const ContactEvent::Group& group = event.groups[g];
      std::vector<float> covector(jump.size());
      for_dofs(s, event, [&](size_t at, size_t row) { covector[row] = group.normal_push[at]; });
      double by = 0.0;
      for (const int32_t t : event.trees)
        art::tangent_to_gradient(
            articulation_tree(in, rows[t]), in.arrays.q.rows(), covector.data() + rows[t].first_dof,
            [&](int32_t row, float value) { by += double{value} * numbers(moved[kAt.q])[row]; });
      if (group.dof >= 0)
        by -= double{group.side} * tangent_at(moved[limit_input(group.side)], group.dof);
      own[g] = by / group.approach;
      all += by / approach;
    }
    for (size_t g = 0; event.is_apart() && g < event.groups.size(); ++g)
      for_dofs(s, event, [&](size_t at, size_t row) {
        jump[row] += static_cast<float>((own[g] - all) * event.groups[g].push[at]);
      });
    for (const int32_t tree : event.trees)
      delay[static_cast<size_t>(tree)] += static_cast<float>(all);
  }
}

}  // namespace novaphy::diff::detail
