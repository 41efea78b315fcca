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

// The contacts of a step are looked at in parts where they may be more than a few.
constexpr size_t kParts = 64;
constexpr int64_t kFewContacts = 256;

// What a tape makes of the step, its own operations say.
LaunchArgument value(const char* name, const Array& array) { return reads(name, array).detached(); }
LaunchArgument value_if_any(const char* name, const Array& array) {
  return array.rows() == 0 ? LaunchArgument() : value(name, array);
}

template <class T>
void fill(const DeviceArray<int32_t>& array, const T& with) {
  std::vector<int32_t> words(array.rows() * kNumbers<T>);
  for (size_t i = 0; i < array.rows(); ++i)
    std::memcpy(words.data() + i * kNumbers<T>, &with, sizeof(T));
  DeviceArray<int32_t> to = array;
  to.copy_from_host(std::span<const int32_t>(words));
}

// The words of SoftModes.
std::vector<LaunchArgument> mode_words_of_particles(const Model& m, const NotedStep& step) {
  return {value("particle_mass", m.particle_mass),
          value("shape_material_ke", m.shape_material_ke),
          value("shape_material_kf", m.shape_material_kf),
          value("shape_material_mu", m.shape_material_mu),
          number(m.soft_contact_ke),
          number(m.soft_contact_kf),
          number(m.soft_contact_mu),
          number(step.kf_rate)};
}
// The words of RigidModes.
std::vector<LaunchArgument> mode_words(const Model& m, const NotedStep& step) {
  return {value("body_qd", step.body_qd),
          value("body_com", m.body_com),
          value("shape_material_ke", m.shape_material_ke),
          value("shape_material_kd", m.shape_material_kd),
          value("shape_material_kf", m.shape_material_kf),
          value("shape_material_mu", m.shape_material_mu),
          number(step.smoothing)};
}
void append(std::vector<LaunchArgument>& to, std::vector<LaunchArgument> more) {
  to.insert(to.end(), more.begin(), more.end());
}

}  // namespace

void GradientNotes::List::reserve(int64_t contacts, Device device) {
  rows = contacts;
  if (static_cast<int64_t>(now.rows()) >= rows) return;
  const Unobserved unobserved;
  now = DeviceArray<int32_t>(static_cast<size_t>(rows), device, kNumbers<SeenContact>);
  before = DeviceArray<int32_t>(static_cast<size_t>(rows), device, kNumbers<SeenContact>);
  fill(now, SeenContact{});
}

void GradientNotes::Looks::at_soft(const Model& m, const NotedStep& step) {
  const ContactFields& c = *step.contacts;
  const auto rows = static_cast<int64_t>(c.soft_contact_particle.rows());
  if (rows == 0) return;
  soft.reserve(rows, m.device());
  std::vector<LaunchArgument> words = {
      updates_row("now", soft.now),
      updates_row("before", soft.before),
      reads("soft_contact_count", c.soft_contact_count),
      reads("soft_contact_particle", c.soft_contact_particle),
      reads("soft_contact_shape", c.soft_contact_shape),
      value("soft_contact_body_pos", c.soft_contact_body_pos),
      value("soft_contact_body_vel", c.soft_contact_body_vel),
      value("soft_contact_normal", c.soft_contact_normal),
      value("particle_q", step.q),
      value("particle_qd", step.qd),
      value("body_q", step.body_q),
      value("body_qd", step.body_qd),
      value("body_com", m.body_com),
      reads("shape_body", m.shape_body),
      reads("shape_type", m.shape_type),
      value("shape_scale", m.shape_scale),
      value("particle_radius", m.particle_radius),
      step.slip > 0.0f ? value("shape_margin", m.shape_margin) : LaunchArgument()};
  append(words, mode_words_of_particles(m, step));
  append(words,
         {number(step.slip), number(int64_t{step.soft_follow}), number(int64_t{m.shape_count()})});
  note_kernels().soft.launch(m.device(), rows, words);
}

void GradientNotes::Looks::at_static_particles(const Model& m, const NotedStep& step) {
  const auto particles = static_cast<int64_t>(step.q.rows());
  const bool all = step.shapes_of == nullptr;
  const int64_t rows = all ? particles * m.shape_count() : step.shape.rows;
  if (rows == 0) return;
  soft.reserve(rows, m.device());
  const LaunchArgument none;
  const auto table = [&](const char* name, const std::shared_ptr<Range>& range) {
    return reads(name, Array(DType::int32, range->bytes() / sizeof(int32_t), 1, range));
  };
  std::vector<LaunchArgument> words = {
      updates("now", soft.now),
      updates("before", soft.before),
      none,
      all ? none : table("pairs_of_particles", step.shapes_of->offsets),
      all ? none : table("pair_shape", step.shape.range),
      value("particle_q", step.q),
      value("particle_qd", step.qd),
      reads("shape_flags", m.shape_flags),
      reads("shape_body", m.shape_body),
      reads("shape_type", m.shape_type),
      value("shape_transform", m.shape_transform),
      value("shape_scale", m.shape_scale),
      value("particle_radius", m.particle_radius),
      value("shape_margin", m.shape_margin)};
  append(words, mode_words_of_particles(m, step));
  append(words, {number(step.static_reach), number(int64_t{m.shape_count()})});
  note_kernels().static_particles.launch(m.device(), particles, words);
}

void GradientNotes::Looks::at_rigid(const Model& m, const NotedStep& step) {
  const ContactFields& c = *step.contacts;
  const auto rows = static_cast<int64_t>(c.rigid_contact_shape0.rows());
  if (rows == 0) return;
  rigid.reserve(rows, m.device());
  std::vector<LaunchArgument> words = {
      updates_row("now", rigid.now),
      updates_row("before", rigid.before),
      reads("rigid_contact_count", c.rigid_contact_count),
      reads("rigid_contact_shape0", c.rigid_contact_shape0),
      reads("rigid_contact_shape1", c.rigid_contact_shape1),
      value("rigid_contact_point0", c.rigid_contact_point0),
      value("rigid_contact_point1", c.rigid_contact_point1),
      value("rigid_contact_normal", c.rigid_contact_normal),
      value("body_q", step.body_q),
      reads("shape_body", m.shape_body),
      reads("shape_type", m.shape_type),
      value("shape_transform", m.shape_transform),
      value("shape_scale", m.shape_scale),
      reads("rigid_contact_point_id", c.rigid_contact_point_id),
      value("rigid_contact_margin0", c.rigid_contact_margin0),
      value("rigid_contact_margin1", c.rigid_contact_margin1),
      value_if_any("rigid_contact_stiffness", c.rigid_contact_stiffness),
      value_if_any("rigid_contact_damping", c.rigid_contact_damping),
      value_if_any("rigid_contact_friction", c.rigid_contact_friction)};
  append(words, mode_words(m, step));
  append(words, {number(int64_t{step.rigid_follow}), number(int64_t{m.shape_count()})});
  note_kernels().rigid.launch(m.device(), rows, words);
}

void GradientNotes::Looks::at_planes(const Model& m, const NotedStep& step) {
  const int64_t pairs = step.plane_pairs.rows;
  rigid.reserve(pairs * kPlanePoints, m.device());
  const Array table(DType::int32, static_cast<size_t>(2 * pairs), 1, step.plane_pairs.range);
  std::vector<LaunchArgument> words = {updates("now", rigid.now),
                                       updates("before", rigid.before),
                                       LaunchArgument(),
                                       reads("pairs", table),
                                       value("body_q", step.body_q),
                                       reads("shape_body", m.shape_body),
                                       reads("shape_type", m.shape_type),
                                       value("shape_transform", m.shape_transform),
                                       value("shape_scale", m.shape_scale),
                                       value("shape_margin", m.shape_margin)};
  append(words, mode_words(m, step));
  note_kernels().planes.launch(m.device(), pairs, words);
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
  const LaunchArgument number_of_step = number(steps++);
  if (contacts == 0) return;
  // A replay of a capture begins anew.
  const LaunchArgument begins = number(int64_t{parts.rows() == 0});
  if (parts.rows() == 0) {
    const Unobserved unobserved;
    parts = DeviceArray<int32_t>(kParts, m.device(), kNumbers<StepNotes>);
    sums = DeviceArray<int32_t>(1, m.device(), kNumbers<GradientCounts>);
  }
  const int64_t count = contacts > kFewContacts ? int64_t{kParts} : 1;
  const LaunchArgument none;
  note_kernels().events.launch(
      m.device(), count,
      {reads("soft_now", soft.now), reads("soft_before", soft.before),
       reads("rigid_now", rigid.now), reads("rigid_before", rigid.before), number(soft.rows),
       number(rigid.rows), number(int64_t{continues}), writes_row("parts", parts),
       count == 1 ? updates("sums", sums) : none, number_of_step, begins});
  if (count > 1)
    note_kernels().step.launch(
        m.device(), 1,
        {reads("parts", parts), updates("sums", sums), number(count), number_of_step, begins});
}

GradientCounts GradientNotes::Looks::counts() const {
  GradientCounts all;
  if (sums.rows() > 0) {
    const Unobserved unobserved;
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
  Looks looks;  // of states that are all there
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
  require(tape.has_gone_back(), ErrorKind::Runtime,
          "Tape.gradient_info: expected a backward of this tape before, got none");
  return worst_of(all);
}

}  // namespace novaphy
