#include "novaphy/dynamics/diff_gradient_notes.h"

#include <cstring>
#include <span>
#include <utility>
#include <vector>

#include "gradient_notes_launches.h"
#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"

namespace novaphy {
namespace {

template <class T>
constexpr size_t kNumbers = sizeof(T) / sizeof(int32_t);

// Steps with more than kFewContacts contacts are evaluated in kParts parts.
constexpr size_t kParts = 64;
constexpr int64_t kFewContacts = 256;

// Returns null if the array has no rows.
const DeviceArray<float>* if_any(const DeviceArray<float>& array) {
  return array.rows() == 0 ? nullptr : &array;
}

template <class T>
void fill(const DeviceArray<int32_t>& array, const T& with) {
  std::vector<int32_t> words(array.rows() * kNumbers<T>);
  for (size_t i = 0; i < array.rows(); ++i)
    std::memcpy(words.data() + i * kNumbers<T>, &with, sizeof(T));
  DeviceArray<int32_t> to = array;
  to.copy_from_host(std::span<const int32_t>(words));
}

SoftModes soft_modes(const Model& m, const NotedStep& step) {
  return {.mass = m.particle_mass,
          .ke = m.shape_material_ke,
          .kf = m.shape_material_kf,
          .mu = m.shape_material_mu,
          .model_ke = m.soft_contact_ke,
          .model_kf = m.soft_contact_kf,
          .model_mu = m.soft_contact_mu,
          .kf_rate = step.kf_rate};
}
RigidModes rigid_modes(const Model& m, const NotedStep& step) {
  return {.body_qd = step.body_qd,
          .body_com = m.body_com,
          .ke = m.shape_material_ke,
          .kd = m.shape_material_kd,
          .kf = m.shape_material_kf,
          .mu = m.shape_material_mu,
          .smoothing = step.smoothing};
}

}  // namespace

void GradientNotes::List::reserve(int64_t contacts, Device device) {
  rows = contacts;
  if (static_cast<int64_t>(now.rows()) >= rows) return;
  const UntrackedScope untracked;
  now = DeviceArray<int32_t>(static_cast<size_t>(rows), device, kNumbers<SeenContact>);
  before = DeviceArray<int32_t>(static_cast<size_t>(rows), device, kNumbers<SeenContact>);
  fill(now, SeenContact{});
}

void GradientNotes::Looks::at_soft(const Model& m, const NotedStep& step) {
  const ContactFields& c = *step.contacts;
  const auto rows = static_cast<int64_t>(c.soft_contact_particle.rows());
  if (rows == 0) return;
  soft.reserve(rows, m.device());
  run(note_kernels().soft, rows,
      {.seen = SeenRows{.now = Untyped(soft.now),
                        .before = Untyped(soft.before),
                        .count = c.soft_contact_count},
       .particle = c.soft_contact_particle,
       .shape = c.soft_contact_shape,
       .point = c.soft_contact_body_pos,
       .velocity = c.soft_contact_body_vel,
       .normal = c.soft_contact_normal,
       .q = step.q,
       .qd = step.qd,
       .body_q = step.body_q,
       .body_qd = step.body_qd,
       .body_com = m.body_com,
       .shape_body = m.shape_body,
       .shape_type = m.shape_type,
       .shape_scale = m.shape_scale,
       .radius = m.particle_radius,
       .margin = step.slip > 0.0f ? &m.shape_margin : nullptr,
       .modes = soft_modes(m, step),
       .slip = step.slip,
       .follows = step.soft_contact_moves,
       .shapes = m.shape_count()});
}

void GradientNotes::Looks::at_static_particles(const Model& m, const NotedStep& step) {
  const auto particles = static_cast<int64_t>(step.q.rows());
  const bool all = step.shapes_of == nullptr;
  const int64_t rows = all ? particles * m.shape_count() : step.shape.rows;
  if (rows == 0) return;
  soft.reserve(rows, m.device());
  const auto table = [&](const std::shared_ptr<Range>& range) {
    return Array(DType::int32, range->bytes() / sizeof(int32_t), 1, range);
  };
  const Array begin = all ? Array() : table(step.shapes_of->offsets);
  const Array shape = all ? Array() : table(step.shape.range);
  run(note_kernels().static_particles, particles,
      {.now = Untyped(soft.now),
       .before = Untyped(soft.before),
       .begin = Untyped(begin),
       .shape = Untyped(shape),
       .q = step.q,
       .qd = step.qd,
       .shape_flags = m.shape_flags,
       .shape_body = m.shape_body,
       .shape_type = m.shape_type,
       .shape_transform = m.shape_transform,
       .shape_scale = m.shape_scale,
       .radius = m.particle_radius,
       .margin = m.shape_margin,
       .modes = soft_modes(m, step),
       .reach = step.static_reach,
       .shapes = m.shape_count()});
}

void GradientNotes::Looks::at_rigid(const Model& m, const NotedStep& step) {
  const ContactFields& c = *step.contacts;
  const auto rows = static_cast<int64_t>(c.rigid_contact_shape0.rows());
  if (rows == 0) return;
  rigid.reserve(rows, m.device());
  const MovingContacts of = {.shape0 = c.rigid_contact_shape0,
                               .shape1 = c.rigid_contact_shape1,
                               .point0 = c.rigid_contact_point0,
                               .point1 = c.rigid_contact_point1,
                               .normal = c.rigid_contact_normal,
                               .body_q = step.body_q,
                               .shape_body = m.shape_body,
                               .shape_type = m.shape_type,
                               .shape_transform = m.shape_transform,
                               .shape_scale = m.shape_scale};
  run(note_kernels().rigid, rows,
      {.seen = SeenRows{.now = Untyped(rigid.now),
                        .before = Untyped(rigid.before),
                        .count = c.rigid_contact_count},
       .of = of,
       .point_id = c.rigid_contact_point_id,
       .margin0 = c.rigid_contact_margin0,
       .margin1 = c.rigid_contact_margin1,
       .row_ke = if_any(c.rigid_contact_stiffness),
       .row_kd = if_any(c.rigid_contact_damping),
       .row_mu = if_any(c.rigid_contact_friction),
       .modes = rigid_modes(m, step),
       .follows = step.rigid_contact_moves,
       .shapes = m.shape_count()});
}

void GradientNotes::Looks::at_planes(const Model& m, const NotedStep& step) {
  const int64_t pairs = step.plane_pairs.rows;
  rigid.reserve(pairs * kPlanePoints, m.device());
  const Array table(DType::int32, static_cast<size_t>(2 * pairs), 1, step.plane_pairs.range);
  run(note_kernels().planes, pairs,
      {.now = Untyped(rigid.now),
       .before = Untyped(rigid.before),
       .pairs = Untyped(table),
       .body_q = step.body_q,
       .shape_body = m.shape_body,
       .shape_type = m.shape_type,
       .shape_transform = m.shape_transform,
       .shape_scale = m.shape_scale,
       .margin = m.shape_margin,
       .modes = rigid_modes(m, step)});
}

void GradientNotes::Looks::look(const Model& m, const NotedStep& step) {
  const nova::NoGrad no_grad;
  soft.rows = rigid.rows = 0;
  if (step.contacts != nullptr && step.soft) at_soft(m, step);
  if (step.static_particles) at_static_particles(m, step);
  if (step.contacts != nullptr && step.rigid) at_rigid(m, step);
  if (step.plane_pairs.range != nullptr && step.plane_pairs.rows > 0) at_planes(m, step);
  const int64_t contacts = soft.rows + rigid.rows;
  const bool continues = ended == step.start;
  ended = contacts > 0 ? step.end : nullptr;
  const int64_t step_number = steps++;
  if (contacts == 0) return;
  const bool begins = parts.rows() == 0;  // true in every replay of a capture too
  if (begins) {
    const UntrackedScope untracked;
    parts = DeviceArray<int32_t>(kParts, m.device(), kNumbers<StepNotes>);
    sums = DeviceArray<int32_t>(1, m.device(), kNumbers<GradientCounts>);
  }
  const int64_t count = contacts > kFewContacts ? int64_t{kParts} : 1;
  const Array none;
  run(note_kernels().events, count,
      {.soft_now = Untyped(soft.now),
       .soft_before = Untyped(soft.before),
       .rigid_now = Untyped(rigid.now),
       .rigid_before = Untyped(rigid.before),
       .soft_count = soft.rows,
       .rigid_count = rigid.rows,
       .continues = continues,
       .notes = Untyped(parts),
       .counts = Untyped(count == 1 ? sums : none),
       .step = step_number,
       .begins = begins});
  run(note_kernels().step, count > 1 ? 1 : 0,
      {.notes = Untyped(parts),
       .counts = Untyped(sums),
       .parts = count,
       .step = step_number,
       .begins = begins});
}

GradientCounts GradientNotes::Looks::counts() const {
  GradientCounts all;
  if (sums.rows() > 0) {
    const UntrackedScope untracked;
    const std::vector<int32_t> words = sums.to_host();
    std::memcpy(static_cast<void*>(&all), words.data(), sizeof(all));
  }
  all.exact += steps - all.steps;
  all.steps = steps;
  return all;
}

void GradientNotes::add(const Model& model, NotedStep step, bool keeps) {
  if (ended_ != step.start) clear();
  ended_ = step.end;
  add_to_all(model, std::move(step), keeps);
}
void GradientNotes::add_to_all(const Model& model, NotedStep step, bool keeps) {
  if (keeps)
    chain_.push_back(std::move(step));
  else
    looks_.look(model, step);
}

std::shared_ptr<const ContactFields> GradientNotes::handles(const Contacts* contacts) {
  if (contacts == nullptr) return nullptr;
  const ContactFields& fields = *contacts;
  if (!chain_.empty()) {
    const auto& last = chain_.back().contacts;
    const auto same = [](const Array& a, const Array& b) { return a.range() == b.range(); };
    if (last != nullptr && same(last->rigid_contact_count, fields.rigid_contact_count) &&
        same(last->soft_contact_count, fields.soft_contact_count))
      return last;
  }
  return std::make_shared<const ContactFields>(fields);
}

GradientCounts GradientNotes::counts(const Model& model) const {
  if (chain_.empty()) return looks_.counts();
  Looks looks;  // all states of the chain are kept
  for (const NotedStep& step : chain_) looks.look(model, step);
  return looks.counts();
}

void GradientNotes::clear() {
  chain_.clear();
  looks_ = {};
}

GradientInfo gradient_info(const nova::Tape& tape) {
  std::vector<GradientInfo> all;
  for (const auto& witness : tape.witnesses())
    if (const auto* of = dynamic_cast<const GradientWitness*>(witness.get()))
      all.push_back(of->info());
  require(!all.empty(), ErrorKind::Runtime,
          "Tape.gradient_info: expected steps of a differentiable solver on the tape, got none");
  require(tape.passes() > 0, ErrorKind::Runtime,
          "Tape.gradient_info: expected a backward of this tape before, got none");
  return worst_of(all);
}

}  // namespace novaphy
