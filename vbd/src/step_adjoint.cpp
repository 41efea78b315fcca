#include "step_adjoint.h"

#include "solution.h"

namespace novaphy::vbd {
namespace {

constexpr int64_t kGroupsPerChunk = 4;  // groups that a CPU thread takes at a time

}  // namespace

void StepAdjoint::build_tables() {
  const ColorSlots& slots = step_.slots();
  const Device device = step_.device();
  const auto lanes = static_cast<size_t>(slots.lanes());
  Receivers r;
  r.build(slots, step_.model().particle_count(), !step_.on_cpu());
  Tables t;
  t.builds = step_.builds();
  t.color_begin = r.color_begin;
  t.particle = upload<int32_t>(r.particle, device);
  t.is_own = upload<int32_t>(r.is_own, device);
  t.begin = upload<uint64_t>(r.begin, device);
  t.others = upload<uint64_t>(r.others, device);
  t.entries = upload<uint64_t>(r.entries, device);
  std::vector<int64_t> begins;
  std::vector<int32_t> particle;
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots.table(role);
    const size_t before = particle.size();
    begins.push_back(static_cast<int64_t>(before));
    particle.resize(before + table.sources.size(), -1);
    for (size_t g = 0; g + 1 < table.begin.size(); ++g)
      for (auto s = static_cast<size_t>(table.begin[g]);
           s < static_cast<size_t>(table.begin[g + 1]); ++s)
        for (size_t lane = 0; lane < lanes; ++lane)
          if (table.sources[s * lanes + lane].element >= 0)
            particle[before + s * lanes + lane] = slots.particles()[g * lanes + lane];
    t.places[role] = upload<uint64_t>(table.places, device);
  }
  t.slot_particle = upload<int32_t>(particle, device);
  begins.insert(begins.end(), r.terms_begin.begin(), r.terms_begin.begin() + kRoles);
  begins.insert(begins.end(), slots.floats_begin().begin(), slots.floats_begin().begin() + kRoles);
  t.begins = upload<uint64_t>(begins, device);
  const IndexRows worlds = particles_of_worlds(step_.host_model());
  t.world_begin = upload<int32_t>(worlds.begins().data(), worlds.begins().size(), device);
  t.of_worlds = upload<int32_t>(worlds.all().data(), worlds.all().size(), device);
  tables_ = std::move(t);
  terms_ = DeviceArray<float>(static_cast<size_t>(r.terms_begin.back()), device);
  numbers_ = DeviceArray<float>(static_cast<size_t>(slots.floats_begin().back()), device);
}

void StepAdjoint::reserve() {
  const UntrackedScope untracked;
  const Device device = step_.device();
  const auto n = static_cast<size_t>(step_.model().particle_count());
  if (tables_.builds != step_.builds()) build_tables();
  if (x_bar_.rows() != n) {
    for (Rows4* rows :
         {&x_bar_, &u_, &d_, &own_, &start_bar_, &target_bar_, &gravity_bar_, &multipliers_})
      *rows = Rows4(n, device);
    mass_adjoint_ = DeviceArray<float>(n, device);
  }
  if (step_.coarse() != nullptr)
    while (fields_.size() < static_cast<size_t>(step_.options().iterations))
      fields_.emplace_back(n, device);
  const size_t contacts = step_.contact_items().rows();  // capacity for contacts
  if (contact_adjoints_.rows() == contacts * kContactLawFloats) return;
  contact_adjoints_ = DeviceArray<float>(contacts * kContactLawFloats, device);
  shape_of_contact_ = DeviceArray<int32_t>(contacts, device);
  of_shapes_ = DeviceArray<int32_t>(contacts, device);
  shape_begin_ = DeviceArray<int32_t>(static_cast<size_t>(step_.model().shape_count()) + 1, device);
}

// Returns the arguments of a launch over the groups [first, end).
VbdAdjointArguments StepAdjoint::arguments(const Rows4* before, int64_t first, int64_t end) const {
  int64_t first_lanes[kRoles], ends[kRoles], threads = 0;
  for (int role = 0; role < kRoles; ++role) {
    const std::vector<int64_t>& slots = step_.slots().table(role).begin;
    const int64_t begin = slots[static_cast<size_t>(first)];
    first_lanes[role] = begin * kVbdLanes;
    threads += (slots[static_cast<size_t>(end)] - begin) * kVbdLanes;
    ends[role] = threads;
  }
  VbdSweepArguments sweep = step_.sweep(first, end);
  if (key_.at_solution) sweep.turns = 0;
  return {.sweep = sweep,
          .before = before,
          .x_adjoint = x_bar_,
          .u = u_,
          .d = d_,
          .own = own_,
          .start_adjoint = start_bar_,
          .target_adjoint = target_bar_,
          .mass_adjoint = mass_adjoint_,
          .contact_adjoints = key_.with_contacts ? &contact_adjoints_ : nullptr,
          .at_solution = int{key_.at_solution},
          .weights = int{key_.weights},
          .multiplier = nullptr,
          .after = nullptr,
          .multiplier_sum = nullptr,
          .slot_particle = tables_.slot_particle,
          .terms = terms_,
          .numbers = numbers_,
          .begins = tables_.begins,
          .first = first_lanes,
          .ends = ends};
}

void StepAdjoint::add_receive(size_t color, const Rows4* own, const Rows4& rows, int64_t parts) {
  const Tables& t = tables_;
  list_->add(kernels().receive, t.color_begin[color + 1] - t.color_begin[color],
             {.particle = t.particle,
              .begin = t.begin,
              .others = t.others,
              .entries = t.entries,
              .first = t.color_begin[color],
              .lanes = step_.slots().lanes(),
              .terms = terms_,
              .is_own = t.is_own,
              .own = own,
              .rows = rows,
              .parts = parts});
}

// Adds the launches of the reverse step of some groups. The sums over receivers are added
// separately.
void StepAdjoint::add_groups(const VbdAdjointArguments& a, bool at_solution) {
  const int64_t groups = a.sweep.end_group - a.sweep.first_group, lanes = step_.slots().lanes();
  const Kernel<VbdAdjointArguments>& slots =
      at_solution ? kernels().adjoint_solution : kernels().adjoint_slots;
  if (step_.on_cpu()) {
    list_->add(slots, groups * lanes, a, kGroupsPerChunk * lanes);
    return;
  }
  if (key_.block_groups == 0 || a.multiplier.word() != 0) {
    list_->add(kernels().adjoint_solve, groups * lanes, a);
  } else {
    list_->add(kernels().adjoint_solve_by_blocks, block_threads(groups, key_.block_groups), a);
  }
  list_->add(slots, a.ends[kRoles - 1], a);
}

void StepAdjoint::add_everywhere(const VbdAdjointArguments& a) {
  add_groups(a, true);
  add_receive_all();
}

// The loop first adds the particle's own terms, then the terms from other particles.
void StepAdjoint::add_receive_all() {
  for (const int64_t parts : {kVbdReceiveOwn, kVbdReceiveOthers})
    for (size_t color = 0; color + 1 < step_.colors().size(); ++color)
      add_receive(color, &own_, x_bar_, parts);
}

// The reverse of the balance. The translation s solves B s = F for a free system. F is the sum of
// the forces, and B is the sum of the stiffnesses of inertia and contacts.
void StepAdjoint::add_coarse_balance() {
  const Coarse& coarse = *step_.coarse();
  const auto last = static_cast<size_t>(step_.options().iterations);
  const int64_t groups = step_.colors().back(), lanes = groups * step_.slots().lanes();
  VbdAdjointArguments a = arguments(&step_.before(last), 0, groups);
  a.sweep.x = step_.before(last);
  a.sweep.turns = 0;  // see StepList::add_coarse_balance
  a.after = step_.end();
  a.multiplier = multipliers_;
  VbdCoarseArguments c = coarse.arguments(a.sweep, 0);
  list_->add(kernels().coarse_outer, lanes, c);
  c.force = x_bar_;  // the adjoint of s is the sum of the positions' adjoints
  list_->add(kernels().coarse_balance, coarse.systems(), c);
  const auto n = static_cast<int64_t>(multipliers_.rows());
  list_->add(kernels().clear, 4 * n, {.values = Untyped(multipliers_)});
  c.sweep.moved = multipliers_;
  c.sweep.x = own_;  // not used
  list_->add(kernels().coarse_shift, n, c);
  list_->add(kernels().adjoint_outer, lanes, a);
}

// The adjoint of the coarse step x += t P A^-1 P^T f (coarse_kernels.h) with constant A. Let xbar
// be the adjoint of x. The forces f get the adjoint t P A^-1 P^T xbar.
void StepAdjoint::add_coarse_step(size_t iteration) {
  const Coarse& coarse = *step_.coarse();
  const int64_t groups = step_.colors().back();
  const auto n = static_cast<int64_t>(multipliers_.rows());
  list_->add(kernels().keep, n, {.x = step_.after_sweep(iteration), .iterate = step_.x()});
  VbdCoarseArguments c = coarse.arguments(step_.sweep(0, groups), 0);
  c.force = x_bar_;
  list_->add(kernels().coarse_load, coarse.functions(), c);
  list_->add(kernels().coarse_solve, coarse.threads(), c);
  c.search = step_.search(iteration);
  c.sweep.moved = fields_[iteration];
  c.force = multipliers_;
  list_->add(kernels().coarse_fields, n, c);
  VbdAdjointArguments a = arguments(nullptr, 0, groups);
  a.at_solution = 1;
  a.multiplier = multipliers_;
  add_everywhere(a);
}

// All coarse steps share the matrix A. Each step d with its field u adds the adjoint of -u.(H d).
void StepAdjoint::add_coarse_matrices() {
  const int64_t groups = step_.colors().back();
  for (size_t k = 0; k < fields_.size(); ++k) {
    VbdAdjointArguments a = arguments(&step_.after_sweep(k), 0, groups);
    a.sweep.x = step_.after_sweep(0);
    a.after = step_.before(k + 1);
    a.multiplier = fields_[k];
    list_->add(kernels().adjoint_stiffness, groups * step_.slots().lanes(), a);
    add_receive_all();
  }
}

// Adds the adjoint of the slots' values at the start of the step. On the CPU a particle adds its
// own part when its color is visited.
void StepAdjoint::add_starts() {
  const std::vector<int64_t>& colors = step_.colors();
  const int64_t lanes = step_.slots().lanes();
  if (!step_.on_cpu()) {
    const VbdAdjointArguments a = arguments(nullptr, 0, colors.back());
    list_->add(kernels().adjoint_start, a.ends[kRoles - 1], a);
  }
  for (size_t color = 0; color + 1 < colors.size(); ++color) {
    const int64_t first = colors[color], end = colors[color + 1];
    if (step_.on_cpu())
      list_->add(kernels().adjoint_start, (end - first) * lanes, arguments(nullptr, first, end),
                 kGroupsPerChunk * lanes);
    add_receive(color, nullptr, start_bar_);
  }
}

void StepAdjoint::make_list(const VbdAdjointBeginArguments& begin,
                            const VbdAdjointEndArguments& end) {
  const std::vector<int64_t>& colors = step_.colors();
  const int64_t n = step_.model().particle_count();
  list_.emplace(step_.device());
  const auto clear = [&](const Array& values) {
    list_->add(kernels().clear, static_cast<int64_t>(values.bytes() / sizeof(float)),
               {.values = Untyped(values)});
  };
  for (const Array* rows :
       std::initializer_list<const Array*>{&start_bar_, &target_bar_, &mass_adjoint_, &numbers_})
    clear(*rows);
  if (key_.with_contacts) clear(contact_adjoints_);
  begin_ = list_->add(kernels().adjoint_begin, n, begin);
  sweeps_ = list_->size();
  const auto add_colors = [&](const Rows4* iterate, const Rows4* sum) {
    for (size_t color = colors.size() - 1; color-- > 0;) {
      const int64_t first = colors[color], groups = colors[color + 1] - first;
      const bool commits = iterate != nullptr && step_.slots().has_conflicts();
      if (commits)
        list_->add(kernels().commit, groups * step_.slots().lanes(), step_.commit(first, *iterate));
      VbdAdjointArguments a = arguments(commits ? nullptr : iterate, first, colors[color + 1]);
      a.multiplier_sum = sum;
      add_groups(a, key_.at_solution);
      add_receive(color, &own_, x_bar_);
    }
  };
  if (key_.at_solution) {
    add_colors(nullptr, &multipliers_);
  } else {
    const auto iterations = static_cast<size_t>(step_.options().iterations);
    const bool corrects = step_.coarse() != nullptr && iterations > 0;
    if (corrects) add_coarse_balance();
    for (size_t k = iterations; k-- > 0;) {
      if (corrects) add_coarse_step(k);
      if (corrects && k == 0) add_coarse_matrices();
      add_colors(&step_.before(k), nullptr);
    }
  }
  balance_ = list_->size();
  if (key_.at_solution) {
    VbdAdjointArguments a = arguments(nullptr, 0, colors.back());
    a.multiplier = multipliers_;
    add_everywhere(a);
  }
  end_ = list_->add(kernels().adjoint_end, n, end);
  add_starts();
}

// Prepares the list of launches for a step that has run.
void StepAdjoint::prepare(const StepInputs& in, const ResultAdjoints& adjoints,
                          const StepDerivatives& to, bool at_solution) {
  reserve();
  const float inverse_h = 1.0f / step_.dt();
  // The array that receives the adjoint of the initial guess, see vbd_particle_gradient.
  const bool from_start = step_.options().initial_guess == VbdInitialGuess::Previous;
  const Rows4* const guess = at_solution || step_.looks_back(in) ? nullptr
                             : from_start                        ? &start_bar_
                                                                 : &target_bar_;
  const VbdAdjointBeginArguments begin = {.q_adjoint = if_any(adjoints.q),
                                          .qd_adjoint = if_any(adjoints.qd),
                                          .inverse_h = inverse_h,
                                          .x_adjoint = x_bar_};
  const VbdAdjointEndArguments end = {.is_kinematic = step_.is_kinematic(),
                                      .x_adjoint = x_bar_,
                                      .guess = guess,
                                      .qd_adjoint = if_any(adjoints.qd),
                                      .inverse_h = inverse_h,
                                      .start_adjoint = start_bar_};
  const Key key = {.version = step_.version(),
                   .block_groups = step_.block_groups(),
                   .with_contacts = step_.has_contacts(),
                   .damps = step_.damps(),
                   .weights = wants(to, kRestShape),
                   .at_solution = at_solution};
  if (list_ && key == key_) {
    list_->set(begin_, begin);
    list_->set(end_, end);
    return;
  }
  key_ = key;
  make_list(begin, end);
}

void StepAdjoint::unrolled(const StepInputs& in, const ResultAdjoints& adjoints,
                           const StepDerivatives& to) {
  prepare(in, adjoints, to, false);
  list_->run();
  put(in, to);
}

KrylovResult StepAdjoint::implicit(const StepInputs& in, const ResultAdjoints& adjoints,
                                   const StepDerivatives& to, double tolerance, int32_t sweeps) {
  prepare(in, adjoints, to, true);
  list_->run(0, sweeps_);
  const KrylovResult found = solve_transposed(*this, download(x_bar_), tolerance, sweeps);
  list_->run(end_.number, list_->size());
  put(in, to);
  return found;
}

void StepAdjoint::reverse_sweep(const Rows& load, Rows& multipliers, Rows& left) {
  upload_rows(x_bar_, load);
  multipliers_.zero();
  list_->run(sweeps_, balance_);
  multipliers = download(multipliers_);
  left = download(x_bar_);
}

Rows StepAdjoint::balance(const Rows& given, const Rows& multipliers) {
  list_->run(0, begin_.number);
  upload_rows(x_bar_, given);
  upload_rows(multipliers_, multipliers);
  list_->run(balance_, end_.number);
  return download(x_bar_);
}

}  // namespace novaphy::vbd
