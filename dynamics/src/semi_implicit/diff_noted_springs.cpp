#include "novaphy/dynamics/semi_implicit/diff_noted_springs.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <tuple>
#include <vector>

#include "novaphy/dynamics/semi_implicit/contact_gradients.h"
#include "novaphy/dynamics/semi_implicit/diff_body_step.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tangent_visitor.h"
#include "touch_rows.h"

namespace novaphy {
namespace {

using diff::detail::TouchRow;
using diff::detail::TouchSide;
using diff::detail::Vec3d;

// Calls visit(row) for each contact that pushes in a step.
template <class F>
void for_pushes(const Model& model, const NotedStep& step, const F& visit) {
  if (step.contacts == nullptr) return;
  StateFields state;
  state.body_q = step.body_q;
  state.body_qd = step.body_qd;
  state.particle_q = step.q;
  state.particle_qd = step.qd;
  std::vector<TouchRow> rows;
  find_touches(model, state, *step.contacts,
               {step.rigid, step.soft, step.smoothing, step.kf_rate, step.dt}, rows);
  for (const TouchRow& row : rows)
    if (row.pushes) visit(row);
}

nova::Tensor tensor_of(const nova::Operand& of) {
  return {of.range, {of.rows * of.width}, nova::DType::F32};
}
// Appends the gradient that the tape keeps for an operand, or zeros if it keeps none. For a leaf
// only the part that this backward pass added is appended.
void append_gradient(const AdjointRecord& record, const nova::Operand& of, std::vector<float>& to) {
  const nova::Tensor tensor = tensor_of(of);
  const auto size = static_cast<size_t>(tensor.size());
  if (const std::vector<float>* const own = record.gradient(tensor)) {
    to.insert(to.end(), own->begin(), own->end());
    return;
  }
  if (!tensor.has_grad()) return to.resize(to.size() + size);
  const std::vector<float> gradient = tensor.grad().to_host();
  to.insert(to.end(), gradient.begin(), gradient.end());
}
void append_rate(const nova::Operand& from, const nova::Operand& next, float dt,
                 std::vector<float>& to) {
  const std::vector<float> a = tensor_of(from).to_host(), b = tensor_of(next).to_host();
  for (size_t k = 0; k < a.size(); ++k) to.push_back((b[k] - a[k]) / dt);
}

Vec3f narrow(const Vec3d& a) {
  return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}
// Returns the gradient by a force at the contact point of a side, from the gradient `wrench`
// {bodies, 6} by wrenches.
Vec3d by_force(const std::vector<float>& wrench, const TouchSide& side) {
  if (side.body < 0) return {};
  const float* const w = wrench.data() + 6 * static_cast<size_t>(side.body);
  return Vec3d{w[0], w[1], w[2]} + math::cross(Vec3d{w[3], w[4], w[5]}, side.arm);
}
AdjointRecord::Contact contact_of(const Model& m, const NotedStep& step, const TouchRow& row,
                                  const std::vector<float>& wrench) {
  const int32_t world = m.shape_world.data()[row.first];
  const TouchSide& side = row.sides[row.sides[0].body < 0 ? 1 : 0];
  const auto b = static_cast<size_t>(side.body);
  const Vec3f com = math::transform_point(step.body_q.data()[b], m.body_com.data()[b]);
  const double dt{step.dt};
  const Vec3d adjoint = by_force(wrench, row.sides[1]) - by_force(wrench, row.sides[0]);
  return {.row = row.row,
          .world = world < 0 ? m.shape_world.data()[row.second] : world,
          .shape0 = row.first,
          .shape1 = row.second,
          .point = com + narrow(side.arm),
          .normal = narrow(-row.normal),
          .impulse = narrow(row.force * dt),
          .adjoint = narrow(adjoint * (1.0 / dt)),
          .held = !step.rigid_contact_moves ||
                  !has_exact_gradient(m, step.body_q, *step.contacts, row.row)};
}

using PairOfWorld = std::tuple<int32_t, int32_t, int32_t>;
PairOfWorld pair_of(const AdjointRecord::Contact& c) {
  return {c.world, std::min(c.shape0, c.shape1), std::max(c.shape0, c.shape1)};
}

// Stores the changes of the contacts of one pair per world, and then sets the tangents of their
// forces to zero, so that later steps do not see these changes.
class HeldPairs : public nova::TangentVisitor {
 public:
  explicit HeldPairs(const AdjointRecord& record) : record_(record) {}
  void visit(std::string_view kernel, std::span<const nova::Operand> inputs,
             std::span<const std::shared_ptr<Range>> tangents) override {
    if (!kernel.ends_with("rigid_contact_wrenches")) return;
    for (const nova::Operand& in : inputs)
      if (AdjointRecord::Step* const step = AdjointRecord::entry_of(in.range->data()))
        hold(*step, static_cast<float*>(tangents[0]->data()));
  }

 private:
  // `tangents` {rows, 12}: tangents of the wrenches on A, then on B.
  void hold(AdjointRecord::Step& step, float* tangents) const {
    for (const AdjointRecord::Contact& c : step.contacts) {
      if (!record_.holds(c)) continue;
      float* const t = tangents + 12 * static_cast<int64_t>(c.row);
      step.changes[static_cast<size_t>(c.row)] = Vec3f{t[6], t[7], t[8]} * step.dt;
      std::fill_n(t, 12, 0.0f);
    }
  }

  const AdjointRecord& record_;
};

}  // namespace

float steps_per_contact(const Model& model, std::span<const NotedStep> steps) {
  double stiffest = 0.0;  // largest (dt w)^2
  if (!diff::is_on_host(model)) steps = {};
  nova::flush_deferred();
  for (const NotedStep& step : steps)
    for_pushes(model, step, [&](const TouchRow& row) {
      const double dt{step.dt};
      stiffest = std::max(stiffest, dt * dt * row.stiffness * row.inverse_mass);
    });
  return stiffest > 0.0 ? static_cast<float>(std::numbers::pi / std::sqrt(stiffest))
                        : std::numeric_limits<float>::infinity();
}

void clear_gradients(std::span<const NotedStep> steps) {
  for (const NotedStep& step : steps)
    for (const nova::Operand* const of : {&step.wrench, &step.q_next, &step.qd_next})
      if (of->range != nullptr && tensor_of(*of).has_grad()) tensor_of(*of).zero_grad();
}

void add_springs(const Model& model, std::span<const NotedStep> steps, AdjointRecord& record) {
  std::vector<int64_t> numbers;
  for (size_t k = 0; k < steps.size(); ++k)
    numbers.push_back(k > 0 && steps[k].start == steps[k - 1].end ? numbers.back() + 1 : 0);
  for (size_t k = steps.size(); k-- > 0;) {
    const NotedStep& step = steps[k];
    const nova::Operand q = nova::operand_of(step.body_q), qd = nova::operand_of(step.body_qd);
    AdjointRecord::Step& to = record.add(step.body_q.range()->data());
    to.number = numbers[k];
    to.dt = step.dt;
    to.of_springs = true;
    append_gradient(record, q, to.start);
    append_gradient(record, qd, to.start);
    append_gradient(record, step.q_next, to.end);
    append_gradient(record, step.qd_next, to.end);
    // H is compared between states. With separate memory inside a touch (DerivativeOf::Motion) the
    // gradient keeps H only over the whole touch, so a step inside gets no rates.
    if (step.body_q.range()->data() == step.start) {
      append_rate(q, step.q_next, step.dt, to.rates);
      append_rate(qd, step.qd_next, step.dt, to.rates);
    }
    std::vector<float> wrench;
    if (step.wrench.range != nullptr) append_gradient(record, step.wrench, wrench);
    wrench.resize(6 * step.body_q.rows());
    for_pushes(model, step, [&](const TouchRow& row) {
      to.contacts.push_back(contact_of(model, step, row, wrench));
    });
  }
}

bool find_changes_of_springs(AdjointRecord& record, const std::function<void()>& run) {
  std::map<PairOfWorld, int32_t> numbers;  // index of each pair within its world
  std::map<int32_t, int32_t> count;        // number of pairs per world
  int32_t most = 0;
  for (AdjointRecord::Step& step : record.steps) {
    if (!step.of_springs) continue;
    for (const AdjointRecord::Contact& c : step.contacts) {
      const auto row = static_cast<size_t>(c.row);
      if (step.changes.size() <= row) step.changes.resize(row + 1);
      if (!numbers.contains(pair_of(c))) numbers[pair_of(c)] = count[c.world]++;
      most = std::max(most, count[c.world]);
    }
  }
  for (int32_t number = 0; number < most; ++number) {
    record.holds = [&](const AdjointRecord::Contact& c) { return numbers[pair_of(c)] == number; };
    const HeldPairs visitor(record);
    run();
  }
  record.holds = nullptr;
  return most > 0;
}

}  // namespace novaphy
