#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr int64_t kTreeChunk = 8, kIslandChunk = 4;

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
    rates += 2 * width(i);
    for (int32_t k = 0; k < tree.link_count; ++k) moved_by_.push_back(art::moving_dofs(tree, k));
  }
  memory_.resize(static_cast<size_t>(words));
  rates_.resize(static_cast<size_t>(rates));
  NOVAPHY_ASSERT(std::is_sorted(memory_begin_.begin(), memory_begin_.end()));
  kept_friction_.resize(static_cast<size_t>(m.joint_dof_count()));
  root_.resize(static_cast<size_t>(count_));
  island_of_tree_.resize(static_cast<size_t>(count_));
}

art::Workspace<float> PgsContacts::workspace(const ArticulationRows& rows, int64_t tree) {
  return art::make_workspace<float>(memory_.data() + memory_begin_[static_cast<size_t>(tree)],
                                    rows.link_count, rows.dof_count);
}

void PgsContacts::move_links(const ArticulationArguments& in, Transformf* body_q,
                             SpatialVectorf* body_qd) {
  for_chunks(count_, kTreeChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t i = begin; i < end; ++i) {
      const ArticulationRows& rows = trees_[i];
      const art::Tree<float> tree = articulation_tree(in, rows);
      art::Workspace<float> ws = workspace(rows, i);
      art::link_frames(tree, in.arrays.q.rows(), ws);
      art::link_motions(tree, in.arrays.qd + rows.first_dof, ws);
      if (body_q != nullptr) art::write_bodies(tree, ws, body_q, body_qd);
    }
  });
}

void PgsContacts::find_friction(const Model& m) {
  if (friction_stamp_.matches(m.joint_friction)) return;
  friction_.clear();
  const float* friction = m.joint_friction.data();
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; trees_[i].moves != 0 && k < trees_[i].dof_count; ++k)
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

void PgsContacts::gather(const Model& m, const ContactRows& c, const ArticulationArguments* from) {
  if (from != nullptr && c.count > 0) move_links(*from);
  const int32_t* const shapes[2] = {c.shape0, c.shape1};
  const int32_t* const body = m.shape_body.data();
  int64_t numbers = 0;
  for (int32_t i = 0; i < c.count; ++i) {
    Row row;
    row.contact = i;
    row.numbers = numbers;
    for (int side = 0; side < 2; ++side) {
      const int32_t shape = shapes[side][i];
      require(shape >= 0 && shape < m.shape_count(), ErrorKind::Index,
              "step: contacts: rigid_contact_shape", side, "[", i, "]: expected 0 to ",
              m.shape_count() - 1, ", got ", shape);
      require(body[shape] >= -1 && body[shape] < m.body_count(), ErrorKind::Index,
              "step: model.shape_body[", shape, "]: expected -1 to ", m.body_count() - 1, ", got ",
              body[shape]);
      if (body[shape] >= 0) row.sides[side] = of_body_[static_cast<size_t>(body[shape])];
    }
    int32_t widths[2];
    if (!art::set_widths(trees_, row.sides, widths)) continue;
    if (from != nullptr) {
      const art::LinkState<float>* links[2] = {};
      for (int side = 0; side < 2; ++side)
        if (const Side& at = row.sides[side]; at.tree >= 0)
          links[side] = workspace(trees_[at.tree], at.tree).links + at.link;
      if (!art::may_touch(c, i, links, from->dt.value)) continue;
    }
    row.follows = art::follows_plane(c, m.shape_type.data(), i, row.sides);
    for (int side = 0; side < 2; ++side) {
      row.solver.sides[side].width = widths[side];
      numbers += 6 * widths[side];
    }
    rows_.push_back(row);
  }
  friction_begin_ = numbers;
}

bool PgsContacts::prepare(const Model& m, const ContactRows& contacts,
                          const ArticulationArguments* from) {
  find_friction(m);
  rows_.clear();
  friction_begin_ = 0;
  gather(m, contacts, from);
  if (rows_.empty() && friction_.empty()) {
    kept_.clear();
    sweeps_ = 0;
    residual_ = 0.0f;
    far_ = {};
    island_results_.clear();
    return false;
  }
  int64_t numbers = friction_begin_;
  for (const Friction& f : friction_) numbers += width(f.tree);
  if (static_cast<size_t>(numbers) > numbers_.size()) numbers_.resize(static_cast<size_t>(numbers));
  find_islands();
  return true;
}

void PgsContacts::find_islands() {
  for (size_t i = 0; i < root_.size(); ++i) root_[i] = static_cast<int32_t>(i);
  for (const Row& row : rows_) {
    if (!art::moves(trees_, row.sides[0]) || !art::moves(trees_, row.sides[1])) continue;
    art::join_trees([this](int32_t i) -> int32_t& { return root_[static_cast<size_t>(i)]; },
                    row.sides[0].tree, row.sides[1].tree);
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
  for (const Row& row : rows_) island_of_row_.push_back(island(art::moved_tree(trees_, row.sides)));
  for (const Friction& f : friction_) island_of_friction_.push_back(island(f.tree));
  island_rows_.build(island_of_row_, islands);
  island_friction_.build(island_of_friction_, islands);
  NOVAPHY_ASSERT(island_rows_.all().size() == rows_.size());  // every row is of an island
  NOVAPHY_ASSERT(island_friction_.all().size() == friction_.size());
  island_results_.assign(static_cast<size_t>(islands), {});
  island_joined_.assign(static_cast<size_t>(islands), 0);
  island_solved_.assign(static_cast<size_t>(islands), 0);
  for (size_t i = 0; i < rows_.size(); ++i) {
    const Side* const sides = rows_[i].sides;
    const int32_t tree = sides[sides[0].tree < 0 ? 1 : 0].tree;
    if (art::joins_more(sides, trees_[tree].dof_count))
      island_joined_[static_cast<size_t>(island_of_row_[i])] = 1;
  }
  for (const int32_t i : island_of_friction_) island_joined_[static_cast<size_t>(i)] = 1;
  for (size_t i = 0; i < island_joined_.size(); ++i)
    if (island_rows_.items(static_cast<int64_t>(i)).size() > kMostTreeContacts)
      island_joined_[i] = 1;
}

// The trees that TreeSteps may take, and the others.
void PgsContacts::split_trees(bool alone) {
  alone_.clear();
  together_.clear();
  islands_together_.clear();
  met_.assign(static_cast<size_t>(count_), 0);
  for (const Row& row : rows_)
    for (size_t side = 0; side < 2; ++side)
      if (row.sides[side].tree >= 0 && !art::moves(trees_, row.sides[side]))
        met_[static_cast<size_t>(row.sides[side].tree)] = 1;
  for (int32_t i = 0; i < static_cast<int32_t>(count_); ++i) {
    const int32_t island = island_of_tree_[static_cast<size_t>(i)] =
        island_of_tree_[static_cast<size_t>(find_root(i))];
    const bool by_itself = island < 0 || island_joined_[static_cast<size_t>(island)] == 0;
    const bool needed = met_[static_cast<size_t>(i)] != 0;
    (alone && by_itself && !needed ? alone_ : together_).push_back(i);
  }
  for (size_t i = 0; i < island_joined_.size(); ++i)
    if (!alone || island_joined_[i] != 0) islands_together_.push_back(static_cast<int32_t>(i));
  NOVAPHY_ASSERT(alone_.size() + together_.size() == static_cast<size_t>(count_));
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
  const int32_t side = row.sides[0].tree >= 0 ? 0 : 1, link = row.sides[side].link;
  const art::TreeContact<float> contact = art::tree_contact(
      s.contacts, row.contact, side, moved_by_[static_cast<size_t>(trees_[tree].first_link + link)],
      s.material(row), kept_of(at), s.warm_scale);
  float values[sizeof(contact) / sizeof(float)];
  std::memcpy(values, &contact, sizeof(contact));
  for (const float value : values) {
    *numbers = value;
    numbers += stride;
  }
  return link;
}

void PgsContacts::take(int64_t tree, int32_t i, const float* impulses, int32_t stride) {
  Row& row = rows_[static_cast<size_t>(
      island_rows_.items(island_of_tree_[static_cast<size_t>(tree)])[static_cast<size_t>(i)])];
  row.frame = art::contact_frame(current_->contacts.normal[row.contact]);
  for (int32_t r = 0; r < 3; ++r) row.solver.impulse[r] = impulses[r * stride];
}

void PgsContacts::solved(int64_t tree, const art::IslandResult& result) {
  island_results_[static_cast<size_t>(island_of_tree_[static_cast<size_t>(tree)])] = result;
}

int32_t PgsContacts::hardest_row(int64_t island) const {
  const auto hardest = [](std::span<const int32_t> items, const auto& size) {
    return *std::max_element(items.begin(), items.end(),
                             [&](int32_t a, int32_t b) { return size(a) < size(b); });
  };
  const std::span<const int32_t> rows = island_rows_.items(island);
  if (!rows.empty()) {
    const auto push = [&](int32_t i) { return rows_[static_cast<size_t>(i)].solver.impulse[0]; };
    return rows_[static_cast<size_t>(hardest(rows, push))].contact;
  }
  const auto hold = [&](int32_t i) {
    return std::abs(friction_rows_[static_cast<size_t>(i)].impulse);
  };
  const Friction& f = friction_[static_cast<size_t>(hardest(island_friction_.items(island), hold))];
  return -1 - (trees_[f.tree].first_dof + f.dof);
}

namespace {

std::string pair_of_shapes(const Model& m, int32_t a, int32_t b) {
  return "shapes '" + m.shape_label[static_cast<size_t>(a)] + "' and '" +
         m.shape_label[static_cast<size_t>(b)] + "'";
}

}  // namespace

std::string describe(const FarIsland& of, const Model& m, const Articulations& articulations,
                     const ContactRows& c) {
  std::string text;
  for (const MessagePart& part :
       {MessagePart("the last of "), MessagePart(of.sweeps),
        MessagePart(" sweeps changed velocities by "), MessagePart(of.residual),
        MessagePart(" m/s, the largest impulse by "), MessagePart(of.largest),
        MessagePart(" m/s, at ")})
    text.append(part.text());
  return text + (of.at < 0 ? articulations.dof_name(m, -1 - of.at)
                           : pair_of_shapes(m, c.shape0[of.at], c.shape1[of.at]));
}

std::string PgsContacts::largest_force(const Model& m) const {
  const auto most = std::max_element(
      kept_.begin(), kept_.end(),
      [](const art::KeptContact& a, const art::KeptContact& b) { return a.normal < b.normal; });
  if (most == kept_.end()) return {};
  return std::string(MessagePart(most->normal / kept_dt_).text()) + " N between " +
         pair_of_shapes(m, most->shape0, most->shape1);
}

const art::KeptContact* PgsContacts::kept_of(size_t row) const {
  return warm_[row] < 0 ? nullptr : &kept_[static_cast<size_t>(warm_[row])];
}

art::IslandTree PgsContacts::island_tree(const ArticulationArguments& in, int32_t tree) {
  const ArticulationRows& rows = trees_[tree];
  return {articulation_tree(in, rows), workspace(rows, tree),
          rates_.data() + rates_begin_[static_cast<size_t>(tree)], in.arrays.qd + rows.first_dof,
          rows.moves != 0};
}

void PgsContacts::build_row(const Step& s, Row& row) {
  art::build_contact(
      s.contacts, [&](int32_t tree) { return island_tree(s.in, tree); },
      numbers_.data() + row.numbers, row);
}

void PgsContacts::set_target(const Step& s, Row& row) {
  art::set_target(s.law, s.material(row), row);
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
  NOVAPHY_ASSERT(numbers <= static_cast<int64_t>(numbers_.size()));
}
void PgsContacts::build_friction(const Step& s, int32_t i) {
  const Friction& f = friction_[static_cast<size_t>(i)];
  art::PgsJointFriction<float>& row = friction_rows_[static_cast<size_t>(i)];
  const int32_t dof = trees_[f.tree].first_dof + f.dof;
  art::build_friction(island_tree(s.in, f.tree), f.dof,
                      s.model.joint_friction.data()[dof] * s.law.dt,
                      const_cast<float*>(row.response), row);
}

bool PgsContacts::renew_tree(const Step& s, int32_t tree, int32_t round) {
  const int32_t island = island_of_tree_[static_cast<size_t>(tree)];
  return art::renew_tree(
      island_tree(s.in, tree), articulation_inputs(s.in), articulation_options(s.in), round,
      [&](bool, const auto& f) {
        for (const int32_t i : island_rows_.items(island)) f(rows_[static_cast<size_t>(i)].solver);
      },
      [&](const auto& f) {
        for (const int32_t i : island_friction_.items(island))
          f(friction_rows_[static_cast<size_t>(i)]);
      });
}

void PgsContacts::solve_island(const Step& s, int64_t island) {
  const std::span<const int32_t> rows = island_rows_.items(island);
  const std::span<const int32_t> friction = island_friction_.items(island);
  for (const int32_t i : rows) {
    Row& row = rows_[static_cast<size_t>(i)];
    std::fill_n(row.solver.impulse, 3, 0.0f);  // of the round before
    row.solver.shifted = 0.0f;
    build_row(s, row);
    set_target(s, row);
  }
  for (const int32_t i : friction) build_friction(s, i);
  for (const int32_t i : rows) {
    Row& row = rows_[static_cast<size_t>(i)];
    if (const art::KeptContact* const kept = kept_of(static_cast<size_t>(i)))
      art::start_from_kept(*kept, s.warm_scale, s.law.cone, row);
  }
  for (const int32_t i : friction)
    if (s.options.warm_start)
      art::warm_start(friction_rows_[static_cast<size_t>(i)], s.warm_scale * kept_friction(i));
  const auto contacts = [&](bool back, const auto& f) {
    for (size_t k = 0; k < rows.size(); ++k)
      f(rows_[static_cast<size_t>(rows[back ? rows.size() - 1 - k : k])].solver);
  };
  const auto dry = [&](const auto& f) {
    for (const int32_t i : friction) f(friction_rows_[static_cast<size_t>(i)]);
  };
  island_results_[static_cast<size_t>(island)] = art::sweep_island(
      s.law.cone, s.options.pgs_iterations, s.options.pgs_tolerance, contacts, dry);
}

// Writes the forces, and keeps the impulses for the next step.
void PgsContacts::keep(const ContactRows& c, float dt, Vec3f* force) {
  kept_.clear();
  kept_dt_ = dt;
  for (const Row& row : rows_) {
    const art::KeptContact kept = art::kept_contact(c, row.contact, row.frame, row.solver.impulse);
    if (force != nullptr) force[row.contact] = art::contact_force(row.frame, kept, dt);
    if (kept.normal > 0.0f && c.point_id != nullptr) kept_.push_back(kept);
  }
  for (size_t i = 0; i < friction_.size(); ++i)
    kept_friction(static_cast<int32_t>(i)) = friction_rows_[i].impulse;
}

void PgsContacts::step(const ArticulationStepArguments& a, const Model& m,
                       const ContactRows& contacts, const FeatherstoneOptions& options,
                       Vec3f* force, TreeSteps* alone) {
  const art::StepInputs<float> in = articulation_inputs(a.in);
  const art::StepOptions<float> how = articulation_options(a.in);
  const float dt = how.dt;
  far_ = {};
  split_trees(alone != nullptr);
  warm_.assign(rows_.size(), -1);
  int32_t next = 0;
  if (options.warm_start && !kept_.empty())
    for (size_t i = 0; i < rows_.size(); ++i)
      warm_[i] = art::find_kept(kept_.data(), static_cast<int32_t>(kept_.size()), next, contacts,
                                rows_[i].contact);
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
    const bool is_alone = island_of_tree_[static_cast<size_t>(i)] < 0;
    const int32_t failed = art::accelerate(tree, in, how, is_alone, ws);
    a.status[i] = failed < 0 ? 0 : 1 + failed + rows.first_dof;
    if (failed >= 0) return;
    art::free_rates(tree, in, how, ws);
    std::copy_n(ws.qd_next, rows.dof_count, rates);
    std::fill_n(rates + width(i), width(i), 0.0f);
  });
  for (const int32_t i : together_)
    if (a.status[i] != 0) return rows_.clear();  // nothing was solved

  place_friction();
  // Islands with a tree whose branches change are solved once more.
  for (int32_t round = 0; !islands_together_.empty(); ++round) {
    for_chunks(static_cast<int64_t>(islands_together_.size()), kIslandChunk,
               [&](int64_t begin, int64_t end, int64_t) {
                 for (int64_t i = begin; i < end; ++i)
                   solve_island(s, islands_together_[static_cast<size_t>(i)]);
               });
    const auto unsolved = [&](int32_t tree) {
      const int32_t island = island_of_tree_[static_cast<size_t>(tree)];
      return island >= 0 && island_solved_[static_cast<size_t>(island)] == 0;
    };
    tree_renewed_.assign(static_cast<size_t>(count_), 0);
    for_trees([&](int32_t i, const ArticulationRows&, const art::Tree<float>&,
                  art::Workspace<float>&, float*) {
      if (unsolved(i)) tree_renewed_[static_cast<size_t>(i)] = renew_tree(s, i, round);
    });
    for (const int32_t island : islands_together_) island_solved_[static_cast<size_t>(island)] = 1;
    for (const int32_t i : together_)
      if (tree_renewed_[static_cast<size_t>(i)] != 0)
        island_solved_[static_cast<size_t>(island_of_tree_[static_cast<size_t>(i)])] = 0;
    std::erase_if(islands_together_,
                  [&](int32_t island) { return island_solved_[static_cast<size_t>(island)] != 0; });
    if (islands_together_.empty()) break;
    for_trees([&](int32_t i, const ArticulationRows& rows, const art::Tree<float>&,
                  art::Workspace<float>&, float*) {
      if (!unsolved(i)) return;
      const int32_t failed = art::restart_tree(island_tree(a.in, i), in, how);
      if (failed >= 0) a.status[i] = 1 + failed + rows.first_dof;
    });
    for (const int32_t i : together_)
      if (a.status[i] != 0) return rows_.clear();
  }
  sweeps_ = 0;
  residual_ = 0.0f;
  for (size_t i = 0; i < island_results_.size(); ++i) {
    const art::IslandResult& of = island_results_[i];
    sweeps_ = std::max(sweeps_, of.sweeps);
    residual_ = std::max(residual_, of.residual);
    if (!art::far_from_converged(of.residual, of.largest, options.pgs_tolerance) ||
        of.residual <= far_.residual)
      continue;
    far_ = {of.sweeps, of.residual, of.largest, hardest_row(static_cast<int64_t>(i))};
  }
  if (std::all_of(a.status.rows(), a.status + count_, [](int32_t status) { return status == 0; }))
    keep(contacts, dt, force);

  for_trees([&](int32_t i, const ArticulationRows& rows, const art::Tree<float>& tree,
                art::Workspace<float>& ws, float* rates) {
    const int32_t failed = art::take_rates(rates, in.qd + rows.first_dof, dt, rows.dof_count, ws);
    if (failed >= 0) a.status[i] = 1 + failed + rows.first_dof;
    if (failed >= 0) return;
    write_step(a, rows, tree, in, how, ws);
  });
}

}  // namespace novaphy
