#include "launched_solution.h"

#include <cstring>
#include <vector>

#include "vbd_tangent_kernels.h"

namespace novaphy::detail {
const char* vbd_tangent_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// Never destroyed, as those of LaunchedStep.
struct Kernels {
  Kernel<VbdTangentArguments> tangent{vbd_tangent, detail::vbd_tangent_kernels_text};
  Kernel<VbdTangentMoveArguments> move{vbd_tangent_move, detail::vbd_tangent_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

static_assert(sizeof(Row) == sizeof(Vec4f));
Rows download(const DeviceArray<Vec4f>& rows) {
  const std::vector<Vec4f> values = rows.to_host();
  Rows found(values.size());
  for (size_t p = 0; p < found.size(); ++p) found[p] = Vec3f{values[p].x, values[p].y, values[p].z};
  return found;
}
void upload_rows(DeviceArray<Vec4f>& to, const Rows& rows) {
  std::vector<Vec4f> values;
  for (const Row& row : rows) values.push_back({row.x, row.y, row.z, 0.0f});
  to.copy_from_host(std::span<const Vec4f>(values));
}

}  // namespace

void LaunchedSolution::tangent(size_t first_color, size_t last_color, const TangentRows& r) const {
  const std::vector<int64_t>& colors = step_.tables_->colors;
  const int64_t first = colors[first_color], end = colors[last_color];
  novaphy::run(kernels().tangent, (end - first) * kVbdLanes,
               {.sweep = step_.sweep_arguments(with_contacts_, first, end),
                .x = r.x,
                .load = r.load,
                .keeps_loads = int{keeps_loads_},
                .force = r.force,
                .force_slope = r.force_slope,
                .step_slope = r.step_slope});
}

void LaunchedSolution::sweep(const Rows& load, Rows& z, Rows& image) {
  const LaunchedStep::Tables& t = *step_.tables_;
  upload_rows(load_, load);
  reverse_.clear(x_);
  for (size_t color = 0; color + 1 < t.colors.size(); ++color) {
    tangent(color, color + 1, {.x = &x_, .load = &load_, .step_slope = &moved_});
    novaphy::run(kernels().move, (t.colors[color + 1] - t.colors[color]) * kVbdLanes,
                 {.particle = t.particle,
                  .filled = t.filled,
                  .first_group = t.colors[color],
                  .step = moved_,
                  .x = x_});
  }
  reverse_.clear(result_);
  tangent(0, t.colors.size() - 1, {.x = &x_, .force_slope = &result_});
  z = download(x_);
  image = download(result_);
}

Rows LaunchedSolution::force() {
  reverse_.clear(result_);
  tangent(0, step_.tables_->colors.size() - 1, {.force = &result_});
  return download(result_);
}

Rows LaunchedSolution::starts() const { return download(step_.start_); }
Rows LaunchedSolution::positions() const { return download(step_.x_); }
Rows LaunchedSolution::moves() const { return download(step_.moved_); }
void LaunchedSolution::place(const Rows& x, const Rows& moved) {
  upload_rows(step_.x_, x);
  upload_rows(step_.moved_, moved);
}

VbdResidual LaunchedSolution::residual() {
  step_.find_residuals(with_contacts_);
  return step_.last_residual();
}

void LaunchedSolution::reverse_sweep(const Rows& load, Rows& multipliers, Rows& left) {
  const std::vector<int64_t>& colors = step_.tables_->colors;
  upload_rows(reverse_.x_bar_, load);
  reverse_.clear(x_);
  const LaunchedReverse::AtRest rest = {.sum = &x_};
  for (size_t color = colors.size() - 1; color-- > 0;) {
    reverse_.reverse_groups(with_contacts_, weights_, nullptr, colors[color], colors[color + 1],
                            &rest);
    reverse_.receive(color, &reverse_.own_, reverse_.x_bar_);
  }
  multipliers = download(x_);
  left = download(reverse_.x_bar_);
}

// All groups at once, then what particles have of themselves before what others give them.
Rows LaunchedSolution::balance(const Rows& given, const Rows& multipliers) {
  const std::vector<int64_t>& colors = step_.tables_->colors;
  reverse_.clear_parameters(with_contacts_);
  upload_rows(reverse_.x_bar_, given);
  upload_rows(x_, multipliers);
  const LaunchedReverse::AtRest rest = {.multipliers = &x_};
  reverse_.reverse_groups(with_contacts_, weights_, nullptr, 0, colors.back(), &rest);
  for (const int64_t parts : {kVbdReceiveOwn, kVbdReceiveOthers})
    for (size_t color = 0; color + 1 < colors.size(); ++color)
      reverse_.receive(color, &reverse_.own_, reverse_.x_bar_, parts);
  return download(reverse_.x_bar_);
}

Solution LaunchedSolution::run(const VbdLaunchInputs& in, const VbdLaunchResults& out,
                               const VbdGradientOptions& options,
                               const std::shared_ptr<ExclusiveUse>& in_use) {
  const Unobserved unobserved;
  with_contacts_ = in.have_contacts();
  const auto n = static_cast<size_t>(step_.model_.particle_count());
  if (x_.rows() != n)
    for (DeviceArray<Vec4f>* rows : {&x_, &load_, &result_, &moved_})
      *rows = DeviceArray<Vec4f>(n, step_.model_.device());
  step_.run(in, out, in_use);
  step_.check();
  const Solution found = solve_nonlinear(*this, static_cast<double>(options.tolerance),
                                         options.newton_iterations, options.krylov_sweeps);
  step_.finish(out);
  return found;
}

KrylovResult LaunchedSolution::reverse(const VbdLaunchInputs& in, const Array& q_bar,
                                       const Array& qd_bar, const VbdStepArrays& gradients,
                                       const VbdGradientOptions& options) {
  const Unobserved unobserved;
  weights_ = LaunchedReverse::wants_weights(gradients);
  reverse_.begin(with_contacts_, q_bar, qd_bar);
  const Rows given = download(reverse_.x_bar_);
  const KrylovResult found =
      solve_transposed(*this, given, static_cast<double>(options.tolerance), options.krylov_sweeps);
  reverse_.end(with_contacts_, weights_, nullptr, qd_bar);
  reverse_.put(in, gradients, true);
  return found;
}

}  // namespace novaphy::vbd
