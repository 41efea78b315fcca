"""Differentiable operators, tensor views of states and models, losses, Trajectory.

Tensors in and out are nova.Tensor, float32. Views are the arrays' own memory: the same
(object, field) gives the same Tensor, so a gradient is found again where it was recorded.
"""

from .._require import require_diff

require_diff("novaphy.diff")

from .._core.diff import (  # noqa: E402
    Trajectory,
    clamp_f32_generated,
    engine_programs,
    eval_static_particle_shape_contact_forces_generated,
    integrate_particles_generated,
    integrate_particles_with_static_contacts_generated,
    model_gravity_tensor,
    model_particle_mass_tensor,
    model_particle_radius_tensor,
    model_shape_material_kd_tensor,
    model_shape_material_ke_tensor,
    model_shape_material_kf_tensor,
    model_shape_material_mu_tensor,
    particle_centroid_generated,
    particle_point_loss_generated,
    state_body_f_tensor,
    state_body_q_tensor,
    state_body_qd_tensor,
    state_joint_q_tensor,
    state_joint_qd_tensor,
    state_particle_f_tensor,
    state_particle_q_tensor,
    state_particle_qd_tensor,
    update_inverse_mass,
    vec3_point_loss_generated,
)

__all__ = [
    "Trajectory",
    "clamp_f32_generated",
    "engine_programs",
    "eval_static_particle_shape_contact_forces_generated",
    "integrate_particles_generated",
    "integrate_particles_with_static_contacts_generated",
    "model_gravity_tensor",
    "model_particle_mass_tensor",
    "model_particle_radius_tensor",
    "model_shape_material_kd_tensor",
    "model_shape_material_ke_tensor",
    "model_shape_material_kf_tensor",
    "model_shape_material_mu_tensor",
    "particle_centroid_generated",
    "particle_point_loss_generated",
    "state_body_f_tensor",
    "state_body_q_tensor",
    "state_body_qd_tensor",
    "state_joint_q_tensor",
    "state_joint_qd_tensor",
    "state_particle_f_tensor",
    "state_particle_q_tensor",
    "state_particle_qd_tensor",
    "update_inverse_mass",
    "vec3_point_loss_generated",
]
