"""Types of novaphy.solvers."""

from collections.abc import Iterator, Sequence
from typing import Any, Literal, SupportsFloat, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from . import (
    CollisionPipeline,
    Contacts,
    Control,
    Device,
    DeviceArray,
    Model,
    ModelFlags,
    SimState,
    _Native,
)
from .diff import Trajectory
from .nova import Tensor

class SolverBase(_Native):
    @property
    def model(self) -> Model: ...
    @property
    def device(self) -> Device: ...
    @property
    def supports_graph_capture(self) -> bool: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
    ) -> None: ...
    def rollout(
        self,
        trajectory: Trajectory,
        control: Control | Sequence[Control | None] | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
        *,
        forces: Tensor | DeviceArray | None = None,
        body_forces: Tensor | DeviceArray | None = None,
        targets: Tensor | DeviceArray | None = None,
        pipeline: CollisionPipeline | None = None,
        start: SupportsIndex = 0,
        stop: SupportsIndex | None = None,
        joint_f: Tensor | DeviceArray | None = None,
        joint_target_q: Tensor | DeviceArray | None = None,
        joint_target_qd: Tensor | DeviceArray | None = None,
        ctrl: Tensor | DeviceArray | None = None,
    ) -> None: ...
    def notify_model_changed(self, flags: ModelFlags | int) -> None: ...

class SolverSemiImplicit(SolverBase):
    def __init__(
        self,
        model: Model,
        *,
        angular_damping: SupportsFloat = 0.05,
        friction_law: Literal["viscous", "huber", "newton17", "newton18"] = "viscous",
        friction_smoothing: SupportsFloat | None = None,
        stick_ke: SupportsFloat = 0.0,
        joint_attach_ke: SupportsFloat = 1.0e4,
        joint_attach_kd: SupportsFloat = 1.0e2,
        enable_tri_contact: bool = True,
        particle_kf_bound: SupportsFloat = 1.0,
    ) -> None: ...
    @property
    def angular_damping(self) -> float: ...
    @property
    def friction_law(self) -> str: ...
    @property
    def friction_smoothing(self) -> float: ...
    @property
    def stick_ke(self) -> float: ...
    @property
    def joint_attach_ke(self) -> float: ...
    @property
    def joint_attach_kd(self) -> float: ...
    @property
    def enable_tri_contact(self) -> bool: ...
    @property
    def particle_kf_bound(self) -> float: ...
    def stable_dt(self, state: SimState, contacts: Contacts | None = None) -> float: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
    ) -> None: ...

class VbdResidual(_Native):
    @property
    def force(self) -> float: ...
    @property
    def scale(self) -> float: ...
    @property
    def relative(self) -> float: ...
    @property
    def floor(self) -> float: ...
    @property
    def iterations(self) -> int: ...

class SolverVBD(SolverBase):
    def __init__(
        self,
        model: Model,
        *,
        iterations: SupportsIndex = 10,
        friction_epsilon: SupportsFloat = 1.0e-2,
        initial_guess: Literal["inertia", "previous", "adaptive"] = "inertia",
        acceleration: SupportsFloat | None = None,
        tolerance: SupportsFloat | None = None,
        safeguard: bool = False,
        lhs_regularization: SupportsFloat = 1.0e-6,
    ) -> None: ...
    @property
    def iterations(self) -> int: ...
    @property
    def friction_epsilon(self) -> float: ...
    @property
    def initial_guess(self) -> str: ...
    @property
    def acceleration(self) -> float | None: ...
    @property
    def tolerance(self) -> float | None: ...
    @property
    def safeguard(self) -> bool: ...
    @property
    def lhs_regularization(self) -> float: ...
    @property
    def kinematic_count(self) -> int: ...
    @property
    def held_count(self) -> int: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
        *,
        targets: DeviceArray | Sequence[Sequence[SupportsFloat]] | NDArray[Any] | None = None,
    ) -> None: ...
    def residual(self) -> VbdResidual: ...
    def reset(self) -> None: ...

class GradientInfo(_Native):
    @property
    def label(self) -> str: ...
    @property
    def reason(self) -> str: ...
    @property
    def steps(self) -> int: ...
    @property
    def exact_steps(self) -> int: ...
    @property
    def frozen_steps(self) -> int: ...
    @property
    def surrogate_steps(self) -> int: ...
    @property
    def events(self) -> int: ...
    @property
    def began(self) -> int: ...
    @property
    def ended(self) -> int: ...
    @property
    def turned(self) -> int: ...
    @property
    def several(self) -> int: ...
    @property
    def one_sided(self) -> int: ...
    @property
    def ramp_steps(self) -> int: ...
    @property
    def landings(self) -> int: ...
    @property
    def phased(self) -> int: ...
    @property
    def lost_events(self) -> int: ...
    @property
    def least_approach(self) -> float: ...
    @property
    def least_separation(self) -> float: ...
    @property
    def event_list(self) -> list[dict[str, Any]]: ...
    @property
    def residual(self) -> float: ...
    def __getattr__(self, name: str) -> Any: ...
    def __getitem__(self, name: str) -> Any: ...
    def __contains__(self, name: str) -> bool: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[str]: ...
    def keys(self) -> Any: ...
    def items(self) -> Any: ...

class DiffSolverVBD(SolverBase):
    def __init__(
        self,
        model: Model,
        *,
        iterations: SupportsIndex = 10,
        friction_epsilon: SupportsFloat = 1.0e-2,
        initial_guess: Literal["inertia", "previous"] = "inertia",
        lhs_regularization: SupportsFloat = 1.0e-6,
        gradient: Literal["unrolled", "implicit"] = "unrolled",
        gradient_tolerance: SupportsFloat | None = None,
        gradient_sweeps: SupportsIndex | None = None,
        newton_iterations: SupportsIndex | None = None,
        allow_unconverged: bool | None = None,
    ) -> None: ...
    @property
    def iterations(self) -> int: ...
    @property
    def gradient(self) -> str: ...
    @property
    def kinematic_count(self) -> int: ...
    @property
    def held_count(self) -> int: ...
    def gradient_info(self) -> GradientInfo: ...
    def clear_gradient_info(self) -> None: ...
    def reset(self) -> None: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
        *,
        targets: Tensor
        | DeviceArray
        | Sequence[Sequence[SupportsFloat]]
        | NDArray[Any]
        | None = None,
    ) -> None: ...

class DiffSolverConfig(_Native):
    def __init__(
        self,
        *,
        enable_particles: bool = True,
        enable_particle_contacts: bool = True,
        enable_tetrahedra: bool = False,
        enable_triangles: bool = False,
        enable_springs: bool = False,
        enable_bending: bool = False,
        enable_static_contacts: bool = False,
        static_contact_margin: SupportsFloat = 0.0,
        enable_rigid: bool = True,
        enable_rigid_contacts: bool = True,
        angular_damping: SupportsFloat = 0.05,
        friction_law: Literal["viscous", "huber", "newton17", "newton18"] = "viscous",
        friction_smoothing: SupportsFloat | None = None,
        enable_joints: bool = True,
        joint_attach_ke: SupportsFloat = 1e4,
        joint_attach_kd: SupportsFloat = 1e2,
        strict: bool = True,
        particle_kf_bound: SupportsFloat = 1.0,
        contact_gradient: Literal["code", "motion"] = "code",
    ) -> None: ...
    enable_particles: bool
    enable_particle_contacts: bool
    enable_tetrahedra: bool
    enable_triangles: bool
    enable_springs: bool
    enable_bending: bool
    enable_static_contacts: bool
    static_contact_margin: float
    particle_kf_bound: float
    enable_rigid: bool
    enable_rigid_contacts: bool
    angular_damping: float
    friction_law: Literal["viscous", "huber", "newton17", "newton18"]
    friction_smoothing: float | None
    enable_joints: bool
    joint_attach_ke: float
    joint_attach_kd: float
    strict: bool
    contact_gradient: Literal["code", "motion"]

class DiffSemiImplicitSolver(SolverBase):
    def __init__(self, model: Model, config: DiffSolverConfig | None = None) -> None: ...
    @property
    def config(self) -> DiffSolverConfig: ...
    def stable_dt(self, state: SimState, contacts: Contacts | None = None) -> float: ...
    def gradient_info(self) -> GradientInfo: ...
    def clear_gradient_info(self) -> None: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
    ) -> None: ...

class FeatherstoneAnalyticControlSensitivity(_Native):
    def __init__(
        self,
        model: Model,
        articulation: SupportsIndex = 0,
        *,
        parameter_count: SupportsIndex,
        point_body: SupportsIndex,
        point_local: Sequence[SupportsFloat] | NDArray[Any] = (0.0, 0.0, 0.0),
        kind: Literal["position", "torque"] = "position",
        exact: bool | None = None,
        contact_projection: bool = False,
        solver: SolverFeatherstone | None = None,
    ) -> None: ...
    def reset(self, state: SimState) -> None: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        dt: SupportsFloat,
        dcontrol: Sequence[Sequence[SupportsFloat]] | NDArray[Any],
        dtarget_qd: Sequence[Sequence[SupportsFloat]] | NDArray[Any] | None = None,
        contacts: Contacts | None = None,
    ) -> None: ...
    @property
    def dq(self) -> NDArray[np.float32]: ...
    @property
    def dqd(self) -> NDArray[np.float32]: ...
    @property
    def point_jacobian(self) -> NDArray[np.float32]: ...
    @property
    def point_velocity_jacobian(self) -> NDArray[np.float32]: ...
    def point(self) -> tuple[float, float, float]: ...
    def point_velocity(self) -> tuple[float, float, float]: ...
    @property
    def label(self) -> str: ...
    @property
    def parameter_count(self) -> int: ...
    @property
    def dof_count(self) -> int: ...

class SolverFeatherstone(SolverBase):
    def __init__(
        self,
        model: Model,
        *,
        angular_damping: SupportsFloat = 0.0,
        implicit_drives: bool = True,
        contact: Literal["pgs", "penalty"] | None = "pgs",
        friction_cone: Literal["cone", "pyramid"] = "cone",
        pgs_iterations: int = 30,
        pgs_tolerance: SupportsFloat = 1e-6,
        pgs_erp: SupportsFloat = 0.2,
        pgs_slop: SupportsFloat = 0.005,
        pgs_cfm: SupportsFloat = 0.0,
        max_depenetration_velocity: SupportsFloat = 10.0,
        restitution_threshold: SupportsFloat = 0.2,
        warm_start: bool = True,
        compliant_contacts: bool = False,
        friction_smoothing: SupportsFloat = 0.1,
    ) -> None: ...
    @property
    def angular_damping(self) -> float: ...
    @property
    def friction_smoothing(self) -> float: ...
    @property
    def implicit_drives(self) -> bool: ...
    @property
    def contact(self) -> Literal["pgs", "penalty"] | None: ...
    @property
    def friction_cone(self) -> Literal["cone", "pyramid"]: ...
    def check_last_step(self) -> None: ...
    @property
    def pgs_sweeps(self) -> int: ...
    @property
    def pgs_residual(self) -> float: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
    ) -> None: ...

class DiffFeatherstoneSolver(SolverBase):
    def __init__(
        self,
        model: Model,
        *,
        angular_damping: SupportsFloat = 0.0,
        implicit_drives: bool = True,
        contact: Literal["pgs"] | None = "pgs",
        friction_cone: Literal["cone", "pyramid"] = "cone",
        pgs_iterations: int = 1000,
        pgs_tolerance: SupportsFloat = 1e-6,
        pgs_erp: SupportsFloat = 0.2,
        pgs_slop: SupportsFloat = 0.005,
        pgs_cfm: SupportsFloat = 0.0,
        max_depenetration_velocity: SupportsFloat = 10.0,
        restitution_threshold: SupportsFloat = 0.2,
        compliant_contacts: bool = False,
        allow_unconverged: bool = False,
        contact_gradient: str = "code",
    ) -> None: ...
    def gradient_info(self) -> GradientInfo: ...
    def clear_gradient_info(self) -> None: ...
    @property
    def angular_damping(self) -> float: ...
    @property
    def implicit_drives(self) -> bool: ...
    def step(
        self,
        state_in: SimState,
        state_out: SimState,
        control: Control | None,
        contacts: Contacts | None,
        dt: SupportsFloat,
    ) -> None: ...
