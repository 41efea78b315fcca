#include "step_tangent.h"

#include <algorithm>
#include <cmath>

namespace novaphy::vbd {

void StepTangent::reserve() {
  const UntrackedScope untracked;
  if (x_.rows() == step_.x().rows()) return;
  for (Rows4* rows : {&x_, &load_, &result_, &moved_, &loads_at_})
    *rows = Rows4(step_.x().rows(), step_.device());
}

void StepTangent::put(const SweepTangents& along) {
  reserve();
  const UntrackedScope untracked;
  const Device device = step_.device();
  start_ = upload<Vec4f>(along.start, device);
  target_ = upload<Vec4f>(along.target, device);
  mass_ = upload<float>(along.mass, device);
  contacts_ = upload<float>(along.contacts, device);
  numbers_ = upload<float>(along.numbers, device);
  held_ = upload<int32_t>(along.held, device);
  VbdTangentArguments a = arguments(0, step_.colors().size() - 1, true);
  a.x = nullptr;
  novaphy::run(kernels().tangent_start, step_.colors().back() * step_.slots().lanes(), a);
}

VbdTangentArguments StepTangent::arguments(size_t first_color, size_t last_color,
                                           bool along) const {
  const std::vector<int64_t>& colors = step_.colors();
  int64_t begins[kRoles];
  std::copy_n(step_.slots().floats_begin().begin(), int{kRoles}, begins);
  VbdSweepArguments sweep = step_.sweep(colors[first_color], colors[last_color]);
  if (!along) sweep.turns = 0;
  return {.sweep = sweep,
          .x = x_,
          .start = along ? &start_ : nullptr,
          .target = along ? &target_ : nullptr,
          .mass = along ? &mass_ : nullptr,
          .contacts = along ? if_any(contacts_) : nullptr,
          .held = if_any(held_),
          .numbers = along ? &numbers_ : nullptr,
          .begins = begins,
          .load = nullptr,
          .at_solution = int{!along},
          .loads_at = keeps_loads_ ? &loads_at_ : nullptr,
          .force = nullptr,
          .force_tangent = nullptr,
          .step_tangent = nullptr,
          .before = nullptr,
          .after = nullptr};
}

void StepTangent::launch(const VbdTangentArguments& a) const {
  const int64_t groups = a.sweep.end_group - a.sweep.first_group;
  novaphy::run(kernels().tangent, groups * step_.slots().lanes(), a);
}

// Adds the tangents of the steps of a color's particles to the particles' rows of x.
void StepTangent::move(size_t color, const Rows4& x) const {
  const int64_t first = step_.colors()[color], groups = step_.colors()[color + 1] - first;
  novaphy::run(kernels().tangent_move, groups * step_.slots().lanes(),
               {.particle = step_.particles(),
                .filled = step_.filled(),
                .first_group = first,
                .lanes = step_.slots().lanes(),
                .step = moved_,
                .x = x});
}

Rows StepTangent::unrolled(const SweepTangents& along) {
  put(along);
  Rows tangents = along.x;
  for (size_t p = 0; p < tangents.size(); ++p)
    if (!step_.is_kinematic(p)) tangents[p] = along.guess[p];
  upload_rows(x_, tangents);
  const auto iterations = static_cast<size_t>(step_.options().iterations);
  const bool corrects = step_.coarse() != nullptr && iterations > 0;
  const auto copy = [](const Rows4& from, const Rows4& to) {
    novaphy::run(kernels().keep, static_cast<int64_t>(from.rows()), {.x = from, .iterate = to});
  };
  const Rows4 end(x_.rows(), step_.device()), swept(x_.rows(), step_.device());
  copy(step_.x(), end);
  if (iterations > 0) copy(step_.before(0), step_.x());
  for (size_t k = 0; k < iterations; ++k) {
    const Rows4& after = corrects             ? step_.after_sweep(k)
                         : k + 1 < iterations ? step_.before(k + 1)
                                              : end;
    for (size_t color = 0; color + 1 < step_.colors().size(); ++color) {
      VbdTangentArguments a = arguments(color, color + 1, true);
      a.step_tangent = moved_;
      launch(a);
      move(color, x_);
      const int64_t first = step_.colors()[color], groups = step_.colors()[color + 1] - first;
      novaphy::run(kernels().commit, groups * step_.slots().lanes(), step_.commit(first, after));
    }
    if (corrects && k == 0) copy(x_, swept);
    if (corrects) correct(k, swept);
    if (corrects) copy(step_.before(k + 1), step_.x());
  }
  if (corrects) balance();
  copy(end, step_.x());
  return download(x_);
}

// Adds to x the tangent of the coarse step t P A^-1 P^T f, by the tangents of f and of A. The
// matrix A depends on the positions after the first sweep, whose tangents are `swept`.
void StepTangent::correct(size_t iteration, const Rows4& swept) {
  const Coarse& coarse = *step_.coarse();
  const int64_t groups = step_.colors().back();
  VbdCoarseArguments c = coarse.arguments(step_.sweep(0, groups), 0);
  c.force = result_;
  c.sweep.moved = x_;
  c.sweep.x = moved_;  // not used
  const auto add = [&](const Rows4& search) {
    VbdCoarseArguments taken = c;
    taken.search = search;
    novaphy::run(kernels().coarse_load, coarse.functions(), c);
    novaphy::run(kernels().coarse_solve, coarse.threads(), c);
    novaphy::run(kernels().coarse_take, static_cast<int64_t>(x_.rows()), taken);
  };
  VbdTangentArguments a = arguments(0, step_.colors().size() - 1, true);
  a.force_tangent = result_;
  launch(a);
  add(step_.search(iteration));
  a.sweep.x = step_.after_sweep(0);
  a.x = swept;
  a.before = step_.after_sweep(iteration);
  a.after = step_.before(iteration + 1);  // the step d includes its length t
  novaphy::run(kernels().tangent_stiffness, groups * step_.slots().lanes(), a);
  add(coarse.search());
}

void StepTangent::balance() {
  const Coarse& coarse = *step_.coarse();
  const int64_t groups = step_.colors().back();
  VbdTangentArguments a = arguments(0, step_.colors().size() - 1, true);
  a.sweep.turns = 0;  // see StepList::add_coarse_balance
  VbdCoarseArguments c = coarse.arguments(a.sweep, 0);
  novaphy::run(kernels().coarse_outer, groups * step_.slots().lanes(), c);
  a.force_tangent = result_;
  a.before = step_.before(static_cast<size_t>(step_.options().iterations));
  a.after = step_.end();
  launch(a);
  c.force = result_;
  c.sweep.moved = x_;
  c.sweep.x = moved_;  // not used
  novaphy::run(kernels().coarse_balance, coarse.systems(), c);
  novaphy::run(kernels().coarse_shift, static_cast<int64_t>(x_.rows()), c);
}

// Runs a sweep from 0 for a load, at a solution. z is the result, and `image` is the tangent of the
// forces along z.
void StepTangent::sweep(const Rows& load, Rows& z, Rows& image) {
  upload_rows(load_, load);
  x_.zero();
  const size_t colors = step_.colors().size() - 1;
  for (size_t color = 0; color < colors; ++color) {
    VbdTangentArguments a = arguments(color, color + 1, false);
    a.load = load_;
    a.step_tangent = moved_;
    launch(a);
    move(color, x_);
  }
  result_.zero();
  VbdTangentArguments a = arguments(0, colors, false);
  a.force_tangent = result_;
  launch(a);
  z = download(x_);
  image = download(result_);
}

void StepTangent::keep_loads(bool keep) {
  keeps_loads_ = keep;
  if (!keep) return;
  const auto n = static_cast<int64_t>(x_.rows());
  novaphy::run(kernels().keep, n, {.x = step_.x(), .iterate = loads_at_});
}

Rows StepTangent::force() {
  reserve();
  result_.zero();
  VbdTangentArguments a = arguments(0, step_.colors().size() - 1, false);
  a.x = nullptr;
  a.force = result_;
  launch(a);
  return download(result_);
}

// Returns the tangent of the forces along the direction of put() and the tangents x of the
// positions.
Rows StepTangent::force_tangent(const Rows& x) {
  upload_rows(x_, x);
  result_.zero();
  VbdTangentArguments a = arguments(0, step_.colors().size() - 1, true);
  a.at_solution = 1;
  a.force_tangent = result_;
  launch(a);
  return download(result_);
}

Rows StepTangent::implicit(const SweepTangents& along, double tolerance, int32_t sweeps,
                           KrylovResult& result) {
  put(along);
  Rows tangents = along.x;
  // First the load of the linear system: the moving particles have zero tangents. Later the
  // residual of the system.
  Rows load = force_tangent(tangents);
  const auto left = [&](const Rows& x) { return load = force_tangent(x); };
  const auto add_more = [&](const Numbers& asked, std::vector<KrylovResult>& results) {
    Rows more;
    solve_linear(*this, more, load, asked, sweeps, results);
    components().add_scaled(tangents, Flags(results.size(), 1), more);
  };
  result = refine_solution(components(), tangents, Rows(load), tolerance, sweeps, add_more, left);
  return tangents;
}

Solution StepTangent::solve_step(double tolerance, int32_t iterations, int32_t sweeps) {
  const UntrackedScope untracked;
  reserve();
  held_ = {};
  const Solution found = solve_nonlinear(*this, tolerance, iterations, sweeps);
  step_.finish_again();
  return found;
}

}  // namespace novaphy::vbd
