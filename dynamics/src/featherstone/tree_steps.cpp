#include "tree_steps.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <memory>
#include <utility>

#include "../step_sources.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/cpu_level.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"

namespace novaphy {

namespace articulation {
namespace baseline {
extern const LaneLevel kLevel;
}
#ifdef NOVAPHY_X86_LEVELS
namespace avx2 {
extern const LaneLevel kLevel;
}
namespace avx512 {
extern const LaneLevel kLevel;
}
#endif

const LaneLevel& lane_level() {
  return choose_cpu_level(std::to_array<const LaneLevel*>({
#ifdef NOVAPHY_X86_LEVELS
      &avx512::kLevel, &avx2::kLevel,
#endif
      &baseline::kLevel}));
}
}  // namespace articulation

namespace {

namespace art = articulation;
constexpr size_t kFewest = 3;  // smallest number of trees for which SIMD lanes are faster

// Returns the arrays of a step. Where actuators write the arrays of drives, these are not constant.
NamedStepArrays arrays_of_lanes(const Model& m) {
  NamedStepArrays arrays = step_arrays(m, nullptr, nullptr);
  for (const int32_t place : {kAt.target_ke, kAt.target_kd, kAt.effort_limit})
    arrays[static_cast<size_t>(place)].is_constant = m.actuator_count() == 0;
  return arrays;
}

// Lists the constant arrays, which are stored one after the other.
void list_constants(const NamedStepArrays& arrays, art::TreeShape& shape) {
  for (int32_t c = 0; c < static_cast<int32_t>(kStepArrays); ++c) {
    if (!arrays[static_cast<size_t>(c)].is_constant) {
      shape.changing[shape.changing_count++] = c;
      continue;
    }
    shape.constant[c] = shape.constants;
    shape.constants += kStepRows.at[c].width * shape.count(kStepRows.at[c].of);
  }
}

}  // namespace

// The memory of one thread.
struct TreeSteps::Memory {
  std::vector<unsigned char> bytes = {};
  std::vector<int32_t> links = {};
  std::vector<float> impulses = {};
  void* aligned(int64_t size) {
    if (static_cast<int64_t>(bytes.size()) < size + 64)
      bytes.resize(static_cast<size_t>(size) + 64);
    void* at = bytes.data();
    size_t space = bytes.size();
    return std::align(64, static_cast<size_t>(size), at, space);
  }
};

TreeSteps::TreeSteps(const Model& m, const Articulations& articulations)
    : articulations_(articulations),
      trees_(reinterpret_cast<const ArticulationRows*>(articulations.rows().data())),
      first_(static_cast<size_t>(articulations.count())) {
  find_groups(m);
}

void TreeSteps::find_groups(const Model& m) {
  groups_.clear();
  const auto* all_links = reinterpret_cast<const art::Link*>(articulations_.links().data());
  const int32_t* modes = m.joint_target_mode.data();
  const NamedStepArrays arrays = arrays_of_lanes(m);
  for (size_t i = 0; i < first_.size(); ++i) {
    const ArticulationRows& rows = trees_[i];
    std::vector<art::Link> links(all_links + rows.first_link,
                                 all_links + rows.first_link + rows.link_count);
    FirstRows first{INT32_MAX, INT32_MAX, INT32_MAX, -1};
    art::TreeShape shape;
    shape.links = rows.link_count;
    shape.dofs = rows.dof_count;
    shape.joints_in_a_row = rows.joints_in_a_row;
    int32_t last_body = -1, last_joint = -1;
    for (const art::Link& link : links) {
      first.coord = std::min(first.coord, link.coord);
      shape.coords += link.dofs + (link.dofs > 1 ? 1 : 0);
      if (link.body >= 0) first.body = std::min(first.body, link.body), ++shape.bodies;
      last_body = std::max(last_body, link.body);
      for (const int32_t joint : {link.frame_p, link.frame_c})
        if (joint >= 0) {
          first.joint = std::min(first.joint, joint);
          last_joint = std::max(last_joint, joint);
        }
    }
    // Lanes need trees with contiguous rows and without mimic joints.
    if (rows.mimics > 0 || last_joint < 0 || last_body - first.body + 1 != shape.bodies ||
        rows.dof_count == 0)
      continue;
    shape.joints = last_joint - first.joint + 1;
    for (art::Link& link : links) {
      link.coord -= first.coord;
      link.dof -= rows.first_dof;
      if (link.body >= 0) link.body -= first.body;
      if (link.frame_p >= 0) link.frame_p -= first.joint;
      if (link.frame_c >= 0) link.frame_c -= first.joint;
    }
    const std::vector<int32_t> mode(modes + rows.first_dof,
                                    modes + rows.first_dof + rows.dof_count);
    size_t g = 0;
    while (g < groups_.size() &&
           !(groups_[g].links == links && groups_[g].target_mode == mode &&
             groups_[g].shape.joints == shape.joints && groups_[g].shape.dofs == shape.dofs))
      ++g;
    if (g == groups_.size()) {
      list_constants(arrays, shape);
      groups_.push_back({shape, std::move(links), mode});
      Group& made = groups_.back();
      made.shape.dof_parent = articulations_.dof_parent().data() + rows.first_dof;
    }
    first.group = static_cast<int32_t>(g);
    first_[i] = first;
  }
  for (Group& group : groups_) {
    group.shape.link_rows = group.links.data();
    group.shape.target_mode = group.target_mode.data();
  }
}

// Reads the constants of a tree into `to`, with `stride` numbers from one to the next.
void TreeSteps::constants_of(const Model& m, int32_t tree, float* to, int32_t stride) const {
  const FirstRows& first = first_[static_cast<size_t>(tree)];
  const ArticulationRows& rows = trees_[tree];
  const art::TreeShape& shape = groups_[static_cast<size_t>(first.group)].shape;
  const NamedStepArrays arrays = arrays_of_lanes(m);
  for (size_t c = 0; c < kStepArrays; ++c) {
    if (!arrays[c].is_constant) continue;
    const auto [of, width] = kStepRows.at[c];
    const int32_t row = of == art::RowOf::Joint  ? first.joint
                        : of == art::RowOf::Body ? first.body
                        : of == art::RowOf::Dof  ? rows.first_dof
                                                 : rows.world;
    const int64_t at = static_cast<int64_t>(row) * width;
    const int32_t begin = shape.constant[c], numbers = width * shape.count(of);
    NOVAPHY_ASSERT(static_cast<size_t>(at + numbers) <= arrays[c].array->bytes() / sizeof(float));
    const auto* from = static_cast<const float*>(arrays[c].array->range()->data()) + at;
    for (int32_t i = 0; i < numbers; ++i) to[int64_t{begin + i} * stride] = from[i];
  }
}

// Reads the constants again if an array was written.
void TreeSteps::renew(const Model& m) {
  bool same = mode_stamp_.matches(m.joint_target_mode);
  if (!same) find_groups(m);
  const NamedStepArrays arrays = arrays_of_lanes(m);
  for (size_t c = 0; c < kStepArrays; ++c)
    if (arrays[c].is_constant) same = stamps_[c].matches(*arrays[c].array) && same;
  if (same) return;
  const int32_t lanes = level_.lanes;
  std::vector<float> first, other;
  for (size_t g = 0; g < groups_.size(); ++g) {
    Group& group = groups_[g];
    const int32_t numbers = group.shape.constants;
    first.clear();
    other.resize(static_cast<size_t>(numbers));
    group.same = true;
    group.packed.clear();
    for (size_t i = 0; i < first_.size(); ++i) {
      if (first_[i].group != static_cast<int32_t>(g)) continue;
      group.packed.push_back(static_cast<int32_t>(i));
      constants_of(m, static_cast<int32_t>(i), other.data(), 1);
      if (first.empty()) first = other;
      group.same =
          group.same && std::memcmp(first.data(), other.data(), first.size() * sizeof(float)) == 0;
    }
    const size_t batches = group.same ? 1 : (group.packed.size() + lanes - 1) / lanes;
    group.lines.resize((batches * static_cast<size_t>(numbers) * lanes + 15) / 16);
    for (size_t p = 0; p < batches; ++p)
      for (int32_t l = 0; l < lanes; ++l) {
        const size_t i = std::min(p * lanes + l, group.packed.size() - 1);
        constants_of(m, group.packed[i],
                     group.lines[0].numbers + p * static_cast<size_t>(numbers) * lanes + l, lanes);
      }
  }
  for (size_t c = 0; c < kStepArrays; ++c)
    if (arrays[c].is_constant) stamps_[c].set(*arrays[c].array);
  mode_stamp_.set(m.joint_target_mode);
}

// Returns the largest number of trees in a batch. Few trees make batches for all threads.
int32_t TreeSteps::most_in_batch(size_t trees, int32_t group) const {
  if (group < 0 || !groups_[static_cast<size_t>(group)].same) return level_.lanes;
  const auto threads = static_cast<size_t>(in_parallel() ? 1 : num_threads());
  return static_cast<int32_t>(
      std::min((trees + threads - 1) / threads, static_cast<size_t>(level_.lanes)));
}

// Makes batches. Trees with equal constants are sorted by their number of contacts, so that the
// lanes of a batch have similar numbers.
void TreeSteps::make_packs(std::span<const int32_t> trees, const TreeContacts* contacts) {
  batches_.clear();
  counts_.resize(first_.size());
  keys_.resize(trees.size());
  for (size_t i = 0; i < trees.size(); ++i) {
    const int32_t tree = trees[i], group = first_[static_cast<size_t>(tree)].group;
    const int32_t count = contacts == nullptr ? 0 : contacts->count(tree);
    const bool sorts = group >= 0 && groups_[static_cast<size_t>(group)].same;
    counts_[static_cast<size_t>(tree)] = count;
    const int32_t least = count > art::kCoupledContacts ? art::kCoupledContacts + 1 : 0;
    keys_[i] = (group + 1) * (kMostTreeContacts + 1) + (sorts ? count : least);
  }
  const auto keys = static_cast<int32_t>((groups_.size() + 1) * (kMostTreeContacts + 1));
  order_.build(keys_, keys);
  sorted_.clear();
  for (const int32_t i : order_.all()) sorted_.push_back(trees[static_cast<size_t>(i)]);
  for (size_t i = 0; i < sorted_.size();) {
    const int32_t group = first_[static_cast<size_t>(sorted_[i])].group;
    const auto is_coupled = [&](int32_t tree) {
      return counts_[static_cast<size_t>(tree)] <= art::kCoupledContacts;
    };
    Batch batch{group, static_cast<int32_t>(i), 0, 0};
    const bool coupled = is_coupled(sorted_[i]);
    const int32_t most = most_in_batch(trees.size(), group);
    for (; i < sorted_.size() && batch.count < most; ++i, ++batch.count) {
      const auto tree = static_cast<size_t>(sorted_[i]);
      if (first_[tree].group != group || is_coupled(sorted_[i]) != coupled) break;
      batch.contacts = std::max(batch.contacts, counts_[tree]);
    }
    NOVAPHY_ASSERT(batch.count > 0 && batch.contacts <= kMostTreeContacts);
    batches_.push_back(batch);
  }
  NOVAPHY_ASSERT(sorted_.size() == trees.size());
}

namespace {

art::ContactLaw<float> contact_law(const FeatherstoneOptions& o, float dt) {
  return {dt,
          o.pgs_erp,
          o.pgs_slop,
          o.pgs_cfm,
          o.max_depenetration_velocity,
          o.restitution_threshold,
          o.compliant_contacts,
          o.friction_cone == FrictionCone::Cone};
}

// `flatten` inlines the whole algorithm into the caller.
[[gnu::flatten]] int32_t accelerate(const art::Tree<float>& tree, const art::StepInputs<float>& in,
                                    const art::StepOptions<float>& how, bool alone,
                                    art::Workspace<float>& ws) {
  return art::accelerate(tree, in, how, alone, ws);
}
[[gnu::flatten]] void finish(const art::Tree<float>& tree, const art::StepInputs<float>& in,
                             const art::StepOptions<float>& how, art::Workspace<float>& ws,
                             const ArticulationStepArguments& a) {
  finish_step(a, tree, in, how, ws);
}
[[gnu::flatten]] int32_t solve_accelerations(const art::Tree<float>& tree,
                                             const art::StepInputs<float>& in,
                                             const art::StepOptions<float>& how,
                                             art::Workspace<float>& ws) {
  return art::solve_accelerations(tree, in, how, ws);
}
[[gnu::flatten]] art::TreeContactResult<float> solve(const art::Tree<float>& tree,
                                                     const art::Workspace<float>& ws,
                                                     const FeatherstoneOptions& options, float dt,
                                                     const art::TreeContact<float>* contacts,
                                                     const art::TreeContactLink<float>* links,
                                                     int32_t count, const float* qd,
                                                     const art::TreeContactMemory<float>& m) {
  return art::solve_tree_contacts(Alone{}, tree, ws, contact_law(options, dt),
                                  options.pgs_iterations, options.pgs_tolerance, contacts, links,
                                  count, qd, m, ws.qd_next);
}

[[gnu::flatten]] void vjp_row(const ArticulationStepVjpArguments& a, int64_t row, int64_t count) {
  articulation_step_vjp_row(a, row, count);
}

}  // namespace

TreeSteps::Memory& TreeSteps::thread_memory() {
  static thread_local Memory memory;
  return memory;
}
bool TreeSteps::has_lanes(const Batch& batch) const {
  return uses_lanes_ && batch.group >= 0 && batch.count >= static_cast<int32_t>(kFewest);
}

// Steps a single tree.
void TreeSteps::single(const ArticulationStepArguments& a, int64_t tree_row,
                       const FeatherstoneOptions& options, TreeContacts* contacts, bool keep,
                       Memory& memory) {
  const ArticulationRows& rows = trees_[tree_row];
  const art::Tree<float> tree = articulation_tree(a.in, rows);
  const art::StepInputs<float> in = articulation_inputs(a.in);
  const art::StepOptions<float> how = articulation_options(a.in);
  const int32_t count = contacts == nullptr ? 0 : contacts->count(tree_row);
  const int64_t bytes = art::workspace_bytes<float>(rows.link_count, rows.dof_count);
  const int64_t inputs = count * static_cast<int64_t>(sizeof(art::TreeContact<float>) +
                                                      sizeof(art::TreeContactLink<float>));
  auto* at = static_cast<unsigned char*>(
      memory.aligned(bytes + inputs + art::tree_contact_bytes<float>(count, rows.dof_count) + 64));
  art::Workspace<float> ws = art::make_workspace<float>(at, rows.link_count, rows.dof_count);
  auto* const found = reinterpret_cast<art::TreeContact<float>*>(at + bytes);
  memory.links.resize(static_cast<size_t>(count));
  for (int32_t i = 0; i < count; ++i)
    memory.links[static_cast<size_t>(i)] =
        contacts->fill(tree_row, i, reinterpret_cast<float*>(found + i), 1);
  int32_t failed = accelerate(tree, in, how, !art::touching(found, count), ws);
  if (failed < 0) {
    art::free_rates(tree, in, how, ws);
    if (count > 0) {
      auto* const links = reinterpret_cast<art::TreeContactLink<float>*>(found + count);
      const art::TreeContactMemory<float> m =
          art::make_tree_contact_memory<float>(links + count, count, rows.dof_count);
      for (int32_t i = 0; i < count; ++i) {
        const art::LinkState<float>& s = ws.links[memory.links[static_cast<size_t>(i)]];
        links[i] = {s.q, s.p, s.origin};
      }
      art::TreeContactResult<float> result;
      for (int32_t round = 0; failed < 0; ++round) {
        result = solve(tree, ws, options, how.dt, found, links, count, in.qd + rows.first_dof, m);
        ws.shift = m.shift;
        failed = art::first_not_finite(ws, rows.dof_count);
        if (failed >= 0 || !art::renew_tree(tree, in, how, found, count, m, round, ws)) break;
        failed = solve_accelerations(tree, in, how, ws);
        if (failed < 0) art::free_rates(tree, in, how, ws);
      }
      for (int32_t i = 0; i < count; ++i) contacts->take(tree_row, i, m.rows[i].impulse, 1);
      contacts->solved(tree_row,
                       {static_cast<int32_t>(result.sweeps), result.residual, result.largest});
    }
  }
  a.status[tree_row] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
  if (failed >= 0) return;
  if (keep) write_rates(a, rows, ws);
  finish(tree, in, how, ws, a);
}

constexpr int32_t kMostLanes = 16;
struct TreeSteps::FirstOfLanes {
  int32_t coord[kMostLanes], dof[kMostLanes], body[kMostLanes];
};

// Sets the inputs of a batch's lanes. `constants`: memory for a batch with different constants.
void TreeSteps::set_lanes(art::LaneStepArguments& s, const ArticulationArguments& in,
                          const Model& m, const Batch& batch, FirstOfLanes& first,
                          float* constants) const {
  const int32_t lanes = level_.lanes;
  const Group& group = groups_[static_cast<size_t>(batch.group)];
  const int64_t own = int64_t{group.shape.constants} * lanes;
  const int32_t* const trees = sorted_.data() + batch.begin;
  const auto tree_of = [&](int32_t lane) { return trees[std::min(lane, batch.count - 1)]; };
  s.shape = group.shape;
  s.used = batch.count;
  for (int32_t l = 0; l < lanes; ++l) {
    const FirstRows& rows = first_[static_cast<size_t>(tree_of(l))];
    first.coord[l] = rows.coord;
    first.dof[l] = trees_[tree_of(l)].first_dof;
    first.body[l] = rows.body;
  }
  s.coord = first.coord;
  s.dof = first.dof;
  s.body = first.body;
  s.constants = group.lines[0].numbers;
  if (!group.same) {
    const auto at = std::lower_bound(group.packed.begin(), group.packed.end(), trees[0]);
    const auto place = at - group.packed.begin();
    const bool whole = place % lanes == 0 && group.packed.end() - at >= batch.count &&
                       at[batch.count - 1] == trees[batch.count - 1];
    s.constants += place / lanes * own;
    if (!whole) {
      for (int32_t l = 0; l < lanes; ++l) constants_of(m, tree_of(l), constants + l, lanes);
      s.constants = constants;
    }
  }
  const art::StepInputs<float> inputs = articulation_inputs(in);
  art::for_each_array(
      [&](const auto* from, int32_t place) { s.in[place] = reinterpret_cast<const float*>(from); },
      inputs, kAt);
  s.options = articulation_options(in);
}

// Steps a batch of trees. Returns false, and writes nothing, if a tree fails.
bool TreeSteps::lanes(const ArticulationStepArguments& a, const Model& m, const Batch& batch,
                      const FeatherstoneOptions& options, TreeContacts* contacts, bool keep,
                      Memory& memory) const {
  const int32_t lanes = level_.lanes;
  const art::TreeShape& shape = groups_[static_cast<size_t>(batch.group)].shape;
  const int32_t* const trees = sorted_.data() + batch.begin;
  constexpr int64_t kContactNumbers = sizeof(art::TreeContact<float>) / sizeof(float);
  const int64_t state = level_.memory(shape, batch.contacts);
  const int64_t found = batch.contacts * kContactNumbers * lanes;
  const int64_t own = int64_t{shape.constants} * lanes;
  auto* const bytes = static_cast<unsigned char*>(memory.aligned(
      state + (found + own + (3 + 1) * batch.contacts * lanes + 3 * lanes + 64) * 4));
  auto* const inputs = reinterpret_cast<float*>(bytes + (state + 63) / 64 * 64);
  float* const constants = inputs + found;
  float* const impulses = constants + own;
  auto* const links = reinterpret_cast<int32_t*>(impulses + 3 * batch.contacts * lanes);
  auto* const results = reinterpret_cast<float*>(links + batch.contacts * lanes);

  art::LaneStepArguments s;
  FirstOfLanes first;
  set_lanes(s, a.in, m, batch, first, constants);
  s.qdd = keep ? a.qdd.rows() : nullptr;
  s.branch = a.branch;
  s.q_next = a.q_next;
  s.qd_next = a.qd_next;
  s.body_q = &a.body_q[0].p.x;
  s.body_qd = &a.body_qd[0].linear.x;
  s.contact_count = batch.contacts;
  if (batch.contacts > 0) {
    std::fill_n(inputs, found, 0.0f);
    std::fill_n(links, batch.contacts * lanes, 0);
    constexpr size_t kNormalZ = offsetof(art::TreeContact<float>, normal) / sizeof(float) + 2;
    for (int32_t c = 0; c < batch.contacts; ++c)
      for (int32_t l = 0; l < lanes; ++l) {
        float* const to = inputs + c * kContactNumbers * lanes + l;
        if (l < batch.count && c < counts_[static_cast<size_t>(trees[l])])
          links[c * lanes + l] = contacts->fill(trees[l], c, to, lanes);
        else
          to[kNormalZ * static_cast<size_t>(lanes)] = 1.0f;
      }
    s.contacts = inputs;
    s.contact_links = links;
    s.erp = options.pgs_erp;
    s.slop = options.pgs_slop;
    s.cfm = options.pgs_cfm;
    s.max_depenetration = options.max_depenetration_velocity;
    s.restitution_threshold = options.restitution_threshold;
    s.compliant = options.compliant_contacts;
    s.cone = options.friction_cone == FrictionCone::Cone;
    s.tolerance = options.pgs_tolerance;
    s.most_sweeps = options.pgs_iterations;
    s.impulses = impulses;
    s.sweeps = results;
    s.residual = results + lanes;
    s.largest = results + 2 * lanes;
  }
  s.memory = bytes;
  if (!level_.step(s)) return false;
  for (int32_t l = 0; l < batch.count; ++l) {
    const int32_t tree = trees[l], count = counts_[static_cast<size_t>(tree)];
    a.status[tree] = 0;
    for (int32_t c = 0; c < count; ++c)
      contacts->take(tree, c, impulses + 3 * c * lanes + l, lanes);
    if (count > 0)
      contacts->solved(tree, {static_cast<int32_t>(s.sweeps[l]), s.residual[l], s.largest[l]});
  }
  return true;
}

void TreeSteps::step(const ArticulationStepArguments& a, const Model& m,
                     std::span<const int32_t> trees, const FeatherstoneOptions& options,
                     TreeContacts* contacts, bool keep) {
  if (trees.size() < kFewest) {
    for (const int32_t tree : trees) single(a, tree, options, contacts, keep, thread_memory());
    return;
  }
  renew(m);
  make_packs(trees, contacts);
  for_chunks(static_cast<int64_t>(batches_.size()), 1, [&](int64_t p, int64_t, int64_t) {
    const Batch& batch = batches_[static_cast<size_t>(p)];
    if (has_lanes(batch) && lanes(a, m, batch, options, contacts, keep, thread_memory())) return;
    for (int32_t i = 0; i < batch.count; ++i)
      single(a, sorted_[static_cast<size_t>(batch.begin + i)], options, contacts, keep,
             thread_memory());
  });
}

void TreeSteps::vjp_lanes(const ArticulationStepVjpArguments& a, const Model& m, const Batch& batch,
                          Memory& memory) const {
  const art::TreeShape& shape = groups_[static_cast<size_t>(batch.group)].shape;
  const int64_t own = int64_t{shape.constants} * level_.lanes * 4;
  auto* const bytes =
      static_cast<unsigned char*>(memory.aligned(own + 64 + level_.vjp_memory(shape)));
  art::LaneVjpArguments v;
  FirstOfLanes first;
  set_lanes(v.step, a.in, m, batch, first, reinterpret_cast<float*>(bytes));
  v.step.memory = bytes + (own + 63) / 64 * 64;
  v.qdd = a.qdd;
  v.branch = a.branch;
  v.q_next = a.q_next;
  v.qd_next = a.qd_next;
  v.out_q = a.out_q;
  v.out_qd = a.out_qd;
  if (a.out_body_q != nullptr) v.out_body_q = &a.out_body_q[0].p.x;
  if (a.out_body_qd != nullptr) v.out_body_qd = &a.out_body_qd[0].linear.x;
  art::for_each_gradient_array(
      [&](const auto& to, int32_t place) {
        v.gradient[place] = reinterpret_cast<float*>(to.rows());
      },
      a.gradient, kAt);
  v.add = static_cast<int32_t>(a.add.value);
  level_.vjp(v);
}

void TreeSteps::vjp(const ArticulationStepVjpArguments& a, const Model& m,
                    std::span<const int32_t> trees) {
  const auto count = static_cast<int64_t>(trees.size());
  if (trees.size() < kFewest) {
    for (const int32_t tree : trees) vjp_row(a, tree, count);
    return;
  }
  renew(m);
  make_packs(trees, nullptr);
  for_chunks(static_cast<int64_t>(batches_.size()), 1, [&](int64_t p, int64_t, int64_t) {
    const Batch& batch = batches_[static_cast<size_t>(p)];
    if (has_lanes(batch)) return vjp_lanes(a, m, batch, thread_memory());
    for (int32_t i = 0; i < batch.count; ++i)
      vjp_row(a, sorted_[static_cast<size_t>(batch.begin + i)], count);
  });
}

}  // namespace novaphy
