#include "novaphy/dynamics/semi_implicit/diff_touches.h"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "diff_touch_motion.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/math/spatial.h"
#include "novaphy/nova/op_list.h"

namespace novaphy::diff {

using namespace detail;
using math::cross;
using math::dot;

namespace {

constexpr int32_t kMostSteps = 200;      // largest number of steps of a touch that is one event
constexpr double kLeastApproach = 1e-3;  // m/s

template <class T>
DeviceArray<T> array_of(const DeviceArray<T>& like) {
  return DeviceArray<T>(like.rows(), like.device());
}

}  // namespace

TouchedStep::TouchedStep(const SimState& from, SimState& to) : in(&from), out(&to) {}
TouchedStep::TouchedStep(TouchedStep&&) noexcept = default;
TouchedStep::~TouchedStep() = default;

TouchMotion::TouchMotion(const Model& model, const TouchSettings& settings)
    : impl_(std::make_unique<Impl>(settings, model)) {
  impl_->jointed.assign(static_cast<size_t>(model.body_count()), 0);
  impl_->off_of_bodies.resize(static_cast<size_t>(model.body_count()));
  impl_->off_of_particles.resize(static_cast<size_t>(model.particle_count()));
  if (!settings.jointed) return;
  const std::vector<int32_t> type = model.joint_type.to_host(),
                             parent = model.joint_parent.to_host(),
                             child = model.joint_child.to_host();
  for (size_t j = 0; j < type.size(); ++j) {
    if (type[j] == static_cast<int32_t>(JointType::FREE)) continue;
    for (const int32_t body : {parent[j], child[j]})
      if (body >= 0) impl_->jointed[static_cast<size_t>(body)] = 1;
  }
}
TouchMotion::~TouchMotion() = default;

void TouchMotion::Impl::begin_touch(const Model& m, const SimState& in, const TouchRow& row,
                                    bool follows_last, float dt, TouchList& a, TouchList& b) {
  const auto event = std::make_shared<TouchEvent>();
  event->first = row.first;
  event->second = row.second;
  event->point = row.point;
  event->stiff_angle = double{dt} * std::sqrt(row.stiffness * row.inverse_mass);
  event->approach = -row.speed;
  event->begin = number;
  event->shakes = row.slip_taken > kMostSlipTaken;
  event->rubs = row.slip_taken > 0.0;
  event->slides = row.slides;
  for (const TouchSide& side : row.sides)
    if (side.responds) event->speed_off = std::max(event->speed_off, speed_off(side));
  event->speed_off += row.speed_taken + event->stiff_angle * event->stiff_angle / 7.0;
  for (const TouchSide& side : row.sides)
    if (side.responds) speed_off(side) = event->speed_off;
  if (!follows_last) event->flaw = TouchFlaw::OneSided;
  if (!(event->approach > kLeastApproach) && event->flaw == TouchFlaw::None)
    event->flaw = TouchFlaw::Rests;
  constexpr double kSign[] = {1.0, -1.0};
  for (size_t i = 0; i < 2 && event->approach > kLeastApproach; ++i) {
    const Vec3d n = row.normal * (kSign[i] / event->approach);
    event->delay_by[i] = {n, cross(row.sides[i].arm, n), {}, {}};
    const double arm = dot(row.sides[i].arm, row.sides[i].arm),
                 turn = dot(event->delay_by[i][kTurn], event->delay_by[i][kTurn]);
    if (event->flaw == TouchFlaw::None && turn > 1e-6 * arm * dot(n, n)) event->turns = true;
  }
  event->listed = list_touch(
      m, row, *event, {frame_of(m, in, row.sides[0]), frame_of(m, in, row.sides[1])}, time, dt);
  event->listed->chain = chain;
  event->listed->step = number;
  event->listed->start = place(in).first;
  event->listed->version =
      settings.bodies ? in.body_q.range()->version() : in.particle_q.range()->version();
  for (TouchList* list : {&a, &b}) list->events.push_back(event);
  const auto [first, last] = waiting.equal_range(pair_key(row));
  for (auto ramp = first; ramp != last; ++ramp) ramp->second->event = event;
  open.push_back({event, nullptr});
  open_of[pair_key(row)] = event;
}

void TouchMotion::Impl::find_steps(const Model& m, TouchedStep& step, bool follows_last, float dt,
                                   TouchList& a, TouchList& b) {
  // A row that pushes, and whose pair has no open touch, begins a touch.
  for (const TouchRow& row : rows)
    if (row.pushes && !open_of.contains(pair_key(row)))
      begin_touch(m, *step.in, row, follows_last, dt, a, b);
  find_changes();
  closing.clear();
  closing_of.clear();
  for (Open& o : open) {
    TouchEvent& event = *o.event;
    const TouchRow* mine = nullptr;
    bool several = false, held = false;
    for (const int32_t k : index.of_pair(pair_key(event))) {
      const TouchRow& row = rows[static_cast<size_t>(k)];
      several = several || mine != nullptr || row.point != event.point;
      held = held || row.adheres || is_held(row.sides[0]) || is_held(row.sides[1]);
      mine = &row;
    }
    std::array<TouchSide, 2> sides;
    if (mine != nullptr) sides = mine->sides;
    if (mine == nullptr && o.last != nullptr)
      sides = {o.last->start[0].side, o.last->start[1].side};
    several = meets_others(event, sides) || several;
    if (event.flaw == TouchFlaw::None && several) event.flaw = TouchFlaw::Several;
    if (event.flaw == TouchFlaw::None && held) event.flaw = TouchFlaw::Held;
    if (mine == nullptr) {
      event.ended = true;
      open_of.erase(pair_key(event));
      closing_of[pair_key(event)] = o.event;
      closing.push_back(std::move(o));
      continue;
    }
    watch_friction(*mine, several, event);
    if (event.steps >= kMostSteps && event.flaw == TouchFlaw::None) event.flaw = TouchFlaw::Long;
    if (event.flaw == TouchFlaw::None) {
      const auto s = std::make_shared<TouchStep>();
      s->event = o.event;
      s->number = event.steps;
      for (size_t k = 0; k < 2; ++k) {
        s->start[k] = frame_of(m, *step.in, mine->sides[k]);
        s->applied[k] = applied(step, mine->sides[k]);
        if (event.steps > 0) continue;
        // Subtracts the acceleration by the touch's force.
        const Vec3d force = mine->force * (k == 0 ? 1.0 : -1.0);
        const auto without = respond(m, s->start[k], force, cross(mine->sides[k].arm, force));
        s->before[k][kVelocity] = without[0];
        s->before[k][kSpin] = without[1];
      }
      step.work->steps.push_back(s);
    }
    ++event.steps;
  }
  std::erase_if(open, [](const Open& o) { return o.event == nullptr; });
}

void TouchMotion::Impl::find_ramps(const Model& m, TouchedStep& step, TouchList& a, TouchList& b) {
  waiting.clear();
  for (const TouchRow& row : rows) {
    if (!row.ramp) continue;
    const auto ramp = std::make_shared<TouchRamp>(TouchRamp{row, {}, nullptr});
    for (size_t i = 0; i < 2; ++i) ramp->frames[i] = frame_of(m, *step.in, row.sides[i]);
    for (const auto* touches : {&open_of, &closing_of})
      if (const auto of = touches->find(pair_key(row)); of != touches->end())
        ramp->event = of->second;
    if (ramp->event == nullptr) waiting.emplace(pair_key(row), ramp);
    step.work->ramps.push_back(ramp);
  }
  if (!step.work->ramps.empty())
    for (TouchList* list : {&a, &b}) ++list->ramp_steps;
}

// Gives the kernels separate memory for states and forces, and records the effect of the touches on
// derivatives.
void TouchMotion::Impl::move(const Model& m, TouchedStep& step) const {
  const SimState &in = *step.in, &out = *step.out;
  StateFields from = in, to = out;
  const auto fresh = [](auto& array) {
    if (array.rows() > 0) array = array_of(array);
  };
  if (settings.bodies) {
    fresh(from.body_q);
    fresh(from.body_qd);
    fresh(from.body_f);
  }
  if (settings.particles) {
    fresh(from.particle_q);
    fresh(from.particle_qd);
    fresh(from.particle_f);
  }
  if (!step.work->steps.empty()) {
    if (settings.bodies) {
      fresh(to.body_q);
      fresh(to.body_qd);
    }
    if (settings.particles) {
      fresh(to.particle_q);
      fresh(to.particle_qd);
    }
    step.moved_out = std::make_unique<SimState>(m, to);
  }
  const TouchArrays before = arrays(in, step.body_forces, step.forces);
  if (settings.bodies) step.body_forces = nova::operand_of(from.body_f);
  if (settings.particles) step.forces = nova::operand_of(from.particle_f);
  step.moved_in = std::make_unique<SimState>(m, from);
  if (settings.bodies) step.work->of_record = from.body_q.range()->data();
  step.work->dt = double{last_dt};
  record_touches(step.work, true, before, arrays(from, step.body_forces, step.forces));
}

TouchedStep TouchMotion::begin(const Model& model, const SimState& in, SimState& out,
                               const nova::Operand& forces, const nova::Operand& body_forces,
                               const Control* control, const Contacts* contacts, float kf_rate,
                               float dt, TouchList& of_chain, TouchList& of_tape) {
  Impl& t = *impl_;
  nova::flush_deferred();
  TouchedStep step(in, out);
  step.forces = forces;
  step.body_forces = body_forces;
  step.work = std::make_shared<TouchWork>();
  step.work->may_hold = t.settings.may_hold;
  // Forces of joints act on unattached bodies too. Their change within a touch is not modeled, so a
  // change of control cuts the touch.
  const bool same = !t.settings.jointed || t.last_control == control;
  const bool follows = t.follows(in, dt);
  t.last_control = control;
  if (!follows || !same) {
    for (const Impl::Open& o : t.open)
      if (o.event->flaw == TouchFlaw::None) o.event->flaw = TouchFlaw::OneSided;
    if (!follows) {
      t.open.clear();
      t.open_of.clear();
      t.waiting.clear();
      std::ranges::fill(t.off_of_bodies, 0.0);
      std::ranges::fill(t.off_of_particles, 0.0);
    }
    if (t.at_q != t.place(in).first) of_chain.clear();
  }
  const bool continues = std::pair(t.at_q, t.at_version) == t.place(in);
  t.number = continues ? t.number + 1 : 0;
  t.time = continues ? t.time + double{t.last_dt} : 0.0;
  if (!continues) ++t.chain;
  t.last_dt = dt;
  t.rows.clear();
  if (contacts != nullptr)
    find_touches(model, in, *contacts,
                 {t.settings.rigid, t.settings.soft, t.settings.smoothing, kf_rate, dt}, t.rows);
  t.index.build(t.rows);
  const int64_t limits = t.find_limits(model, in, follows);
  for (TouchList* list : {&of_chain, &of_tape}) list->limits += limits;
  t.find_steps(model, step, follows, dt, of_chain, of_tape);
  t.find_ramps(model, step, of_chain, of_tape);
  if (!step.work->steps.empty() || !step.work->ramps.empty()) {
    for (TouchList* list : {&of_chain, &of_tape}) list->works.push_back(step.work);
    t.move(model, step);
  }
  return step;
}

void TouchMotion::end(const Model& model, TouchedStep& step) {
  Impl& t = *impl_;
  nova::flush_deferred();
  const SimState &from = step.from(), &to = step.to();
  // Returns the mean acceleration of a side over the step, from the states on the tape.
  const auto acceleration = [&](const TouchSide& side) {
    const auto v0 = rates_of(from, side), v1 = rates_of(to, side);
    const double by = 1.0 / double{t.last_dt};
    return std::array<Vec3d, 2>{(v1[0] - v0[0]) * by, (v1[1] - v0[1]) * by};
  };
  // Sets the accelerations after the last step of a touch: those of this step, but with the
  // external forces of that last step.
  const auto finish = [&](TouchStep& last) {
    for (size_t k = 0; k < 2; ++k) {
      const TouchSide& side = last.end[k].side;
      const auto a = acceleration(side), now = t.applied(step, side);
      const auto change =
          respond(model, last.end[k], now[0] - last.applied[k][0], now[1] - last.applied[k][1]);
      last.after[k][kVelocity] = a[0] - change[0];
      last.after[k][kSpin] = a[1] - change[1];
    }
  };
  for (const Impl::Open& o : t.closing) {
    if (o.last == nullptr || o.event->flaw != TouchFlaw::None) continue;
    finish(*o.last);
    o.event->whole = true;
  }
  t.closing.clear();
  auto open = t.open.begin();
  for (const auto& s : step.work->steps) {  // in the order of their touches
    while (open->event != s->event) ++open;
    if (open->last != nullptr) finish(*open->last);
    open->last = s;
    for (size_t k = 0; k < 2; ++k) {
      const TouchSide& side = s->start[k].side;
      s->end[k] = frame_of(model, to, side);
      const auto v0 = rates_of(from, side), v1 = rates_of(to, side), a = acceleration(side);
      s->before[k] = {v0[0], v0[1], s->before[k][kVelocity] + a[0], s->before[k][kSpin] + a[1]};
      s->after[k] = {v1[0], v1[1], {}, {}};
    }
    if (s->number > 0) continue;
    double push = 0.0;  // speed from one step's forces, relative to the approach
    for (size_t k = 0; k < 2; ++k)
      push +=
          product(s->event->delay_by[k], {s->before[k][kVelocity], s->before[k][kSpin], {}, {}});
    if (std::abs(push) * double{t.last_dt} > 1.0) s->event->flaw = TouchFlaw::Rests;
  }
  if (step.moved_out)
    record_touches(step.work, false, t.arrays(to, {}, {}), t.arrays(*step.out, {}, {}));
  std::tie(t.at_q, t.at_version) = t.place(*step.out);
  t.remember(*step.in, *step.out, t.at_version);
}

bool TouchMotion::alternates(const SimState& in) const {
  const auto [memory, version] = impl_->place(in);
  const auto found = impl_->ends.find(memory);
  if (memory == impl_->at_q || found == impl_->ends.end()) return false;
  const Impl::End& end = found->second;
  return !end.memory.expired() && (end.version == version || end.version == Impl::kUnknown);
}

void TouchMotion::hold(const SimState& in, const SimState& out, const char* where,
                       TouchList& of_chain, TouchList& of_tape) {
  Impl& t = *impl_;
  if (t.at_q != t.place(in).first) of_chain.clear();
  of_chain.held = of_tape.held = where;
  // The next step continues the chain, but no touch.
  t.at_q = t.place(out).first;
  t.at_version = Impl::kUnknown;
  t.remember(in, out, Impl::kUnknown);
}

}  // namespace novaphy::diff
