"""Arguments of other projects, and what to use instead."""

from __future__ import annotations

# Name of an argument in other projects -> what to use instead.
ARGUMENTS: dict[str, str] = {
    "target_pos": "target_q",
    "target_vel": "target_qd",
    "y": "height, along the up axis of the builder",
    "contact_matching": "Contacts.match(previous) behind collide",
    "contact_report": "Contacts.match(previous) behind collide",
    "shape_pairs_max": "rigid_contact_max; the memory for pairs needs no bound",
    "update_mass_matrix_interval": "nothing: every step factors the mass matrix",
    "use_tile_gemm": "nothing: there is one way to factor the mass matrix",
    "fuse_cholesky": "nothing: there is one way to factor the mass matrix",
    "deterministic": "nothing: a step has the same bits in every run",
    "enable_fast_math": "nothing: a step has the same bits everywhere",
    "collision_pipeline": "CollisionPipeline.collide before step, or pipeline= of rollout",
    "collision_frequency": "CollisionPipeline.collide as often as contacts are to be found",
    "joint_mimic_ke": "SolverFeatherstone, whose mimic joints follow exactly",
    "joint_mimic_kd": "SolverFeatherstone, whose mimic joints follow exactly",
    "rigid_contact_history": "nothing: contacts start from the forces of the step before",
    "rigid_contact_hard": "ShapeConfig.ke: contacts of bodies are compliant",
    "rigid_compliant_alm": "nothing: contacts have the compliant form",
    "integrate_with_external_rigid_solver": "kinematic bodies (add_body(is_kinematic=True))",
    "rigid_avbd_alpha": "nothing: a step leaves 0.95 of the error of a joint",
    "rigid_contact_alpha": "nothing: a step leaves 0.95 of the error of a joint",
    "rigid_joint_alpha": "nothing: a step leaves 0.95 of the error of a joint",
    "rigid_avbd_beta_linear": "nothing: the iteration takes its stiffness from the masses",
    "rigid_avbd_beta_angular": "nothing: the iteration takes its stiffness from the masses",
    "rigid_linear_beta": "nothing: the iteration takes its stiffness from the masses",
    "rigid_angular_beta": "nothing: the iteration takes its stiffness from the masses",
    "initial_penalty": "nothing: the iteration takes its stiffness from the masses",
    "rigid_contact_k_start_value": "nothing: the iteration takes its stiffness from the masses",
    "rigid_joint_linear_k_start": "nothing: the iteration takes its stiffness from the masses",
    "rigid_joint_angular_k_start": "nothing: the iteration takes its stiffness from the masses",
    "rigid_avbd_gamma": "nothing: the next step starts from 0.999 of the forces",
    "rigid_joint_linear_ke": "nothing: joints are hard",
    "rigid_joint_linear_kd": "nothing: joints are hard",
    "rigid_joint_angular_ke": "nothing: joints are hard",
    "rigid_joint_angular_kd": "nothing: joints are hard",
    "rigid_body_contact_buffer_size": "nothing: bodies have any number of contacts",
    "rigid_body_particle_contact_buffer_size": "nothing: bodies have any number of contacts",
    "rigid_avbd_beta": "nothing: the iteration takes its stiffness from the masses",
    "rigid_contact_k_start": "nothing: the iteration takes its stiffness from the masses",
    "rigid_enable_dahl_friction": "joint_friction and joint_damping of the joint",
    "particle_vertex_contact_buffer_size": "nothing: particles have any number of contacts",
    "particle_edge_contact_buffer_size": "nothing: edges have any number of contacts",
    "particle_collision_detection_interval": "nothing: a step searches when particles have moved",
    "particle_conservative_bound_relaxation": "nothing: a step uses 0.85 of the way to a bound",
    "particle_edge_parallel_epsilon": "nothing: contacts of parallel edges fade out",
    "particle_enable_tile_solve": "nothing: a device chooses its blocks of threads",
    "particle_topological_contact_filter_threshold": (
        "nothing: only features with a common particle have no contact"
    ),
    "particle_rest_shape_contact_exclusion_radius": (
        "nothing: pairs that are near at rest get 0.9 of that distance as their radius"
    ),
    "particle_external_vertex_contact_filtering_map": (
        "nothing: only features with a common particle have no contact"
    ),
    "particle_external_edge_contact_filtering_map": (
        "nothing: only features with a common particle have no contact"
    ),
    "max_contacts_per_pair": "nothing: bodies have any number of contacts",
}
