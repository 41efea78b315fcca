#include "reverse_pass.h"

#include <algorithm>

#include "novaphy/core/sim/for_chunks.h"
#include "solution.h"

namespace novaphy::vbd {
namespace {

constexpr int64_t kGroupsPerChunk = 4;
constexpr int64_t kParticlesPerChunk = 256;

}  // namespace

void ReversePass::prepare(bool weights) {
  const size_t n = step.x.size();
  x_bar.assign(n, {});
  if (builds_ != step.builds) {
    receivers_.build(step.slots, step.model.particle_count(), false);
    builds_ = step.builds;
  }
  terms_.resize(static_cast<size_t>(receivers_.terms_begin.back()));
  bars_ = {};
  for (int role = 0; role < kRoles; ++role) {
    const size_t lanes = step.slots.table(static_cast<Role>(role)).sources.size();
    numbers_[role].resize(lanes * static_cast<size_t>(kFloats[role]));
    bars_.others[role] = terms_.data() + receivers_.terms_begin[static_cast<size_t>(role)];
    bars_.numbers[role] = numbers_[role].data();
  }
  start_bar.resize(n);
  target_bar.resize(n);
  mass_bar.resize(n);
  contact_bars.resize(step.contacts.count() * kContactLawFloats);
  clear_parameters();
  bars_.weights = weights;
  bars_.x = floats(x_bar);
  bars_.start = floats(start_bar);
  bars_.target = floats(target_bar);
  bars_.mass_by_h2 = mass_bar.data();
  bars_.contacts = contact_bars.data();
}

void ReversePass::clear_parameters() {
  for (Rows* rows : {&start_bar, &target_bar}) std::fill(rows->begin(), rows->end(), Row());
  for (std::vector<float>* rows : {&mass_bar, &contact_bars})
    std::fill(rows->begin(), rows->end(), 0.0f);
  for (std::vector<float>& rows : numbers_) std::fill(rows.begin(), rows.end(), 0.0f);
}

template <class Function>
void ReversePass::for_groups(int64_t begin, int64_t end, Function&& function) {
  for_chunks(end - begin, kGroupsPerChunk, [&](int64_t first, int64_t last, int64_t) {
    for (int64_t g = begin + first; g < begin + last; ++g) function(step.sweep, bars_, g);
  });
}

// Adds what slots of a colour computed for every particle.
void ReversePass::receive(size_t color, Rows& rows) {
  const Receivers& r = receivers_;
  const int64_t first = r.color_begin[color];
  const VbdReceiveArguments arguments = {.particle = direct(r.particle),
                                         .begin = direct(r.begin),
                                         .others = direct(r.others),
                                         .entries = direct(r.entries),
                                         .first = first,
                                         .lanes = step.level.lanes,
                                         .terms = direct(terms_.data()),
                                         .is_own = direct(r.is_own),
                                         .own = nullptr,
                                         .rows = direct(rows),
                                         .parts = kVbdReceiveAll};
  const int64_t n = r.color_begin[color + 1] - first;
  for_chunks(n, kParticlesPerChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t row = begin; row < end; ++row) vbd_receive_row(arguments, row, n);
  });
}

// Back through the step of one colour, whose particles stood at `before`.
void ReversePass::reverse_color(size_t color, const Rows& before) {
  const std::vector<int64_t>& colors = step.slots.color_begin();
  const auto lanes = static_cast<int64_t>(step.level.lanes);
  if (!bars_.at_rest)
    for (int64_t k = colors[color] * lanes; k < colors[color + 1] * lanes; ++k) {
      const auto p = static_cast<size_t>(step.sweep.particle[k]);
      step.x[p] = before[p];
    }
  for_groups(colors[color], colors[color + 1], step.level.adjoint);
  receive(color, x_bar);
}

void ReversePass::begin(const Vec3f* q_bar, const Vec3f* qd_bar) {
  const auto n = static_cast<int64_t>(x_bar.size());
  const VbdAdjointBeginArguments arguments = {.q_bar = direct(q_bar),
                                              .qd_bar = direct(qd_bar),
                                              .inverse_h = 1.0f / step.constants.dt,
                                              .x_bar = direct(x_bar)};
  for (int64_t p = 0; p < n; ++p) vbd_adjoint_begin_row(arguments, p, n);
}

// What the guess, the results and the slots have of the start: of v = (x - xn)/h, and of lengths,
// strains and angles.
void ReversePass::end(Row* guess, const Vec3f* qd_bar) {
  const auto n = static_cast<int64_t>(x_bar.size());
  const VbdAdjointEndArguments arguments = {.is_held = direct(step.slots.held_flags()),
                                            .x_bar = direct(x_bar),
                                            .guess = direct(guess),
                                            .qd_bar = direct(qd_bar),
                                            .inverse_h = 1.0f / step.constants.dt,
                                            .start_bar = direct(start_bar)};
  for (int64_t p = 0; p < n; ++p) vbd_adjoint_end_row(arguments, p, n);
  const std::vector<int64_t>& colors = step.slots.color_begin();
  for (size_t color = 0; color + 1 < colors.size(); ++color) {
    for_groups(colors[color], colors[color + 1], step.level.adjoint_start);
    receive(color, start_bar);
  }
}

void ReversePass::unrolled(const Vec3f* q_bar, const Vec3f* qd_bar) {
  begin(q_bar, qd_bar);
  const size_t colors = step.slots.color_begin().size() - 1;
  for (size_t k = step.iterates.size() - 1; k-- > 0;)
    for (size_t color = colors; color-- > 0;) reverse_color(color, step.iterates[k]);
  if (step.looked_back()) return end(nullptr, qd_bar);  // see vbd_particle_gradient
  const bool from_start = step.options.initial_guess == VbdInitialGuess::Previous;
  end((from_start ? start_bar : target_bar).data(), qd_bar);
}

void ReversePass::reverse_sweep(const Rows& load, Rows& multipliers, Rows& left) {
  x_bar = load;
  bars_.x = floats(x_bar);
  bars_.multiplier_sum = floats(multipliers);
  for (size_t color = step.slots.color_begin().size() - 1; color-- > 0;) reverse_color(color, {});
  bars_.multiplier_sum = nullptr;
  left = x_bar;
}

const Rows& ReversePass::balance(const Rows& given, Rows& multipliers) {
  const size_t colors = step.slots.color_begin().size() - 1;
  clear_parameters();
  x_bar = given;
  bars_.x = floats(x_bar);
  bars_.multiplier = floats(multipliers);
  for_groups(0, step.slots.color_begin().back(), step.level.adjoint);
  for (size_t color = 0; color < colors; ++color) receive(color, x_bar);
  bars_.multiplier = nullptr;
  return x_bar;
}

KrylovResult ReversePass::implicit(const Vec3f* q_bar, const Vec3f* qd_bar, double tolerance,
                                   int32_t sweeps) {
  begin(q_bar, qd_bar);
  bars_.at_rest = true;
  const Rows given = x_bar;
  const KrylovResult result = solve_transposed(*this, given, tolerance, sweeps);
  end(nullptr, qd_bar);
  return result;
}

}  // namespace novaphy::vbd
