// The derivatives of a scalar by the arrays of the model and the state.
#include <algorithm>
#include <cstring>
#include <vector>

#include "model_derivatives.h"

namespace novaphy::vbd {
namespace {

template <class Arguments>
void for_rows(void (*kernel)(const Arguments&, int64_t, int64_t), const Arguments& arguments,
              size_t rows) {
  const auto n = static_cast<int64_t>(rows);
  for (int64_t row = 0; row < n; ++row) kernel(arguments, row, n);
}

class Gradients {
 public:
  Gradients(const ReversePass& from, const VbdStepInputs& inputs, const VbdStepGradients& to,
            bool solved, GradientMemory& keep)
      : pass(from),
        in(inputs),
        g(to),
        m(from.step.model),
        h(inputs.dt),
        at_solution(solved),
        memory(keep) {}

  void put_state() const {
    const bool guessed = !at_solution && pass.step.looked_back();
    Rows &by_gravity = memory.by_gravity, &by_last = memory.by_last;
    by_gravity.resize(g.gravity != nullptr ? pass.x_bar.size() : 0);
    by_last.resize(pass.x_bar.size());
    for_rows<VbdParticleGradientArguments>(
        vbd_particle_gradient_row,
        {.is_held = direct(pass.step.slots.held_flags()),
         .inv_mass = direct(m.particle_inv_mass.data()),
         .f = direct(in.particle_f),
         .x_bar = direct(pass.x_bar),
         .start_bar = direct(pass.start_bar),
         .target_bar = direct(pass.target_bar),
         .mass_bar = direct(pass.mass_bar),
         .h = h,
         .have_targets = int{in.targets != nullptr},
         .by_q = direct(g.particle_q),
         .by_qd = direct(g.particle_qd),
         .by_f = direct(g.particle_f),
         .by_mass = direct(g.particle_mass),
         .by_gravity = direct(g.gravity != nullptr ? by_gravity.data() : nullptr),
         .by_last = direct(by_last),
         .last = direct(guessed ? reinterpret_cast<const VbdRow*>(in.last_velocity) : nullptr),
         .qd = direct(in.particle_qd),
         .world = direct(m.particle_world.data()),
         .gravity = direct(m.gravity.data()),
         .last_world = m.world_count() - 1},
        pass.x_bar.size());
    if (g.last_velocity != nullptr)
      std::memcpy(g.last_velocity, by_last.data(), by_last.size() * sizeof(VbdRow));
    if (g.targets != nullptr) {
      const std::vector<int32_t>& held = pass.step.slots.held();
      if (in.targets != nullptr) {
        for_rows<VbdTargetGradientArguments>(
            vbd_target_gradient_row,
            {.held = direct(held), .x_bar = direct(pass.x_bar), .by_targets = direct(g.targets)},
            held.size());
      } else {
        std::fill_n(g.targets, held.size(), Vec3f{});
      }
    }
    if (g.gravity == nullptr) return;
    IndexRows& of_worlds = memory.of_worlds;  // which stay as they are
    if (of_worlds.empty()) of_worlds = particles_of_worlds(m);
    for_rows<VbdGravityGradientArguments>(vbd_gravity_gradient_row,
                                          {.begin = direct(of_worlds.begins().data()),
                                           .particles = direct(of_worlds.all().data()),
                                           .of_particles = direct(by_gravity),
                                           .by_gravity = direct(g.gravity)},
                                          static_cast<size_t>(m.world_count()));
  }

  void put_elements() const {
    for_rows<VbdSpringGradientArguments>(vbd_spring_gradient_row,
                                         {.bars = pass.law_bars(kSpring),
                                          .h = h,
                                          .by_stiffness = direct(g.particle_spring_stiffness),
                                          .by_damping = direct(g.particle_spring_damping),
                                          .by_rest_length = direct(g.particle_spring_rest_length)},
                                         m.particle_spring_indices.rows());
    for_rows<VbdTriangleGradientArguments>(vbd_triangle_gradient_row,
                                           {.bars = pass.law_bars(kTriangle),
                                            .area = direct(m.particle_tri_area.data()),
                                            .material = direct(m.particle_tri_material.data()),
                                            .h = h,
                                            .by_material = direct(g.particle_tri_material),
                                            .by_activation = direct(g.particle_tri_activation),
                                            .by_area = direct(g.particle_tri_area),
                                            .by_pose = direct(g.particle_tri_pose)},
                                           m.particle_tri_indices.rows());
    for_rows<VbdEdgeGradientArguments>(vbd_edge_gradient_row,
                                       {.opposite = pass.law_bars(kHingeOpposite),
                                        .end = pass.law_bars(kHingeEnd),
                                        .material = direct(m.particle_edge_material.data()),
                                        .rest_length = direct(m.particle_edge_rest_length.data()),
                                        .h = h,
                                        .by_material = direct(g.particle_edge_material),
                                        .by_rest_angle = direct(g.particle_edge_rest_angle),
                                        .by_rest_length = direct(g.particle_edge_rest_length)},
                                       m.particle_edge_indices.rows());
    for_rows<VbdTetrahedronGradientArguments>(vbd_tetrahedron_gradient_row,
                                              {.bars = pass.law_bars(kTetrahedron),
                                               .pose = direct(m.particle_tet_pose.data()),
                                               .material = direct(m.particle_tet_material.data()),
                                               .h = h,
                                               .by_material = direct(g.particle_tet_material),
                                               .by_activation = direct(g.particle_tet_activation),
                                               .by_pose = direct(g.particle_tet_pose)},
                                              m.particle_tet_indices.rows());
  }

  void put_contacts() const {
    const StepContacts& contacts = pass.step.contacts;
    const float* const bars = pass.contact_bars.data();
    if (g.particle_radius != nullptr)
      for_rows<VbdRadiusGradientArguments>(vbd_radius_gradient_row,
                                           {.contact_begin = direct(pass.step.sweep.contact_begin),
                                            .contact_bars = direct(bars),
                                            .by_radius = direct(g.particle_radius)},
                                           static_cast<size_t>(m.particle_count()));
    std::vector<int32_t>& shape_of_contact = memory.shape_of_contact;
    shape_of_contact.clear();
    for (const int32_t slot : contacts.slots())
      shape_of_contact.push_back(in.contacts->soft_contact_shape.data()[slot]);
    IndexRows& of_shapes = memory.of_shapes;
    of_shapes.build(shape_of_contact, m.shape_count());
    for_rows<VbdShapeGradientArguments>(vbd_shape_gradient_row,
                                        {.begin = direct(of_shapes.begins().data()),
                                         .contacts = direct(of_shapes.all().data()),
                                         .contact_bars = direct(bars),
                                         .mu = direct(m.shape_material_mu.data()),
                                         .model_mu = m.soft_contact_mu,
                                         .h = h,
                                         .by_margin = direct(g.shape_margin),
                                         .by_ke = direct(g.shape_material_ke),
                                         .by_kd = direct(g.shape_material_kd),
                                         .by_mu = direct(g.shape_material_mu)},
                                        static_cast<size_t>(m.shape_count()));
  }

 private:
  const ReversePass& pass;
  const VbdStepInputs& in;
  const VbdStepGradients& g;
  const Model& m;
  float h;
  bool at_solution;
  GradientMemory& memory;
};

}  // namespace

bool wants_weights(const VbdStepGradients& g) {
  return g.particle_tri_pose != nullptr || g.particle_tet_pose != nullptr;
}

bool wants_damping(const VbdStepGradients& g) {
  return g.particle_tri_material != nullptr || g.particle_edge_material != nullptr ||
         g.particle_tet_material != nullptr;
}
bool wants_damping(const VbdStepTangents& direction) {
  return direction.particle_tri_material != nullptr ||
         direction.particle_edge_material != nullptr || direction.particle_tet_material != nullptr;
}
bool wants_damping(const VbdStepArrays& g) {
  return g.particle_tri_material.rows() != 0 || g.particle_edge_material.rows() != 0 ||
         g.particle_tet_material.rows() != 0;
}

void put_gradients(const ReversePass& pass, const VbdStepInputs& inputs,
                   const VbdStepGradients& gradients, bool at_solution, GradientMemory& memory) {
  const Gradients g(pass, inputs, gradients, at_solution, memory);
  g.put_state();
  g.put_elements();
  g.put_contacts();
}

}  // namespace novaphy::vbd
