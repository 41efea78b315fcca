"""Messages for names that do not exist: what to use instead, or that a feature is not supported.

The names are those of Newton 1.8 and of upstream NovaPhy, which users may know. A name is removed
from the tables when its feature is added. A test compares the tables with the lists of both
projects.
"""

from __future__ import annotations

from itertools import chain

# Owner (module or class) -> planned feature -> names of the feature in other projects.
PLANNED: dict[str, dict[str, tuple[str, ...]]] = {
    "novaphy": {
        "streams": ("Stream", "ScopedStream", "get_stream"),
        "surface meshes as objects": ("geometry",),
        "helpers for poses and colors": ("utils",),
    },
    "novaphy.solvers": {
        "rigid bodies, which SolverFeatherstone moves": ("SolverXPBD", "SolverSequentialImpulse"),
        "articulations, which SolverFeatherstone moves": ("SolverMuJoCo",),
    },
    "ModelBuilder": {
        "robots from USD files": ("add_usd",),
    },
}

# Owner -> what to use instead -> names of other projects, with * for any letters.
INSTEAD: dict[str, dict[str, str]] = {
    "novaphy": {
        "novaphy.io.Mesh": "Mesh",
        "novaphy.io.TetMesh": "TetMesh",
        "novaphy.io.height_field, which makes a mesh": "Heightfield",
        "Axis": "AxisType",
        "ModelFlags": "SolverNotifyFlags",
        "the state itself: a step writes all of it": "StateFlags",
        "numpy.inf": "MAXVAL",
        "RuntimeWarning and DeprecationWarning": "NewtonWarning NewtonDeprecationWarning",
        "the functions of novaphy.nova": "math",
        "eval_inverse_dynamics and eval_bias": "eval_inverse_dynamics_*",
        "Contacts.rigid_contacts(model, state)": "eval_rigid_contact_kinematics",
        "eval_fk": "forward_kinematics",
        "eval_inverse_dynamics": "inverse_dynamics",
        "eval_mass_matrix": "mass_matrix_crba",
        "eval_forward_dynamics": "forward_dynamics",
        "eval_jacobian": "compute_jacobian_*",
        "State.body_q after eval_fk": "get_ee_position get_ee_rotation",
        "ModelBuilder, whose add_ functions make them": "Joint RigidBody CollisionShape",
        "a sequence of seven numbers: position, then quaternion (x, y, z, w)": "Transform",
        "eval_jacobian and arrays of spatial vectors": "SpatialTransform",
        "ModelBuilder.add_urdf": "UrdfParser UrdfImportOptions SceneBuild*",
        "ViewerFile or novaphy.io.save_npz": "SimulationExporter",
        "novaphy.backends()": "backend_info",
        "the command `novaphy bench`": "PerformanceMonitor",
        "the arguments of novaphy.solvers.SolverVBD": "VBDConfig VbdBackend",
        "particle_q and particle_qd of a State": "ParticleState",
    },
    "novaphy.solvers": {
        "the arguments of SolverVBD": "VBDConfig VbdBackend",
    },
    "ModelBuilder": {
        "joint_target_q": "joint_target_pos",
        "joint_target_qd": "joint_target_vel",
        "joint_parent and joint_child of the model that finalize() makes": (
            "joint_parents joint_children"
        ),
        "add_constraint_mimic; joint_mimic and joint_mimic_coef of the model hold them": (
            "set_joint_mimic joint_mimic_* constraint_mimic_*"
        ),
        "the argument lock_inertia of add_body": "body_lock_inertia",
        "the argument collision_filter_parent of the joint": "joint_collision_filter_parent",
        "bound_mass, bound_inertia and balance_inertia; finalize() checks all": (
            "inertia_absolute_tolerance inertia_relative_tolerance inertia_correction "
            "validate_inertia_detailed"
        ),
        "finalize(), which checks the order of joints": "validate_joint_ordering",
        "Model.set_gravity(value, world)": "world_gravity",
        "rigid_contact_max of CollisionPipeline": "num_rigid_contacts_per_world",
        "add_shape_mesh with novaphy.io.height_field": "add_shape_heightfield",
        "add_shape_convex_hull, or mesh_maxhullvert of add_urdf": (
            "approximate_meshes MeshApproximationConfig default_mesh_approximation_cfg"
        ),
    },
    "Model": {
        "joint_target_q": "joint_target_pos",
        "joint_target_qd": "joint_target_vel",
        "joint_q_start: joint_target_q runs over coordinates": "joint_target_q_start",
        "joint_mimic and joint_mimic_coef": "joint_mimic_* constraint_mimic_*",
        "rigid_contact_max and soft_contact_max of a CollisionPipeline or its Contacts": (
            "contact_max rigid_contact_max soft_contact_max"
        ),
        "shape_source": "shape_source_ptr shape_edge_range mesh_edge_*",
        "shape_collision_filter_pairs": "shape_collision_filter_* shape_filter",
        "body_count": "num_bodies",
        "the arrays body_*": "bodies",
        "the arrays shape_*": "shapes",
        "gravity, a row for every world": "gravity_for_world",
        "the indices of triangles and tetrahedra": "soft_mesh_adjacency*",
        "a mesh of novaphy.io.height_field": "heightfield_* shape_heightfield_index",
    },
    "Control": {
        "joint_target_q": "joint_target_pos",
        "joint_target_qd": "joint_target_vel",
    },
    "State": {
        "eval_forward_dynamics, or differences of body_qd": "body_qdd",
        "rigid_contact_force of the Contacts, or eval_inverse_dynamics": "body_parent_f",
    },
    "Contacts": {
        "match(previous)": (
            "contact_matching contact_matching_mode contact_report rigid_contact_match_* "
            "rigid_contact_new_* rigid_contact_broken_*"
        ),
        "rigid_contact_force": "force",
        "rigid_contacts(model, state), whose columns are body0, body1, position, penetration": (
            "rigid_contact_body0 rigid_contact_body1 rigid_contact_position "
            "rigid_contact_penetration rigid_contact_diff_*"
        ),
        "rigid_contact_count and soft_contact_count": "contact_counters",
        "active_rigid_contact_count": "rigid_count",
        "active_soft_contact_count": "soft_count",
        "len(contacts) == 0": "empty",
        "shape_material_restitution of the model": "rigid_contact_restitution",
        "soft_contact_particle": "soft_contact_indices soft_contact_barycentric",
        "soft_contact_shape": "soft_contact_rigid_indices",
        "soft_contact_tids for particles; rows of shapes need none": "rigid_contact_tids",
        "clear(), which writes all arrays": "clear_buffers",
    },
    "CollisionPipeline": {
        "Contacts.match(previous)": "contact_matching contact_report reset_contact_matching",
        "broad_phase": "broad_phase_mode",
        "soft_contact_margin": "soft_contact_gap",
        "model, which has it": "device requires_grad shape_count geom_data geom_transform",
        "shape_pairs_filtered": (
            "broad_phase_shape_pairs broad_phase_pair_count shape_pairs_excluded*"
        ),
        "Contacts.overflowed and Contacts.rigid_contact_count": (
            "last_candidate_pair_count last_rigid_contact_overflow_count"
        ),
        "the rows as they are: meshes are always reduced": "reduce_contacts",
        "the rows as they are: their order never depends on threads": "deterministic",
        "rigid_contact_max: the memory for pairs needs no bound": "shape_pairs_max",
        "soft_contact_pair_count": "soft_rigid_contact_pair*",
        "shape_gap of the model": "speculative_contact_gap_max set_collision_detection_range",
    },
    "ShapeConfig": {
        "finalize(), which checks all": "validate",
    },
    "JointDofConfig": {
        "target_q": "target_pos",
        "target_qd": "target_vel",
    },
    # Names for all solvers. The entry of a single solver is searched before this entry.
    "SolverBase": {
        "the keyword arguments of the solver, and its properties": "settings Config",
        "novaphy.backends()": "backend_info",
        "docs/coverage.md; a solver raises NotImplementedError for a joint that it does not take": (
            "joint_support"
        ),
        "CollisionPipeline.collide(state, contacts) before step, or pipeline= of rollout": (
            "collision_pipeline collision_frequency* set_collision_frequency CollisionSlot "
            "CollisionFrequencyType supports_collision_pipeline contacts"
        ),
        "step": "integrate_bodies integrate_particles",
        "rigid_contact_force of the Contacts, which step writes": "update_contacts",
        "the State that step writes, the Contacts, and the eval_ functions": (
            "observables supported_observables validate_observables ObservableKind Observables "
            "SUPPORTED_OBSERVABLES"
        ),
        "body_inv_mass of the model": "body_inv_mass_effective",
        "body_inv_inertia of the model": "body_inv_inertia_effective",
        "a new solver: only contacts of the step before are kept in it": "reset",
        "DiffFeatherstoneSolver, DiffSemiImplicitSolver or DiffSolverVBD": "gradient_info",
    },
    "SolverFeatherstone": {
        "eval_mass_matrix": "H M L H_mimic articulation_H_rows articulation_M_rows",
        "eval_jacobian": "J P articulation_J_cols articulation_J_rows",
        "body_inertia of the model": "body_I_m",
        "body_com of the model": "body_X_com",
        "joint_armature of the model": "joint_armature_effective joint_armature_zero",
        "body_flags of the model": "has_kinematic_bodies has_kinematic_joints",
        "articulation_start and articulation_end of the model": (
            "articulation_coord_start articulation_dof_start"
        ),
        "nothing: every step factors the mass matrix": "update_mass_matrix_interval",
        "nothing: there is one way to factor the mass matrix": "use_tile_gemm fuse_cholesky",
        "nothing: every step writes the poses below free joints": "descendant_free_distance_*",
    },
    "SolverSemiImplicit": {
        "SolverFeatherstone, whose mimic joints follow exactly": "joint_mimic_ke joint_mimic_kd",
    },
}

# Owner -> feature that is not supported -> names, with * for any letters.
NOT_BUILT_IN: dict[str, dict[str, str]] = {
    "SolverVBD": {
        "contacts of particles with each other": (
            "particle_self_contact_* particle_topological_* "
            "particle_rest_shape_* particle_conservative_bounds particle_collision_detection_* "
            "dat_* rebuild_bvh trimesh_* truncation_ts pos_prev_collision_detection"
        ),
        "the rows of bodies and joints as arrays, and their coupling to other solvers": (
            "rigid_* body_* joint_* JointSlot coupling_* collect_rigid_contact_forces "
            "integrate_with_external_rigid_solver enable_dahl_friction set_joint_constraint_mode "
            "set_rigid_history_update"
        ),
        "the memory of its sweeps as arrays": (
            "inertia particle_adjacency particle_displacements particle_forces "
            "particle_hessians particle_q_prev particle_q_rest use_particle_tile_solve"
        ),
    },
}

# Feature that is not supported -> its names, for every owner.
NOT_BUILT: dict[str, str] = {
    "tendons": "tendon_* add_tendon Tendon*",
    "muscles": "muscle_* add_muscle",
    "rods as objects, and limits of twist": "Rod joint_twist_* curve_*",
    "springs of joints towards a rest angle (a drive with joint_target_ke does that)": (
        "joint_stiffness joint_rest_q stiffness rest_q"
    ),
    "constraint rows of joints as data": "joint_cts* joint_constraint_*",
    "attachments of particles to bodies": "attachment_particle_body_* add_attachment_*",
    "variants of bodies": "add_body_variants body_variant* select_body_variants",
    "names of surfaces and volumes": "surface_* volume_*",
    "meshes that are only drawn": "add_deformable_visual_mesh deformable_visual_*",
    "Gaussian splats": "Gaussian add_shape_gaussian gaussians_*",
    "sites as objects (add_site makes shapes)": "Site default_site_cfg mark_as_site",
    "ray casts": "intersect_ray BvhConfig default_bvh_cfg bvh_*",
    "signed distance fields": (
        "SDF *sdf* *hydroelastic* shape_material_kh kh include_static_kinematic_pairs"
    ),
    "custom attributes": (
        "*custom_* CustomAttribute CustomFrequency add_attribute attribute_* Attribute* "
        "get_attribute_* get_custom_* has_custom_* mujoco"
    ),
    "arrays on request": (
        "request_*_attributes get_requested_* EXTENDED_ATTRIBUTE* ExtendedAttribute* "
        "validate_extended_attributes"
    ),
    "actuators as objects (add_actuator makes rows of Control.ctrl)": (
        "actuators ActuatorEntry actuator_entries"
    ),
    "the first row of every world (body_world, joint_world, ... name the world of a row)": (
        "*_world_start articulation_world"
    ),
    "colors of bodies as arrays (SolverVBD finds them)": "body_color_groups body_colors",
    "XPBD": "*_constraint_lambdas",
    "contacts between particles": (
        "particle_grid particle_ke particle_kd particle_kf particle_mu particle_cohesion "
        "soft_self_contact_* init_soft_self_contact refit_soft_self_contact_bvh"
    ),
    "contacts of edges and faces of soft bodies": (
        "soft_edge_rigid_pairs soft_face_rigid_pairs enable_rigid_soft_full_surface_contact"
    ),
    "reduced contacts of pairs of bodies": "*ody_pair_reduc* BodyPairReduction*",
    "surfaces that move": "rigid_contact_surface_velocity",
    "opacity and colors of triangles": "shape_opacity tri_opacity tri_color",
    "pictures of the tree of joints": "plot_articulation",
    "inverse kinematics by optimization": "ik solve_ik*",
    "sensors": "sensors Sensor*",
    "views of articulations by name": "selection",
    "USD": "usd OpenUsdImporter UsdStageData",
    "controllers, configuration and schedulers": (
        "actuators controllers config CollisionSubstepScheduler"
    ),
    "fluids": "SolverPBF SolverSPH PBFConfig FluidBlockDef",
    "incremental potential contact": "SolverIPC IPCConfig has_ipc",
    "material points": "SolverImplicitMPM",
    "this solver": "SolverKamino SolverSteel SolverStyle3D experimental style3d",
}


class PlannedError(NotImplementedError, AttributeError):
    """Raised for a member that is not supported. Also an AttributeError, so that hasattr returns
    False.
    """


def missing_from_module(module: str, name: str) -> Exception:
    """Return the exception that a module raises for a missing name.

    A name in the tables gives a NotImplementedError. ``from module import name`` shows its message,
    whereas it replaces the message of an AttributeError by "cannot import name".
    """
    explanation = _sentence(module, name)
    if explanation:
        return NotImplementedError(explanation)
    return AttributeError(f"module {module!r} has no attribute {name!r}", name=name)


def explain_members(cls: type, owner: str = "", base: str = "") -> None:
    """Let a class explain missing members: what to use instead, or that they are not supported.

    Args:
        cls: the class; the function sets its __getattr__ and __setattr__.
        owner: the name of the class in the tables; "": the name of the object's class.
        base: the name of a common base class in the tables.
    """

    def get(self: object, name: str) -> object:
        label = owner or type(self).__name__
        explanation = _sentence(label, name, base)
        if explanation:
            raise PlannedError(explanation)
        raise AttributeError(f"{label!r} object has no attribute {name!r}", name=name, obj=self)

    def assign(self: object, name: str, value: object) -> None:
        try:
            object.__setattr__(self, name, value)
        except AttributeError:
            if hasattr(type(self), name):
                raise  # a read-only property
            get(self, name)

    cls.__getattr__ = get  # type: ignore[attr-defined]
    cls.__setattr__ = assign  # type: ignore[assignment]


def _sentence(owner: str, name: str, base: str = "") -> str | None:
    """Return the message about a missing name that the tables have; None for any other name."""
    if name.startswith("_"):
        return None
    for part, planned in PLANNED.get(owner, {}).items():
        if name in planned:
            return f"{owner}.{name} is not supported yet; planned: {part}"
    for other, names in chain(*(INSTEAD.get(of, {}).items() for of in (owner, base))):
        if _is_one_of(name, names):
            return f"{owner} has no {name}: use {other}"
    if owner == "ModelBuilder" and _is_in_model(name):
        return (
            f"ModelBuilder has no {name}: give it to the add_ function, or use {name} of the model "
            "that finalize() makes, whose values may be edited"
        )
    if owner == "novaphy" and _is_in_solvers(name):
        return f"novaphy has no {name}: use novaphy.solvers.{name}"
    for part, names in chain(NOT_BUILT_IN.get(owner, {}).items(), NOT_BUILT.items()):
        if _is_one_of(name, names):
            return f"{owner}.{name} is not supported: {part}"
    return None


def _is_one_of(name: str, patterns: str) -> bool:
    from fnmatch import fnmatchcase

    return any(fnmatchcase(name, pattern) for pattern in patterns.split())


def _is_in_model(name: str) -> bool:
    from ._core import Model

    return hasattr(Model, name)


def _is_in_solvers(name: str) -> bool:
    from ._core import solvers

    return name.startswith(("Solver", "Diff")) and hasattr(solvers, name)
