#include "reverse_pass.h"

#include <algorithm>
#include <cmath>

#include "novaphy/core/sim/for_chunks.h"

namespace novaphy::vbd {
namespace {

constexpr int64_t kGroupsPerChunk = 4;
constexpr int64_t kParticlesPerChunk = 256;

}  // namespace

void ReversePass::prepare(bool weights) {
  const size_t n = step.x.size();
  for (Rows* rows : {&x_bar, &own_bar_}) rows->assign(n, {});
  if (builds_ != step.builds) {
    receivers_.build(step.slots, step.model.particle_count());
    builds_ = step.builds;
  }
  bars_ = {};
  for (int role = 0; role < kRoles; ++role) {
    const size_t lanes = step.slots.table(static_cast<Role>(role)).sources.size();
    others_[role].resize(lanes * 3 * static_cast<size_t>(kOthers[role]));
    numbers_[role].resize(lanes * static_cast<size_t>(kFloats[role]));
    bars_.others[role] = others_[role].data();
    bars_.numbers[role] = numbers_[role].data();
  }
  start_bar.resize(n);
  target_bar.resize(n);
  mass_bar.resize(n);
  contact_bars.resize(step.contacts.count() * kContactLawFloats);
  clear_parameters();
  bars_.weights = weights;
  bars_.x = floats(x_bar);
  bars_.own = floats(own_bar_);
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

// Adds what slots of some colours computed for every particle.
void ReversePass::receive(size_t first_color, size_t last_color, Rows& rows) {
  const auto lanes = static_cast<size_t>(step.level.lanes);
  for_chunks(static_cast<int64_t>(rows.size()), kParticlesPerChunk,
             [&](int64_t begin, int64_t end, int64_t) {
               for (int64_t p = begin; p < end; ++p) {
                 const auto row = static_cast<size_t>(p);
                 Vec3f sum = Vec3f(rows[row]) + Vec3f(own_bar_[row]);
                 for (size_t color = first_color; color < last_color; ++color)
                   for (const auto& [role, offset] : receivers_.of(color, p)) {
                     const float* const v = others_[role].data() + offset;
                     sum = sum + Vec3f{v[0], v[lanes], v[2 * lanes]};
                   }
                 rows[row] = sum;
               }
             });
}

// Back through the step of one colour, whose particles stood at `before`.
void ReversePass::reverse_color(size_t color, const Rows& before) {
  const std::vector<int64_t>& colors = step.slots.color_begin();
  const auto lanes = static_cast<int64_t>(step.level.lanes);
  std::fill(own_bar_.begin(), own_bar_.end(), Row());
  if (!bars_.at_rest)
    for (int64_t k = colors[color] * lanes; k < colors[color + 1] * lanes; ++k) {
      const auto p = static_cast<size_t>(step.sweep.particle[k]);
      step.x[p] = before[p];
    }
  for_groups(colors[color], colors[color + 1], step.level.adjoint);
  receive(color, color + 1, x_bar);
}

void ReversePass::begin(const Vec3f* q_bar, const Vec3f* qd_bar) {
  const float inverse_h = 1.0f / step.constants.dt;
  for (size_t p = 0; p < x_bar.size(); ++p) {
    const Vec3f by_v = qd_bar != nullptr ? qd_bar[p] * inverse_h : Vec3f{};
    x_bar[p] = (q_bar != nullptr ? q_bar[p] : Vec3f{}) + by_v;
  }
}

// What the results and the slots have of the start: of v = (x - xn)/h, and of lengths, strains and
// angles.
void ReversePass::finish(const Vec3f* qd_bar) {
  const float inverse_h = 1.0f / step.constants.dt;
  for (size_t p = 0; qd_bar != nullptr && p < start_bar.size(); ++p)
    start_bar[p] = Vec3f(start_bar[p]) - qd_bar[p] * inverse_h;
  std::fill(own_bar_.begin(), own_bar_.end(), Row());
  for_groups(0, step.slots.color_begin().back(), step.level.adjoint_start);
  receive(0, step.slots.color_begin().size() - 1, start_bar);
}

void ReversePass::unrolled(const Vec3f* q_bar, const Vec3f* qd_bar) {
  begin(q_bar, qd_bar);
  const size_t colors = step.slots.color_begin().size() - 1;
  for (size_t k = step.iterates.size() - 1; k-- > 0;)
    for (size_t color = colors; color-- > 0;) reverse_color(color, step.iterates[k]);
  const bool from_target = step.options.initial_guess == VbdInitialGuess::Inertia;
  for (size_t p = 0; p < x_bar.size(); ++p) {
    if (is_held(p)) continue;
    Row& guess = from_target ? target_bar[p] : start_bar[p];
    guess = Vec3f(guess) + Vec3f(x_bar[p]);
  }
  finish(qd_bar);
}

KrylovResult ReversePass::implicit(const Vec3f* q_bar, const Vec3f* qd_bar, double tolerance,
                                   int32_t sweeps) {
  begin(q_bar, qd_bar);
  bars_.at_rest = true;
  const size_t colors = step.slots.color_begin().size() - 1;
  const Rows given = x_bar;
  const auto free_rows = [this](Rows rows) {
    for (size_t p = 0; p < rows.size(); ++p)
      if (is_held(p)) rows[p] = Row();
    return rows;
  };
  Rows residual = free_rows(given), solution(x_bar.size());
  const double scale = std::sqrt(dot(residual, residual));
  KrylovResult result;
  // Until the true residual is small enough: that of the recurrence drifts from it by rounding.
  for (int round = 0; round < kRefinements; ++round) {
    // A sweep in reverse from r takes away from r what the multipliers z that it finds balance.
    Rows more;
    const double asked = kMargin * tolerance * (round > 0 ? 1.0 / result.residual : 1.0);
    const KrylovResult found = solve_krylov(more, residual, asked, sweeps - result.iterations,
                                            [&](const Rows& r, Rows& z, Rows& image) {
                                              x_bar = r;
                                              bars_.x = floats(x_bar);
                                              bars_.multiplier_sum = floats(z);
                                              for (size_t color = colors; color-- > 0;)
                                                reverse_color(color, {});
                                              image = r;
                                              add_scaled(image, -1.0f, free_rows(x_bar));
                                            });
    bars_.multiplier_sum = nullptr;
    add_scaled(solution, 1.0f, more);
    clear_parameters();
    x_bar = given;
    bars_.x = floats(x_bar);
    bars_.multiplier = floats(solution);
    std::fill(own_bar_.begin(), own_bar_.end(), Row());
    for_groups(0, step.slots.color_begin().back(), step.level.adjoint);
    receive(0, colors, x_bar);
    bars_.multiplier = nullptr;
    residual = free_rows(x_bar);
    result.residual = scale > 0.0 ? std::sqrt(dot(residual, residual)) / scale : 0.0;
    result.iterations += found.iterations;
    if (result.residual <= tolerance || result.iterations >= sweeps) break;
  }
  finish(qd_bar);
  return result;
}

float ReversePass::law_bar(Role role, size_t element, int k) const {
  float sum = 0.0f;
  for (size_t c = 0; c < step.slots.table(role).corners; ++c)
    sum += weight_bar(role, element, c, law_begin(role) + k);
  return sum;
}

float ReversePass::weight_bar(Role role, size_t element, size_t corner, int number) const {
  const ColorSlots::Table& table = step.slots.table(role);
  const int64_t place = table.places[element * table.corners + corner];
  if (place < 0) return 0.0f;
  const auto lanes = static_cast<size_t>(step.level.lanes);
  const size_t slot = static_cast<size_t>(place) / lanes, lane = static_cast<size_t>(place) % lanes;
  return numbers_[role][(slot * static_cast<size_t>(kFloats[role]) + static_cast<size_t>(number)) *
                            lanes +
                        lane];
}

}  // namespace novaphy::vbd
