#include <algorithm>
#include <cstring>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr int64_t kTreeChunk = 8, kIslandChunk = 4;

// Whether the point that meets a plane is fixed to its shape: a centre, an end, a corner.
bool meets_planes_in_points(int32_t shape_type) {
  switch (static_cast<GeoType>(shape_type)) {
    case GeoType::SPHERE:
    case GeoType::CAPSULE:
    case GeoType::BOX:
    case GeoType::CONVEX_MESH:
    case GeoType::MESH:
      return true;
    default:
      return false;
  }
}

}  // namespace

PgsContacts::PgsContacts(const Model& m, const Articulations& articulations)
    : trees_(reinterpret_cast<const ArticulationRows*>(articulations.rows().data())),
      count_(articulations.count()),
      of_body_(static_cast<size_t>(m.body_count())) {
  int64_t words = 0, rates = 0;
  for (int64_t i = 0; i < count_; ++i) {
    const art::Tree<float> tree = articulations.tree(m, i);
    for (int32_t k = 0; k < tree.link_count; ++k)
      if (tree.links[k].body >= 0)
        of_body_[static_cast<size_t>(tree.links[k].body)] = {static_cast<int32_t>(i), k};
    memory_begin_.push_back(words);
    rates_begin_.push_back(rates);
    words += art::workspace_bytes<float>(tree.link_count, tree.dof_count) / 8 + 1;
    rates += width(i);
    for (int32_t k = 0; k < tree.link_count; ++k) {
      uint32_t bits = 0;
      for (int32_t d = art::last_dof(tree, k); d >= 0; d = tree.dof_parent[d])
        if (d < art::kTreeContactDofs) bits |= 1u << d;
      moved_by_.push_back(static_cast<int32_t>(bits));
    }
  }
  memory_.resize(static_cast<size_t>(words));
  rates_.resize(static_cast<size_t>(rates));
  root_.resize(static_cast<size_t>(count_));
  island_of_tree_.resize(static_cast<size_t>(count_));
}

art::Workspace<float> PgsContacts::workspace(const ArticulationRows& rows, int64_t tree) {
  return art::make_workspace<float>(memory_.data() + memory_begin_[static_cast<size_t>(tree)],
                                    rows.link_count, rows.dof_count);
}

void PgsContacts::write_bodies(const ArticulationArguments& in, Transformf* body_q,
                               SpatialVectorf* body_qd) {
  for_chunks(count_, kTreeChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t i = begin; i < end; ++i) {
      const ArticulationRows& rows = trees_[i];
      const art::Tree<float> tree = articulation_tree(in, rows);
      art::Workspace<float> ws = workspace(rows, i);
      art::link_frames(tree, in.q, ws);
      art::link_motions(tree, in.qd + rows.first_dof, ws);
      art::write_bodies(tree, ws, body_q, body_qd);
    }
  });
}

void PgsContacts::find_friction(const Model& m) {
  if (friction_stamp_.matches(m.joint_friction)) return;
  friction_.clear();
  const float* friction = m.joint_friction.data();
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; k < trees_[i].dof_count; ++k)
      if (friction[trees_[i].first_dof + k] > 0.0f)
        friction_.push_back({static_cast<int32_t>(i), k});
  friction_stamp_.set(m.joint_friction);
}

ContactRows contact_rows(const Contacts* contacts) {
  if (contacts == nullptr) return {};
  const Contacts& c = *contacts;
  return {std::clamp(*c.rigid_contact_count.data(), 0, c.rigid_contact_max()),
          c.rigid_contact_shape0.data(),
          c.rigid_contact_shape1.data(),
          c.rigid_contact_point_id.data(),
          c.rigid_contact_point0.data(),
          c.rigid_contact_point1.data(),
          c.rigid_contact_normal.data(),
          c.rigid_contact_margin0.data(),
          c.rigid_contact_margin1.data()};
}

void PgsContacts::gather(const Model& m, const ContactRows& c) {
  const int32_t* const shapes[2] = {c.shape0, c.shape1};
  const int32_t *const body = m.shape_body.data(), *const type = m.shape_type.data();
  int64_t numbers = 0;
  for (int32_t i = 0; i < c.count; ++i) {
    Row row;
    row.contact = i;
    row.numbers = numbers;
    int32_t widths[2] = {0, 0};
    for (int side = 0; side < 2; ++side) {
      const int32_t shape = shapes[side][i];
      require(shape >= 0 && shape < m.shape_count(), ErrorKind::Index,
              "step: contacts: rigid_contact_shape", side, "[", i, "]: expected 0 to ",
              m.shape_count() - 1, ", got ", shape);
      require(body[shape] >= -1 && body[shape] < m.body_count(), ErrorKind::Index,
              "step: model.shape_body[", shape, "]: expected -1 to ", m.body_count() - 1, ", got ",
              body[shape]);
      if (body[shape] < 0) continue;
      row.sides[side] = of_body_[static_cast<size_t>(body[shape])];
      widths[side] = width(row.sides[side].tree);
    }
    if (row.sides[0].tree == row.sides[1].tree) widths[1] = 0;  // one row holds both sides
    if (widths[0] + widths[1] == 0) continue;
    for (int side = 0; c.found && side < 2; ++side)
      row.follows = row.follows || (row.sides[side].tree < 0 &&
                                    type[shapes[side][i]] == static_cast<int32_t>(GeoType::PLANE) &&
                                    meets_planes_in_points(type[shapes[1 - side][i]]));
    for (int side = 0; side < 2; ++side) {
      row.solver.sides[side].width = widths[side];
      numbers += 6 * widths[side];
    }
    rows_.push_back(row);
  }
  friction_begin_ = numbers;
}

bool PgsContacts::prepare(const Model& m, const ContactRows& contacts) {
  find_friction(m);
  rows_.clear();
  friction_begin_ = 0;
  gather(m, contacts);
  if (rows_.empty() && friction_.empty()) {
    kept_.clear();
    sweeps_ = 0;
    residual_ = 0.0f;
    return false;
  }
  int64_t numbers = friction_begin_;
  for (const Friction& f : friction_) numbers += width(f.tree);
  if (static_cast<size_t>(numbers) > numbers_.size()) numbers_.resize(static_cast<size_t>(numbers));
  find_islands();
  return true;
}

// The trees of an island have the root of the smallest index.
int32_t PgsContacts::find_root(int32_t tree) {
  while (root_[static_cast<size_t>(tree)] != tree) {
    int32_t& up = root_[static_cast<size_t>(tree)];
    up = root_[static_cast<size_t>(up)];
    tree = up;
  }
  return tree;
}

void PgsContacts::find_islands() {
  for (size_t i = 0; i < root_.size(); ++i) root_[i] = static_cast<int32_t>(i);
  for (const Row& row : rows_) {
    if (row.solver.sides[0].width == 0 || row.solver.sides[1].width == 0) continue;
    const int32_t a = find_root(row.sides[0].tree), b = find_root(row.sides[1].tree);
    root_[static_cast<size_t>(std::max(a, b))] = std::min(a, b);
  }
  std::fill(island_of_tree_.begin(), island_of_tree_.end(), -1);
  int32_t islands = 0;
  const auto island = [&](int32_t tree) {
    int32_t& of = island_of_tree_[static_cast<size_t>(find_root(tree))];
    if (of < 0) of = islands++;
    return of;
  };
  island_of_row_.clear();
  island_of_friction_.clear();
  for (const Row& row : rows_)
    island_of_row_.push_back(island(row.sides[row.solver.sides[0].width > 0 ? 0 : 1].tree));
  for (const Friction& f : friction_) island_of_friction_.push_back(island(f.tree));
  island_rows_.build(island_of_row_, islands);
  island_friction_.build(island_of_friction_, islands);
  island_sweeps_.assign(static_cast<size_t>(islands), 0);
  island_residual_.assign(static_cast<size_t>(islands), 0.0f);
  island_joined_.assign(static_cast<size_t>(islands), 0);
  for (size_t i = 0; i < rows_.size(); ++i) {
    const Side *const a = &rows_[i].sides[0], *const b = &rows_[i].sides[1];
    const auto island_row = static_cast<size_t>(island_of_row_[i]);
    if ((a->tree >= 0 && b->tree >= 0) ||
        trees_[a->tree < 0 ? b->tree : a->tree].dof_count > art::kTreeContactDofs)
      island_joined_[island_row] = 1;
  }
  for (const int32_t i : island_of_friction_) island_joined_[static_cast<size_t>(i)] = 1;
  for (size_t i = 0; i < island_joined_.size(); ++i)
    if (island_rows_.items(static_cast<int64_t>(i)).size() > kMostTreeContacts)
      island_joined_[i] = 1;
}

// The means of the two shapes.
art::ContactMaterial<float> PgsContacts::material(const Step& s, const Row& row) {
  const int32_t a = s.contacts.shape0[row.contact], b = s.contacts.shape1[row.contact];
  const auto mean = [&](const float* of) { return 0.5f * (of[a] + of[b]); };
  return {mean(s.mu), mean(s.restitution), mean(s.ke), mean(s.kd)};
}

// The trees that TreeSteps may take, and the others.
void PgsContacts::split_trees(bool alone) {
  alone_.clear();
  together_.clear();
  islands_together_.clear();
  for (int32_t i = 0; i < static_cast<int32_t>(count_); ++i) {
    const int32_t island = island_of_tree_[static_cast<size_t>(find_root(i))];
    const bool by_itself = island < 0 || island_joined_[static_cast<size_t>(island)] == 0;
    (alone && by_itself ? alone_ : together_).push_back(i);
  }
  for (size_t i = 0; i < island_joined_.size(); ++i)
    if (!alone || island_joined_[i] != 0) islands_together_.push_back(static_cast<int32_t>(i));
}

int32_t PgsContacts::count(int64_t tree) const {
  const int32_t island = island_of_tree_[static_cast<size_t>(tree)];
  return island < 0 ? 0 : static_cast<int32_t>(island_rows_.items(island).size());
}

int32_t PgsContacts::fill(int64_t tree, int32_t i, float* numbers, int32_t stride) {
  const Step& s = *current_;
  const auto at = static_cast<size_t>(
      island_rows_.items(island_of_tree_[static_cast<size_t>(tree)])[static_cast<size_t>(i)]);
  const Row& row = rows_[at];
  const size_t side = row.sides[0].tree >= 0 ? 0 : 1;
  const ContactRows& c = s.contacts;
  const int32_t k = row.contact;
  const Vec3f points[2] = {c.point0[k], c.point1[k]};
  const float margins[2] = {c.margin0[k], -c.margin1[k]};
  art::TreeContact<float> contact;
  contact.moved_by = moved_by_[static_cast<size_t>(trees_[tree].first_link + row.sides[side].link)];
  contact.sign = side == 0 ? -1.0f : 1.0f;
  contact.normal = c.normal[k];
  contact.core = points[side];
  contact.world = points[1 - side];
  contact.margin = margins[side];
  contact.world_margin = margins[1 - side];
  contact.material = material(s, row);
  if (const Kept* const kept = warm_[at]) {
    contact.start_normal = kept->normal * s.warm_scale;
    contact.start_tangent = kept->tangent * s.warm_scale;
  }
  float values[sizeof(contact) / sizeof(float)];
  std::memcpy(values, &contact, sizeof(contact));
  for (const float value : values) {
    *numbers = value;
    numbers += stride;
  }
  return row.sides[side].link;
}

void PgsContacts::take(int64_t tree, int32_t i, const float* impulses, int32_t stride) {
  Row& row = rows_[static_cast<size_t>(
      island_rows_.items(island_of_tree_[static_cast<size_t>(tree)])[static_cast<size_t>(i)])];
  row.frame = art::contact_frame(current_->contacts.normal[row.contact]);
  for (int32_t r = 0; r < 3; ++r) row.solver.impulse[r] = impulses[r * stride];
}

void PgsContacts::solved(int64_t tree, int32_t sweeps, float residual) {
  const auto island = static_cast<size_t>(island_of_tree_[static_cast<size_t>(tree)]);
  island_sweeps_[island] = sweeps;
  island_residual_[island] = residual;
}

// The impulses of the same point in the step before. `next` is where the pair before stood: both
// lists are in the order of shapes.
const PgsContacts::Kept* PgsContacts::find_kept(size_t& next, const ContactRows& c,
                                                int32_t contact) const {
  const std::pair<int32_t, int32_t> pair = {c.shape0[contact], c.shape1[contact]};
  const auto pair_of = [&](size_t i) { return std::pair{kept_[i].shape0, kept_[i].shape1}; };
  while (next < kept_.size() && pair_of(next) < pair) ++next;
  for (size_t i = next; i < kept_.size() && pair_of(i) == pair; ++i)
    if (kept_[i].point == c.point_id[contact]) return &kept_[i];
  return nullptr;
}

void PgsContacts::build_row(const Step& s, Row& row) {
  const ContactRows& c = s.contacts;
  const int32_t i = row.contact;
  const Vec3f normal = c.normal[i];
  const Vec3f cores[2] = {c.point0[i], c.point1[i]};
  const float margins[2] = {c.margin0[i], -c.margin1[i]};
  art::SurfacePoint<float> points[2];
  for (size_t side = 0; side < 2; ++side) {
    const Side& at = row.sides[side];
    const art::LinkState<float>* link =
        at.tree < 0 ? nullptr : &workspace(trees_[at.tree], at.tree).links[at.link];
    points[side] = art::surface_point(link, cores[side], normal * margins[side]);
    row.cores[side] = art::surface_point(link, cores[side], Vec3f{}).at;
  }
  const art::ContactPlace<float> place = art::contact_place(points[0], points[1], normal);
  row.place = place;
  row.frame = art::contact_frame(normal);
  float* numbers = numbers_.data() + row.numbers;
  const bool itself = row.sides[0].tree == row.sides[1].tree;
  float before = 0.0f;
  for (size_t side = 0; side < 2; ++side) {
    art::RowSide<float>& to = row.solver.sides[side];
    if (to.width == 0) continue;
    const int64_t tree_row = row.sides[side].tree;
    const ArticulationRows& rows = trees_[tree_row];
    const art::Tree<float> tree = articulation_tree(s.in, rows);
    const art::Workspace<float> ws = workspace(rows, tree_row);
    float *const jacobian = numbers, *const response = numbers + 3 * to.width;
    numbers += 6 * to.width;
    std::fill_n(jacobian, 3 * to.width, 0.0f);
    art::add_point_rows(tree, ws.axes, row.sides[side].link, side == 0 ? place.a : place.b,
                        row.frame, side == 0 ? -1.0f : 1.0f, to.width, jacobian);
    if (itself)
      art::add_point_rows(tree, ws.axes, row.sides[1].link, place.b, row.frame, 1.0f, to.width,
                          jacobian);
    const int32_t last = itself ? -1 : art::last_dof(tree, row.sides[side].link);
    art::response_rows(tree, ws.matrix, last, to.width, jacobian, response);
    to.rates = rates_.data() + rates_begin_[static_cast<size_t>(tree_row)];
    to.jacobian = jacobian;
    to.response = response;
    for (int32_t k = 0; k < rows.dof_count; ++k)
      before += jacobian[k] * s.in.qd[rows.first_dof + k];
  }
  row.before = before;
  art::set_diagonals(row.solver);
}

void PgsContacts::set_target(const Step& s, Row& row) {
  const art::ContactMaterial<float> of = material(s, row);
  row.target = art::normal_target(s.law, of, row.place.gap, row.before, art::slip(row.solver, 0));
  row.elastic = of.restitution > 0.0f;
  row.solver.bias = row.target.bias;
  row.solver.cfm = row.target.cfm;
  row.solver.friction = of.friction;
  art::set_steps<float>(row.solver);
}

void PgsContacts::place_friction() {
  friction_rows_.resize(friction_.size());
  int64_t numbers = friction_begin_;
  for (size_t i = 0; i < friction_.size(); ++i) {
    const Friction& f = friction_[i];
    friction_rows_[i] = {rates_.data() + rates_begin_[static_cast<size_t>(f.tree)],
                         numbers_.data() + numbers, width(f.tree), f.dof};
    numbers += width(f.tree);
  }
}
void PgsContacts::build_friction(const Step& s, int32_t i) {
  const Friction& f = friction_[static_cast<size_t>(i)];
  art::PgsJointFriction<float>& row = friction_rows_[static_cast<size_t>(i)];
  const ArticulationRows& tree = trees_[f.tree];
  auto* const response = const_cast<float*>(row.response);
  std::fill_n(response, row.width, 0.0f);
  response[f.dof] = 1.0f;
  art::solve(articulation_tree(s.in, tree), workspace(tree, f.tree).matrix, response);
  row.limit = s.model.joint_friction.data()[tree.first_dof + f.dof] * s.law.dt;
  row.impulse = 0.0f;
}

void PgsContacts::solve_island(const Step& s, int64_t island) {
  const std::span<const int32_t> rows = island_rows_.items(island);
  const std::span<const int32_t> friction = island_friction_.items(island);
  for (const int32_t i : rows) {
    Row& row = rows_[static_cast<size_t>(i)];
    build_row(s, row);
    set_target(s, row);
  }
  for (const int32_t i : friction) build_friction(s, i);
  for (const int32_t i : rows) {
    Row& row = rows_[static_cast<size_t>(i)];
    const Kept* const kept = warm_[static_cast<size_t>(i)];
    if (kept == nullptr) continue;
    const Vec3f tangent = kept->tangent * s.warm_scale;
    art::warm_start(row.solver, s.law.cone, kept->normal * s.warm_scale,
                    math::dot(tangent, row.frame.axes[1]), math::dot(tangent, row.frame.axes[2]));
  }
  int32_t sweeps = 0;
  float worst = 0.0f;
  do {
    worst = 0.0f;
    const bool back = sweeps % 2 != 0;
    for (size_t k = 0; k < rows.size(); ++k) {
      const auto i = static_cast<size_t>(rows[back ? rows.size() - 1 - k : k]);
      worst = std::max(worst, art::sweep(rows_[i].solver, s.law.cone));
    }
    for (const int32_t i : friction)
      worst = std::max(worst, art::sweep(friction_rows_[static_cast<size_t>(i)]));
  } while (++sweeps < s.options.pgs_iterations && !(worst < s.options.pgs_tolerance));
  island_sweeps_[static_cast<size_t>(island)] = sweeps;
  island_residual_[static_cast<size_t>(island)] = worst;
}

// Writes the forces, and keeps the impulses for the next step.
void PgsContacts::keep(const ContactRows& c, float dt, Vec3f* force) {
  kept_.clear();
  kept_dt_ = dt;
  for (const Row& row : rows_) {
    const float* impulse = row.solver.impulse;
    const Vec3f tangent = row.frame.axes[1] * impulse[1] + row.frame.axes[2] * impulse[2];
    if (force != nullptr)
      force[row.contact] = (row.frame.axes[0] * impulse[0] + tangent) * (1.0f / dt);
    if (impulse[0] > 0.0f && c.point_id != nullptr)
      kept_.push_back({c.shape0[row.contact], c.shape1[row.contact], c.point_id[row.contact],
                       impulse[0], tangent});
  }
}

void PgsContacts::step(const ArticulationStepArguments& a, const Model& m,
                       const ContactRows& contacts, const FeatherstoneOptions& options,
                       Vec3f* force, TreeSteps* alone) {
  const art::StepInputs<float> in = articulation_inputs(a.in);
  const art::StepOptions<float> how = articulation_options(a.in);
  const float dt = how.dt;
  split_trees(alone != nullptr);
  warm_.assign(rows_.size(), nullptr);
  size_t next = 0;
  if (options.warm_start && !kept_.empty())
    for (size_t i = 0; i < rows_.size(); ++i)
      warm_[i] = find_kept(next, contacts, rows_[i].contact);
  const Step s = make_step(a.in, m, contacts, options, kept_dt_ > 0.0f ? dt / kept_dt_ : 1.0f);
  if (!alone_.empty()) {
    current_ = &s;
    alone->step(a, m, alone_, options, this);
    current_ = nullptr;
  }

  const auto for_trees = [&](const auto& f) {
    for_chunks(static_cast<int64_t>(together_.size()), kTreeChunk,
               [&](int64_t begin, int64_t end, int64_t) {
                 for (int64_t k = begin; k < end; ++k) {
                   const int32_t i = together_[static_cast<size_t>(k)];
                   const ArticulationRows& rows = trees_[i];
                   art::Workspace<float> ws = workspace(rows, i);
                   f(i, rows, articulation_tree(a.in, rows), ws,
                     rates_.data() + rates_begin_[static_cast<size_t>(i)]);
                 }
               });
  };
  for_trees([&](int32_t i, const ArticulationRows& rows, const art::Tree<float>& tree,
                art::Workspace<float>& ws, float* rates) {
    const int32_t failed = art::accelerate(tree, in, how, ws);
    a.status[i] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
    if (failed >= 0) return;
    art::free_rates(tree, in, how, ws);
    std::copy_n(ws.qd_next, rows.dof_count, rates);
  });
  for (const int32_t i : together_)
    if (a.status[i] != 0) return rows_.clear();  // nothing was solved

  place_friction();
  for_chunks(static_cast<int64_t>(islands_together_.size()), kIslandChunk,
             [&](int64_t begin, int64_t end, int64_t) {
               for (int64_t i = begin; i < end; ++i)
                 solve_island(s, islands_together_[static_cast<size_t>(i)]);
             });
  sweeps_ = 0;
  residual_ = 0.0f;
  for (size_t i = 0; i < island_sweeps_.size(); ++i) {
    sweeps_ = std::max(sweeps_, island_sweeps_[i]);
    residual_ = std::max(residual_, island_residual_[i]);
  }
  keep(contacts, dt, force);

  for_trees([&](int32_t i, const ArticulationRows& rows, const art::Tree<float>& tree,
                art::Workspace<float>& ws, const float* rates) {
    for (int32_t k = 0; k < rows.dof_count && a.status[i] == 0; ++k) {
      if (!art::is_finite(rates[k])) a.status[i] = 1 + k + rows.first_dof;
      if (rates[k] == ws.qd_next[k]) continue;
      ws.qdd[k] = (rates[k] - in.qd[rows.first_dof + k]) / dt;
      ws.qd_next[k] = rates[k];
    }
    if (a.status[i] != 0) return;
    art::clamp_rates(tree, in, ws);
    for (int32_t k = 0; k < rows.dof_count; ++k) {
      a.qdd[rows.first_dof + k] = ws.qdd[k];
      a.branch[rows.first_dof + k] = static_cast<float>(ws.branch[k]);
    }
    art::finish_step(tree, in, how, ws, a.q_next, a.qd_next, a.body_q, a.body_qd);
  });
}

}  // namespace novaphy
