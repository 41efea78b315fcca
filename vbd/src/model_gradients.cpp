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
        h{inputs.dt, 0},
        at_solution(solved),
        memory(keep) {}

  void put_state() const {
    const bool guessed = !at_solution && pass.step.looked_back();
    Rows &by_gravity = memory.by_gravity, &by_last = memory.by_last;
    by_gravity.resize(g.gravity != nullptr ? pass.x_bar.size() : 0);
    by_last.resize(pass.x_bar.size());
    for_rows<VbdParticleGradientArguments>(
        vbd_particle_gradient_row,
        {pass.step.slots.held_flags().data(),
         m.particle_inv_mass.data(),
         in.particle_f,
         pass.x_bar.data(),
         pass.start_bar.data(),
         pass.target_bar.data(),
         pass.mass_bar.data(),
         h,
         int64_t{in.targets != nullptr},
         g.particle_q,
         g.particle_qd,
         g.particle_f,
         g.particle_mass,
         g.gravity != nullptr ? by_gravity.data() : nullptr,
         by_last.data(),
         guessed ? reinterpret_cast<const VbdRow*>(in.last_velocity) : nullptr,
         in.particle_qd,
         m.particle_world.data(),
         m.gravity.data(),
         int64_t{m.world_count()} - 1},
        pass.x_bar.size());
    if (g.last_velocity != nullptr)
      std::memcpy(g.last_velocity, by_last.data(), by_last.size() * sizeof(VbdRow));
    if (g.targets != nullptr) {
      const std::vector<int32_t>& held = pass.step.slots.held();
      if (in.targets != nullptr) {
        for_rows<VbdTargetGradientArguments>(
            vbd_target_gradient_row, {held.data(), pass.x_bar.data(), g.targets}, held.size());
      } else {
        std::fill_n(g.targets, held.size(), Vec3f{});
      }
    }
    if (g.gravity == nullptr) return;
    IndexRows& of_worlds = memory.of_worlds;  // which stay as they are
    if (of_worlds.empty()) of_worlds = particles_of_worlds(m);
    for_rows<VbdGravityGradientArguments>(
        vbd_gravity_gradient_row,
        {of_worlds.begins().data(), of_worlds.all().data(), by_gravity.data(), g.gravity},
        static_cast<size_t>(m.world_count()));
  }

  void put_elements() const {
    for_rows<VbdSpringGradientArguments>(vbd_spring_gradient_row,
                                         {pass.law_bars(kSpring), h, g.particle_spring_stiffness,
                                          g.particle_spring_damping, g.particle_spring_rest_length},
                                         m.particle_spring_indices.rows());
    for_rows<VbdTriangleGradientArguments>(
        vbd_triangle_gradient_row,
        {pass.law_bars(kTriangle), m.particle_tri_area.data(), m.particle_tri_material.data(), h,
         g.particle_tri_material, g.particle_tri_activation, g.particle_tri_area,
         g.particle_tri_pose},
        m.particle_tri_indices.rows());
    for_rows<VbdEdgeGradientArguments>(
        vbd_edge_gradient_row,
        {pass.law_bars(kHingeOpposite), pass.law_bars(kHingeEnd), m.particle_edge_material.data(),
         m.particle_edge_rest_length.data(), h, g.particle_edge_material,
         g.particle_edge_rest_angle, g.particle_edge_rest_length},
        m.particle_edge_indices.rows());
    for_rows<VbdTetrahedronGradientArguments>(
        vbd_tetrahedron_gradient_row,
        {pass.law_bars(kTetrahedron), m.particle_tet_pose.data(), m.particle_tet_material.data(), h,
         g.particle_tet_material, g.particle_tet_activation, g.particle_tet_pose},
        m.particle_tet_indices.rows());
  }

  void put_contacts() const {
    const StepContacts& contacts = pass.step.contacts;
    const float* const bars = pass.contact_bars.data();
    if (g.particle_radius != nullptr)
      for_rows<VbdRadiusGradientArguments>(vbd_radius_gradient_row,
                                           {pass.step.sweep.contact_begin, bars, g.particle_radius},
                                           static_cast<size_t>(m.particle_count()));
    std::vector<int32_t>& shape_of_contact = memory.shape_of_contact;
    shape_of_contact.clear();
    for (const int32_t slot : contacts.slots())
      shape_of_contact.push_back(in.contacts->soft_contact_shape.data()[slot]);
    IndexRows& of_shapes = memory.of_shapes;
    of_shapes.build(shape_of_contact, m.shape_count());
    for_rows<VbdShapeGradientArguments>(vbd_shape_gradient_row,
                                        {of_shapes.begins().data(),
                                         of_shapes.all().data(),
                                         bars,
                                         m.shape_material_mu.data(),
                                         {m.soft_contact_mu, 0},
                                         h,
                                         g.shape_margin,
                                         g.shape_material_ke,
                                         g.shape_material_kd,
                                         g.shape_material_mu},
                                        static_cast<size_t>(m.shape_count()));
  }

 private:
  const ReversePass& pass;
  const VbdStepInputs& in;
  const VbdStepGradients& g;
  const Model& m;
  FloatWord h;
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
