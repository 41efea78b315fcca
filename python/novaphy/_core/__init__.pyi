"""Types of the native module. The documentation is in its docstrings: help(novaphy.Model)."""

import enum
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, Never, SupportsFloat, SupportsIndex, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from .._select import Selection as _Selection
from ..io import Mesh as _Mesh
from . import diff as diff
from . import io as io
from . import nova as nova
from . import solvers as solvers

# Three numbers, four numbers, ...: a tuple, list or array.
_Vector: TypeAlias = Sequence[SupportsFloat] | NDArray[Any]
# (px, py, pz, qx, qy, qz, qw), or a pair (position, quaternion).
_Transform: TypeAlias = _Vector | tuple[_Vector, _Vector]
# _Values for an array: float64 values are rounded to float32.
_Values: TypeAlias = DeviceArray | nova.Tensor | NDArray[Any] | Sequence[Any] | SupportsFloat
_DeviceLike: TypeAlias = Device | str | None
_DTypeLike: TypeAlias = dtype | str | type[np.generic] | np.dtype[Any]
_Shape: TypeAlias = int | Sequence[int]
_Index: TypeAlias = SupportsIndex | slice

# The native classes have a metaclass of their own. Those without a constructor here are made by
# the engine only.
class _Type(type): ...

class _Native(metaclass=_Type):
    def __init__(self, *args: Never, **kwargs: Never) -> None: ...

class Error(RuntimeError): ...

def version() -> str: ...
def build_info() -> dict[str, bool]: ...
def has_cuda() -> bool: ...
def has_diff() -> bool: ...
def has_io() -> bool: ...
def has_vbd() -> bool: ...
def has_nvrtc() -> bool: ...
def num_threads() -> int: ...
def set_num_threads(count: SupportsIndex) -> None: ...

# ------------------------------------------------------------------------------------ devices

class DeviceType(enum.IntEnum):
    CPU = 0
    CUDA = 1
    DLAN = 2

class Device(_Native):
    def __init__(self, spec: _DeviceLike = None) -> None: ...
    @property
    def type(self) -> DeviceType: ...
    @property
    def ordinal(self) -> int: ...
    @property
    def name(self) -> str: ...
    @property
    def arch(self) -> int: ...
    @property
    def total_memory(self) -> int: ...
    @property
    def free_memory(self) -> int: ...
    @property
    def is_cpu(self) -> bool: ...
    @property
    def is_cuda(self) -> bool: ...
    @property
    def supports_graph_capture(self) -> bool: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...

def get_device(spec: _DeviceLike = None) -> Device: ...
def get_devices() -> list[Device]: ...
def get_default_device() -> Device: ...
def set_default_device(spec: _DeviceLike) -> None: ...
def is_device_available(spec: _DeviceLike) -> bool: ...
def synchronize(device: _DeviceLike = None) -> None: ...

class Event(_Native):
    def __init__(self, device: _DeviceLike = None) -> None: ...
    @property
    def device(self) -> Device: ...
    def record(self) -> None: ...
    def synchronize(self) -> None: ...
    @staticmethod
    def elapsed(start: Event, stop: Event) -> float: ...

class ScopedDevice(_Native):
    def __init__(self, spec: _DeviceLike) -> None: ...
    def __enter__(self) -> Device: ...
    def __exit__(self, *args: object) -> None: ...

class BackendInfo(_Native):
    @property
    def name(self) -> str: ...
    @property
    def version(self) -> str: ...
    @property
    def abi_version(self) -> tuple[int, int]: ...
    @property
    def path(self) -> str: ...
    @property
    def loaded(self) -> bool: ...
    @property
    def active(self) -> bool: ...
    @property
    def device_count(self) -> int: ...
    @property
    def error(self) -> str: ...

def backends() -> list[BackendInfo]: ...
def load_backend(path: str | os.PathLike[str]) -> BackendInfo: ...

# ------------------------------------------------------------------------------------ arrays

class dtype(_Native):
    @property
    def name(self) -> str: ...
    @property
    def scalar(self) -> dtype: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def itemsize(self) -> int: ...
    @property
    def numpy(self) -> np.dtype[Any]: ...

_DType: TypeAlias = dtype
float32: Final[dtype]
int32: Final[dtype]
uint32: Final[dtype]
uint8: Final[dtype]
uint64: Final[dtype]
vec2: Final[dtype]
vec3: Final[dtype]
vec4: Final[dtype]
quat: Final[dtype]
transform: Final[dtype]
spatial_vector: Final[dtype]
mat22: Final[dtype]
mat33: Final[dtype]
vec2i: Final[dtype]
vec3i: Final[dtype]
vec4i: Final[dtype]

class DeviceArray(_Native):
    def __init__(
        self, data: _Values, dtype: _DTypeLike | None = None, device: _DeviceLike = None
    ) -> None: ...
    @staticmethod
    def zeros(
        shape: _Shape, dtype: _DTypeLike = ..., device: _DeviceLike = None
    ) -> DeviceArray: ...
    @staticmethod
    def empty(
        shape: _Shape, dtype: _DTypeLike = ..., device: _DeviceLike = None
    ) -> DeviceArray: ...
    @staticmethod
    def full(
        shape: _Shape, value: _Values, dtype: _DTypeLike = ..., device: _DeviceLike = None
    ) -> DeviceArray: ...
    @staticmethod
    def from_dlpack(
        obj: Any, dtype: _DTypeLike | None = None, copy: bool = False
    ) -> DeviceArray: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def dtype(self) -> _DType: ...
    @property
    def scalar_dtype(self) -> _DType: ...
    @property
    def ndim(self) -> int: ...
    @property
    def size(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def strides(self) -> tuple[int, ...]: ...
    @property
    def device(self) -> Device: ...
    @property
    def ptr(self) -> int: ...
    @property
    def is_contiguous(self) -> bool: ...
    @property
    def version(self) -> int: ...
    requires_grad: bool
    @property
    def grad(self) -> DeviceArray | None: ...
    def numpy(self, copy: bool = True, writable: bool = False) -> NDArray[Any]: ...
    def assign(self, source: _Values) -> None: ...
    def copy_from(self, other: _Values) -> None: ...
    def fill_(self, value: _Values) -> DeviceArray: ...
    def zero_(self) -> DeviceArray: ...
    def clone(self, device: _DeviceLike = None) -> DeviceArray: ...
    def to(self, device: _DeviceLike) -> DeviceArray: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: _Index) -> Any: ...
    def __setitem__(self, index: _Index, values: _Values) -> None: ...
    def __iter__(self) -> Iterator[Any]: ...
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]: ...
    @property
    def __array_interface__(self) -> dict[str, Any]: ...
    @property
    def __cuda_array_interface__(self) -> dict[str, Any]: ...
    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any: ...
    def __dlpack_device__(self) -> tuple[int, int]: ...

# An array of a model, state, ...: reading gives the array itself, assigning copies values into it.
class _Field:
    def __get__(self, instance: object, owner: type | None = None) -> DeviceArray: ...
    def __set__(self, instance: object, value: _Values) -> None: ...

# ------------------------------------------------------------------------------------ model

class Axis(enum.IntEnum):
    X = 0
    Y = 1
    Z = 2

class GeoType(enum.IntEnum):
    NONE = 0
    PLANE = 1
    HFIELD = 2
    SPHERE = 3
    CAPSULE = 4
    ELLIPSOID = 5
    CYLINDER = 6
    BOX = 7
    MESH = 8
    CONE = 9
    CONVEX_MESH = 10

class JointType(enum.IntEnum):
    PRISMATIC = 0
    REVOLUTE = 1
    BALL = 2
    FIXED = 3
    FREE = 4
    DISTANCE = 5
    D6 = 6

class JointTargetMode(enum.IntEnum):
    NONE = 0
    POSITION = 1
    VELOCITY = 2
    POSITION_VELOCITY = 3
    EFFORT = 4

class ActuatorDynamics(enum.IntEnum):
    NONE = 0
    INTEGRATOR = 1
    FILTER = 2
    FILTER_EXACT = 3

class ParticleFlags(enum.IntFlag):
    ACTIVE = 1

class BodyFlags(enum.IntFlag):
    DYNAMIC = 1
    KINEMATIC = 2

class ShapeFlags(enum.IntFlag):
    VISIBLE = 1
    COLLIDE_SHAPES = 2
    COLLIDE_PARTICLES = 4
    SITE = 8

class ModelFlags(enum.IntFlag):
    JOINT_PROPERTIES = 1
    JOINT_DOF_PROPERTIES = 2
    BODY_PROPERTIES = 4
    BODY_INERTIAL_PROPERTIES = 8
    SHAPE_PROPERTIES = 16
    MODEL_PROPERTIES = 32
    ALL = 63

class _Counts(_Native):
    @property
    def particle_count(self) -> int: ...
    @property
    def body_count(self) -> int: ...
    @property
    def shape_count(self) -> int: ...
    @property
    def joint_count(self) -> int: ...
    @property
    def joint_dof_count(self) -> int: ...
    @property
    def joint_coord_count(self) -> int: ...
    @property
    def articulation_count(self) -> int: ...
    @property
    def actuator_count(self) -> int: ...
    @property
    def actuator_state_count(self) -> int: ...
    @property
    def spring_count(self) -> int: ...
    @property
    def tri_count(self) -> int: ...
    @property
    def edge_count(self) -> int: ...
    @property
    def tet_count(self) -> int: ...
    @property
    def world_count(self) -> int: ...
    @property
    def mesh_vertex_count(self) -> int: ...
    @property
    def mesh_triangle_count(self) -> int: ...
    @property
    def device(self) -> Device: ...
    requires_grad: bool

class Model(_Counts):
    @property
    def shape_contact_pair_count(self) -> int: ...
    particle_q: _Field
    particle_qd: _Field
    particle_mass: _Field
    particle_inv_mass: _Field
    particle_radius: _Field
    particle_flags: _Field
    particle_world: _Field
    particle_colors: _Field
    particle_spring_indices: _Field
    particle_spring_rest_length: _Field
    particle_spring_stiffness: _Field
    particle_spring_damping: _Field
    particle_spring_control: _Field
    particle_tri_indices: _Field
    particle_tri_pose: _Field
    particle_tri_area: _Field
    particle_tri_activation: _Field
    particle_tri_material: _Field
    particle_edge_indices: _Field
    particle_edge_rest_angle: _Field
    particle_edge_rest_length: _Field
    particle_edge_material: _Field
    particle_tet_indices: _Field
    particle_tet_pose: _Field
    particle_tet_volume: _Field
    particle_tet_activation: _Field
    particle_tet_material: _Field
    spring_indices: _Field
    spring_rest_length: _Field
    spring_stiffness: _Field
    spring_damping: _Field
    spring_control: _Field
    tri_indices: _Field
    tri_poses: _Field
    tri_areas: _Field
    tri_activations: _Field
    tri_materials: _Field
    edge_indices: _Field
    edge_rest_angle: _Field
    edge_rest_length: _Field
    edge_bending_properties: _Field
    tet_indices: _Field
    tet_poses: _Field
    tet_activations: _Field
    tet_materials: _Field
    body_q: _Field
    body_qd: _Field
    body_com: _Field
    body_mass: _Field
    body_inv_mass: _Field
    body_inertia: _Field
    body_inv_inertia: _Field
    body_gravcomp: _Field
    body_flags: _Field
    body_world: _Field
    shape_body: _Field
    shape_transform: _Field
    shape_type: _Field
    shape_scale: _Field
    shape_flags: _Field
    shape_world: _Field
    shape_color: _Field
    shape_collision_group: _Field
    shape_is_solid: _Field
    shape_margin: _Field
    shape_gap: _Field
    shape_material_ke: _Field
    shape_material_kd: _Field
    shape_material_kf: _Field
    shape_material_ka: _Field
    shape_material_mu: _Field
    shape_material_restitution: _Field
    shape_material_mu_torsional: _Field
    shape_material_mu_rolling: _Field
    shape_collision_radius: _Field
    shape_aabb_lower: _Field
    shape_aabb_upper: _Field
    shape_mesh_range: _Field
    shape_mixing: _Field
    mesh_vertices: _Field
    mesh_indices: _Field
    shape_collision_aabb_lower: _Field
    shape_collision_aabb_upper: _Field
    shape_contact_pairs: _Field
    joint_type: _Field
    joint_parent: _Field
    joint_child: _Field
    joint_X_p: _Field
    joint_X_c: _Field
    joint_dof_dim: _Field
    joint_q_start: _Field
    joint_qd_start: _Field
    joint_enabled: _Field
    joint_articulation: _Field
    joint_ancestor: _Field
    joint_world: _Field
    joint_mimic: _Field
    joint_mimic_coef: _Field
    joint_q: _Field
    joint_target_q: _Field
    joint_axis: _Field
    joint_target_mode: _Field
    joint_qd: _Field
    joint_f: _Field
    joint_target_qd: _Field
    joint_act: _Field
    joint_armature: _Field
    joint_target_ke: _Field
    joint_target_kd: _Field
    joint_damping: _Field
    joint_friction: _Field
    joint_limit_lower: _Field
    joint_limit_upper: _Field
    joint_limit_ke: _Field
    joint_limit_kd: _Field
    joint_effort_limit: _Field
    joint_velocity_limit: _Field
    articulation_start: _Field
    articulation_end: _Field
    actuator_dof: _Field
    actuator_body: _Field
    actuator_axes: _Field
    actuator_frame: _Field
    actuator_reference: _Field
    actuator_wrench: _Field
    actuator_state: _Field
    actuator_dynamics: _Field
    actuator_gear: _Field
    actuator_gain: _Field
    actuator_bias: _Field
    actuator_time: _Field
    actuator_ctrl_range: _Field
    actuator_force_range: _Field
    actuator_act_range: _Field
    ctrl: _Field
    act: _Field
    gravity: _Field
    soft_contact_ke: float
    soft_contact_kd: float
    soft_contact_kf: float
    soft_contact_mu: float
    soft_contact_restitution: float
    particle_adhesion: float
    particle_max_velocity: float
    particle_max_radius: float
    @property
    def body_label(self) -> list[str]: ...
    @property
    def body_shapes(self) -> dict[int, list[int]]: ...
    @property
    def particle_color_groups(self) -> list[NDArray[np.int32]]: ...
    @property
    def shape_label(self) -> list[str]: ...
    @property
    def shape_source(self) -> list[_Mesh | None]: ...
    @property
    def joint_label(self) -> list[str]: ...
    @property
    def articulation_label(self) -> list[str]: ...
    @property
    def actuator_label(self) -> list[str]: ...
    def select(self, pattern: str, *, world: int | None = None) -> _Selection: ...
    @property
    def max_joints_per_articulation(self) -> int: ...
    @property
    def max_dofs_per_articulation(self) -> int: ...
    @property
    def shape_collision_filter_pairs(self) -> set[tuple[int, int]]: ...
    @property
    def up_axis(self) -> int: ...
    def state(self, requires_grad: bool | None = None) -> SimState: ...
    def control(
        self, clone_variables: bool = True, requires_grad: bool | None = None
    ) -> Control: ...
    def contacts(self, collision_pipeline: CollisionPipeline | None = None) -> Contacts: ...
    def collide(
        self,
        state: SimState,
        contacts: Contacts | None = None,
        *,
        collision_pipeline: CollisionPipeline | None = None,
    ) -> Contacts: ...
    def set_gravity(self, value: _Vector, world: SupportsIndex | None = None) -> None: ...
    def clone(self) -> Model: ...
    def to(self, device: _DeviceLike) -> Model: ...

class SimState(_Counts):
    particle_q: _Field
    particle_qd: _Field
    particle_f: _Field
    body_q: _Field
    body_qd: _Field
    body_f: _Field
    joint_q: _Field
    joint_qd: _Field
    act: _Field
    def clear_forces(self) -> None: ...
    def assign(self, source: SimState) -> None: ...
    def clone(self) -> SimState: ...

class Control(_Counts):
    joint_f: _Field
    joint_target_q: _Field
    joint_target_qd: _Field
    joint_act: _Field
    particle_tri_activation: _Field
    particle_tet_activation: _Field
    ctrl: _Field
    tri_activations: _Field
    tet_activations: _Field
    def clear(self, model: Model | None = None) -> None: ...
    def assign(self, source: Control) -> None: ...
    def clone(self) -> Control: ...

class Contacts(_Native):
    def __init__(
        self,
        rigid_contact_max: SupportsIndex = 0,
        soft_contact_max: SupportsIndex = 0,
        *,
        device: _DeviceLike = None,
        requires_grad: bool = False,
        per_contact_shape_properties: bool = False,
    ) -> None: ...
    soft_contact_count: _Field
    soft_contact_particle: _Field
    soft_contact_shape: _Field
    soft_contact_body_pos: _Field
    soft_contact_body_vel: _Field
    soft_contact_normal: _Field
    soft_contact_tids: _Field
    rigid_contact_count: _Field
    rigid_contact_shape0: _Field
    rigid_contact_shape1: _Field
    rigid_contact_point0: _Field
    rigid_contact_point1: _Field
    rigid_contact_offset0: _Field
    rigid_contact_offset1: _Field
    rigid_contact_normal: _Field
    rigid_contact_margin0: _Field
    rigid_contact_margin1: _Field
    rigid_contact_point_id: _Field
    rigid_contact_stiffness: _Field
    rigid_contact_damping: _Field
    rigid_contact_friction: _Field
    rigid_contact_force: _Field
    contact_generation: _Field
    requires_grad: bool
    @property
    def soft_contact_max(self) -> int: ...
    @property
    def rigid_contact_max(self) -> int: ...
    @property
    def per_contact_shape_properties(self) -> bool: ...
    @property
    def active_rigid_contact_count(self) -> int: ...
    @property
    def soft_contact_pair_count(self) -> int: ...
    @property
    def device(self) -> Device: ...
    @property
    def overflowed(self) -> bool: ...
    @property
    def active_soft_contact_count(self) -> int: ...
    def clear(self) -> None: ...
    def soft_contacts(self) -> NDArray[Any]: ...
    def __len__(self) -> int: ...
    def rigid_contacts(
        self, model: Model | None = None, state: SimState | None = None
    ) -> NDArray[Any]: ...
    def match(self, previous: Contacts, pairs: bool = False) -> NDArray[np.int32]: ...
    def assign(self, source: Contacts) -> None: ...
    def clone(self) -> Contacts: ...

class CollisionPipeline(_Native):
    def __init__(
        self,
        model: Model,
        *,
        broad_phase: str = "explicit",
        narrow_phase: str = "auto",
        rigid_contact_max: SupportsIndex | None = None,
        contacts_per_pair: SupportsIndex = 8,
        soft_contact_max: SupportsIndex | None = None,
        soft_contact_margin: SupportsFloat | None = None,
        soft_contact_gap: SupportsFloat | None = None,
        requires_grad: bool | None = None,
        deterministic: bool = True,
        reduce_contacts: bool = True,
        shape_pairs_filtered: Iterable[Sequence[SupportsIndex]] | NDArray[Any] | None = None,
    ) -> None: ...
    @property
    def model(self) -> Model: ...
    @property
    def broad_phase(self) -> str: ...
    @property
    def narrow_phase(self) -> str: ...
    @property
    def shape_pairs_filtered(self) -> list[tuple[int, int]] | None: ...
    @property
    def fcl_pair_count(self) -> int: ...
    @property
    def fcl_fallback_count(self) -> int: ...
    @property
    def soft_contact_margin(self) -> float: ...
    @property
    def rigid_contact_max(self) -> int: ...
    @property
    def soft_contact_max(self) -> int: ...
    @property
    def soft_contact_pair_count(self) -> int: ...
    def contacts(self, *, per_contact_shape_properties: bool = False) -> Contacts: ...
    def collide(
        self,
        state: SimState,
        contacts: Contacts,
        *,
        soft_contact_margin: SupportsFloat | None = None,
        dt: SupportsFloat | None = None,
    ) -> None: ...

# ------------------------------------------------------------------------------------ builder

class ShapeConfig(_Native):
    def __init__(
        self,
        density: SupportsFloat = 1000.0,
        ke: SupportsFloat = 2500.0,
        kd: SupportsFloat = 100.0,
        kf: SupportsFloat = 1000.0,
        ka: SupportsFloat = 0.0,
        mu: SupportsFloat = 1.0,
        restitution: SupportsFloat = 0.0,
        mu_torsional: SupportsFloat = 0.005,
        mu_rolling: SupportsFloat = 0.0001,
        margin: SupportsFloat = 0.0,
        gap: SupportsFloat | None = None,
        is_solid: bool = True,
        collision_group: SupportsIndex = 1,
        collision_filter_parent: bool = True,
        has_shape_collision: bool = True,
        has_particle_collision: bool = True,
        is_visible: bool = True,
        mixing: Sequence[SupportsFloat] = (0.0, 0.0, 0.0, 0.0),
    ) -> None: ...
    density: float
    ke: float
    kd: float
    kf: float
    ka: float
    mu: float
    restitution: float
    mu_torsional: float
    mu_rolling: float
    margin: float
    gap: float | None
    is_solid: bool
    collision_group: int
    collision_filter_parent: bool
    has_shape_collision: bool
    has_particle_collision: bool
    is_visible: bool
    mixing: tuple[float, float, float, float]
    @property
    def flags(self) -> int: ...
    def copy(self) -> ShapeConfig: ...

class JointDofConfig(_Native):
    def __init__(
        self,
        axis: _Vector | SupportsIndex | str | None = None,
        limit_lower: SupportsFloat | None = None,
        limit_upper: SupportsFloat | None = None,
        limit_ke: SupportsFloat | None = None,
        limit_kd: SupportsFloat | None = None,
        target_q: SupportsFloat | None = None,
        target_qd: SupportsFloat | None = None,
        target_ke: SupportsFloat | None = None,
        target_kd: SupportsFloat | None = None,
        damping: SupportsFloat | None = None,
        armature: SupportsFloat | None = None,
        effort_limit: SupportsFloat | None = None,
        velocity_limit: SupportsFloat | None = None,
        friction: SupportsFloat | None = None,
        actuator_mode: SupportsIndex | None = None,
    ) -> None: ...
    @property
    def axis(self) -> tuple[float, float, float]: ...
    @axis.setter
    def axis(self, value: _Vector | SupportsIndex | str) -> None: ...
    limit_lower: float
    limit_upper: float
    limit_ke: float
    limit_kd: float
    target_q: float
    target_qd: float
    target_ke: float
    target_kd: float
    damping: float
    armature: float
    effort_limit: float
    velocity_limit: float
    friction: float
    actuator_mode: int
    @staticmethod
    def create_unlimited(axis: _Vector | SupportsIndex | str) -> JointDofConfig: ...

class _Vec3List(_Native):
    def __len__(self) -> int: ...
    @overload
    def __getitem__(self, index: SupportsIndex) -> tuple[float, float, float]: ...
    @overload
    def __getitem__(self, index: slice) -> list[tuple[float, float, float]]: ...
    @overload
    def __setitem__(self, index: SupportsIndex, value: _Vector) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Sequence[_Vector] | NDArray[Any]) -> None: ...
    def __iter__(self) -> Iterator[tuple[float, float, float]]: ...

class _FloatList(_Native):
    def __len__(self) -> int: ...
    @overload
    def __getitem__(self, index: SupportsIndex) -> float: ...
    @overload
    def __getitem__(self, index: slice) -> list[float]: ...
    @overload
    def __setitem__(self, index: SupportsIndex, value: SupportsFloat) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: _Vector) -> None: ...
    def __iter__(self) -> Iterator[float]: ...

class _TransformList(_Native):
    def __len__(self) -> int: ...
    @overload
    def __getitem__(
        self, index: SupportsIndex
    ) -> tuple[float, float, float, float, float, float, float]: ...
    @overload
    def __getitem__(
        self, index: slice
    ) -> list[tuple[float, float, float, float, float, float, float]]: ...
    @overload
    def __setitem__(self, index: SupportsIndex, value: _Transform) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Sequence[_Transform]) -> None: ...
    def __iter__(self) -> Iterator[tuple[float, float, float, float, float, float, float]]: ...

class _SpatialVectorList(_Native):
    def __len__(self) -> int: ...
    @overload
    def __getitem__(
        self, index: SupportsIndex
    ) -> tuple[float, float, float, float, float, float]: ...
    @overload
    def __getitem__(
        self, index: slice
    ) -> list[tuple[float, float, float, float, float, float]]: ...
    @overload
    def __setitem__(self, index: SupportsIndex, value: _Vector) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Sequence[_Vector]) -> None: ...
    def __iter__(self) -> Iterator[tuple[float, float, float, float, float, float]]: ...

class _IntList(_Native):
    def __len__(self) -> int: ...
    @overload
    def __getitem__(self, index: SupportsIndex) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...
    @overload
    def __setitem__(self, index: SupportsIndex, value: SupportsIndex) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Sequence[SupportsIndex]) -> None: ...
    def __iter__(self) -> Iterator[int]: ...

_ShapeConfig: TypeAlias = ShapeConfig
_JointDofConfig: TypeAlias = JointDofConfig

class ModelBuilder(_Native):
    ShapeConfig: type[_ShapeConfig]
    def __init__(
        self,
        up_axis: Axis | int | str | _Vector = 2,
        gravity: SupportsFloat | _Vector | None = None,
    ) -> None: ...
    @property
    def gravity(self) -> tuple[float, float, float]: ...
    @gravity.setter
    def gravity(self, value: SupportsFloat | _Vector) -> None: ...
    @property
    def up_axis(self) -> int: ...
    @property
    def up_vector(self) -> tuple[float, float, float]: ...
    default_particle_radius: float
    default_shape_cfg: _ShapeConfig
    rigid_gap: float
    balance_inertia: bool
    bound_mass: float | None
    bound_inertia: float | None
    default_tri_ke: float
    default_tri_ka: float
    default_tri_kd: float
    default_tri_drag: float
    default_tri_lift: float
    default_spring_ke: float
    default_spring_kd: float
    default_edge_ke: float
    default_edge_kd: float
    default_tet_k_mu: float
    default_tet_k_lambda: float
    default_tet_k_damp: float
    default_tet_density: float
    @property
    def spring_count(self) -> int: ...
    @property
    def tri_count(self) -> int: ...
    @property
    def edge_count(self) -> int: ...
    @property
    def tet_count(self) -> int: ...
    @property
    def particle_count(self) -> int: ...
    @property
    def body_count(self) -> int: ...
    @property
    def shape_count(self) -> int: ...
    @property
    def particle_q(self) -> _Vec3List: ...
    @particle_q.setter
    def particle_q(self, values: Sequence[_Vector] | NDArray[Any]) -> None: ...
    @property
    def particle_qd(self) -> _Vec3List: ...
    @particle_qd.setter
    def particle_qd(self, values: Sequence[_Vector] | NDArray[Any]) -> None: ...
    @property
    def particle_mass(self) -> _FloatList: ...
    @particle_mass.setter
    def particle_mass(self, values: _Vector) -> None: ...
    @property
    def particle_radius(self) -> _FloatList: ...
    @particle_radius.setter
    def particle_radius(self, values: _Vector) -> None: ...
    @property
    def body_q(self) -> _TransformList: ...
    @body_q.setter
    def body_q(self, values: Sequence[_Transform]) -> None: ...
    @property
    def body_qd(self) -> _SpatialVectorList: ...
    @body_qd.setter
    def body_qd(self, values: Sequence[_Vector]) -> None: ...
    def add_body(
        self,
        *,
        xform: _Transform | None = None,
        com: _Vector | None = None,
        inertia: Sequence[_Vector] | NDArray[Any] | None = None,
        mass: SupportsFloat = 0.0,
        lock_inertia: bool = False,
        is_kinematic: bool = False,
        gravcomp: SupportsFloat = 0.0,
        label: str | None = None,
    ) -> int: ...
    def add_link(
        self,
        *,
        xform: _Transform | None = None,
        com: _Vector | None = None,
        inertia: Sequence[_Vector] | NDArray[Any] | None = None,
        mass: SupportsFloat = 0.0,
        lock_inertia: bool = False,
        is_kinematic: bool = False,
        gravcomp: SupportsFloat = 0.0,
        label: str | None = None,
    ) -> int: ...
    JointDofConfig: type[_JointDofConfig]
    default_joint_cfg: _JointDofConfig
    @property
    def joint_count(self) -> int: ...
    @property
    def joint_coord_count(self) -> int: ...
    @property
    def joint_dof_count(self) -> int: ...
    @property
    def articulation_count(self) -> int: ...
    @property
    def joint_q(self) -> _FloatList: ...
    @joint_q.setter
    def joint_q(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_target_q(self) -> _FloatList: ...
    @joint_target_q.setter
    def joint_target_q(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_qd(self) -> _FloatList: ...
    @joint_qd.setter
    def joint_qd(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_f(self) -> _FloatList: ...
    @joint_f.setter
    def joint_f(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_target_qd(self) -> _FloatList: ...
    @joint_target_qd.setter
    def joint_target_qd(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_act(self) -> _FloatList: ...
    @joint_act.setter
    def joint_act(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_armature(self) -> _FloatList: ...
    @joint_armature.setter
    def joint_armature(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_target_ke(self) -> _FloatList: ...
    @joint_target_ke.setter
    def joint_target_ke(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_target_kd(self) -> _FloatList: ...
    @joint_target_kd.setter
    def joint_target_kd(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_damping(self) -> _FloatList: ...
    @joint_damping.setter
    def joint_damping(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_friction(self) -> _FloatList: ...
    @joint_friction.setter
    def joint_friction(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_limit_lower(self) -> _FloatList: ...
    @joint_limit_lower.setter
    def joint_limit_lower(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_limit_upper(self) -> _FloatList: ...
    @joint_limit_upper.setter
    def joint_limit_upper(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_limit_ke(self) -> _FloatList: ...
    @joint_limit_ke.setter
    def joint_limit_ke(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_limit_kd(self) -> _FloatList: ...
    @joint_limit_kd.setter
    def joint_limit_kd(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_effort_limit(self) -> _FloatList: ...
    @joint_effort_limit.setter
    def joint_effort_limit(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_velocity_limit(self) -> _FloatList: ...
    @joint_velocity_limit.setter
    def joint_velocity_limit(self, values: Sequence[SupportsFloat]) -> None: ...
    @property
    def joint_target_mode(self) -> _IntList: ...
    @joint_target_mode.setter
    def joint_target_mode(self, values: Sequence[SupportsIndex]) -> None: ...
    def add_joint(
        self,
        joint_type: SupportsIndex,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        linear_axes: Sequence[_JointDofConfig] | None = None,
        angular_axes: Sequence[_JointDofConfig] | None = None,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_d6(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        linear_axes: Sequence[_JointDofConfig] | None = None,
        angular_axes: Sequence[_JointDofConfig] | None = None,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_fixed(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_revolute(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        axis: _Vector | SupportsIndex | str | None = None,
        limit_lower: SupportsFloat | None = None,
        limit_upper: SupportsFloat | None = None,
        limit_ke: SupportsFloat | None = None,
        limit_kd: SupportsFloat | None = None,
        target_q: SupportsFloat | None = None,
        target_qd: SupportsFloat | None = None,
        target_ke: SupportsFloat | None = None,
        target_kd: SupportsFloat | None = None,
        damping: SupportsFloat | None = None,
        armature: SupportsFloat | None = None,
        effort_limit: SupportsFloat | None = None,
        velocity_limit: SupportsFloat | None = None,
        friction: SupportsFloat | None = None,
        actuator_mode: SupportsIndex | None = None,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_prismatic(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        axis: _Vector | SupportsIndex | str | None = None,
        limit_lower: SupportsFloat | None = None,
        limit_upper: SupportsFloat | None = None,
        limit_ke: SupportsFloat | None = None,
        limit_kd: SupportsFloat | None = None,
        target_q: SupportsFloat | None = None,
        target_qd: SupportsFloat | None = None,
        target_ke: SupportsFloat | None = None,
        target_kd: SupportsFloat | None = None,
        damping: SupportsFloat | None = None,
        armature: SupportsFloat | None = None,
        effort_limit: SupportsFloat | None = None,
        velocity_limit: SupportsFloat | None = None,
        friction: SupportsFloat | None = None,
        actuator_mode: SupportsIndex | None = None,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_ball(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        armature: SupportsFloat = 0.0,
        friction: SupportsFloat = 0.0,
        damping: SupportsFloat = 0.0,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_joint_free(
        self,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        parent: SupportsIndex = -1,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_actuator(
        self,
        joint: SupportsIndex,
        *,
        axis: SupportsIndex = 0,
        gear: SupportsFloat = 1.0,
        gain: Sequence[SupportsFloat] = ...,
        bias: Sequence[SupportsFloat] = ...,
        dynamics: ActuatorDynamics | int = 0,
        time: SupportsFloat = 1.0,
        ctrl_range: Sequence[SupportsFloat] | None = None,
        force_range: Sequence[SupportsFloat] | None = None,
        act_range: Sequence[SupportsFloat] | None = None,
        ctrl: SupportsFloat = 0.0,
        act: SupportsFloat = 0.0,
        label: str | None = None,
    ) -> int: ...
    def add_body_actuator(
        self,
        body: SupportsIndex,
        *,
        wrench: Sequence[SupportsFloat],
        frame: _Transform | None = None,
        reference_body: SupportsIndex | None = None,
        reference: _Transform | None = None,
        gain: Sequence[SupportsFloat] = ...,
        bias: Sequence[SupportsFloat] = ...,
        dynamics: ActuatorDynamics | int = 0,
        time: SupportsFloat = 1.0,
        ctrl_range: Sequence[SupportsFloat] | None = None,
        force_range: Sequence[SupportsFloat] | None = None,
        act_range: Sequence[SupportsFloat] | None = None,
        ctrl: SupportsFloat = 0.0,
        act: SupportsFloat = 0.0,
        label: str | None = None,
    ) -> int: ...
    @property
    def actuator_count(self) -> int: ...
    def add_constraint_mimic(
        self,
        joint0: SupportsIndex,
        joint1: SupportsIndex,
        coef0: SupportsFloat = 0.0,
        coef1: SupportsFloat = 1.0,
    ) -> None: ...
    def add_joint_distance(
        self,
        parent: SupportsIndex,
        child: SupportsIndex,
        *,
        parent_xform: _Transform | None = None,
        child_xform: _Transform | None = None,
        min_distance: SupportsFloat = -1.0,
        max_distance: SupportsFloat = 1.0,
        limit_ke: SupportsFloat = 10000.0,
        limit_kd: SupportsFloat = 10.0,
        collision_filter_parent: bool | None = None,
        enabled: bool = True,
        label: str | None = None,
    ) -> int: ...
    def add_articulation(
        self, joints: Sequence[SupportsIndex], *, label: str | None = None
    ) -> int: ...
    def collapse_fixed_joints(
        self, joints_to_keep: Sequence[str] | None = None
    ) -> dict[str, dict[int, Any]]: ...
    @property
    def particle_flags(self) -> _IntList: ...
    @particle_flags.setter
    def particle_flags(self, values: Sequence[SupportsIndex]) -> None: ...
    @property
    def particle_world(self) -> _IntList: ...
    @particle_world.setter
    def particle_world(self, values: Sequence[SupportsIndex]) -> None: ...
    def add_particle(
        self,
        pos: _Vector,
        vel: _Vector,
        mass: SupportsFloat,
        radius: SupportsFloat | None = None,
        flags: SupportsIndex = 1,
    ) -> int: ...
    def add_particles(
        self,
        pos: Sequence[_Vector] | NDArray[Any],
        vel: Sequence[_Vector] | NDArray[Any],
        mass: _Vector,
        radius: _Vector | None = None,
        flags: Sequence[SupportsIndex] | None = None,
    ) -> None: ...
    def add_spring(
        self,
        i: SupportsIndex,
        j: SupportsIndex,
        ke: SupportsFloat,
        kd: SupportsFloat,
        control: SupportsFloat = 0.0,
    ) -> int: ...
    def add_triangle(
        self,
        i: SupportsIndex,
        j: SupportsIndex,
        k: SupportsIndex,
        *,
        tri_ke: SupportsFloat | None = None,
        tri_ka: SupportsFloat | None = None,
        tri_kd: SupportsFloat | None = None,
        tri_drag: SupportsFloat | None = None,
        tri_lift: SupportsFloat | None = None,
    ) -> float: ...
    def add_triangles(
        self,
        i: Sequence[SupportsIndex] | NDArray[Any],
        j: Sequence[SupportsIndex] | NDArray[Any],
        k: Sequence[SupportsIndex] | NDArray[Any],
        *,
        tri_ke: SupportsFloat | _Vector | None = None,
        tri_ka: SupportsFloat | _Vector | None = None,
        tri_kd: SupportsFloat | _Vector | None = None,
        tri_drag: SupportsFloat | _Vector | None = None,
        tri_lift: SupportsFloat | _Vector | None = None,
    ) -> list[float]: ...
    def add_tetrahedron(
        self,
        i: SupportsIndex,
        j: SupportsIndex,
        k: SupportsIndex,
        l: SupportsIndex,
        k_mu: SupportsFloat | None = None,
        k_lambda: SupportsFloat | None = None,
        k_damp: SupportsFloat | None = None,
    ) -> float: ...
    def add_tetrahedra(
        self,
        i: Sequence[SupportsIndex] | NDArray[Any],
        j: Sequence[SupportsIndex] | NDArray[Any],
        k: Sequence[SupportsIndex] | NDArray[Any],
        l: Sequence[SupportsIndex] | NDArray[Any],
        *,
        k_mu: SupportsFloat | _Vector | None = None,
        k_lambda: SupportsFloat | _Vector | None = None,
        k_damp: SupportsFloat | _Vector | None = None,
    ) -> list[float]: ...
    def add_edge(
        self,
        i: SupportsIndex,
        j: SupportsIndex,
        k: SupportsIndex,
        l: SupportsIndex,
        *,
        rest: SupportsFloat | None = None,
        edge_ke: SupportsFloat | None = None,
        edge_kd: SupportsFloat | None = None,
    ) -> int: ...
    def add_edges(
        self,
        i: Sequence[SupportsIndex] | NDArray[Any],
        j: Sequence[SupportsIndex] | NDArray[Any],
        k: Sequence[SupportsIndex] | NDArray[Any],
        l: Sequence[SupportsIndex] | NDArray[Any],
        *,
        rest: _Vector | None = None,
        edge_ke: SupportsFloat | _Vector | None = None,
        edge_kd: SupportsFloat | _Vector | None = None,
    ) -> None: ...
    def add_particle_grid(
        self,
        *,
        pos: _Vector = (0.0, 0.0, 0.0),
        rot: _Vector = (0.0, 0.0, 0.0, 1.0),
        vel: _Vector = (0.0, 0.0, 0.0),
        dim_x: SupportsIndex,
        dim_y: SupportsIndex,
        dim_z: SupportsIndex,
        cell_x: SupportsFloat,
        cell_y: SupportsFloat,
        cell_z: SupportsFloat,
        mass: SupportsFloat,
        jitter: SupportsFloat = 0.0,
        radius_mean: SupportsFloat | None = None,
        radius_std: SupportsFloat = 0.0,
        seed: SupportsIndex = 0,
    ) -> None: ...
    def add_cloth_grid(
        self,
        *,
        pos: _Vector = (0.0, 0.0, 0.0),
        rot: _Vector = (0.0, 0.0, 0.0, 1.0),
        vel: _Vector = (0.0, 0.0, 0.0),
        dim_x: SupportsIndex,
        dim_y: SupportsIndex,
        cell_x: SupportsFloat,
        cell_y: SupportsFloat,
        mass: SupportsFloat,
        reverse_winding: bool = False,
        fix_left: bool = False,
        fix_right: bool = False,
        fix_top: bool = False,
        fix_bottom: bool = False,
        tri_ke: SupportsFloat | None = None,
        tri_ka: SupportsFloat | None = None,
        tri_kd: SupportsFloat | None = None,
        tri_drag: SupportsFloat | None = None,
        tri_lift: SupportsFloat | None = None,
        edge_ke: SupportsFloat | None = None,
        edge_kd: SupportsFloat | None = None,
        add_springs: bool = False,
        spring_ke: SupportsFloat | None = None,
        spring_kd: SupportsFloat | None = None,
        particle_radius: SupportsFloat | None = None,
    ) -> None: ...
    def add_cloth_mesh(
        self,
        *,
        pos: _Vector = (0.0, 0.0, 0.0),
        rot: _Vector = (0.0, 0.0, 0.0, 1.0),
        scale: SupportsFloat = 1.0,
        vel: _Vector = (0.0, 0.0, 0.0),
        vertices: Sequence[_Vector] | NDArray[Any],
        indices: Sequence[SupportsIndex] | NDArray[Any],
        density: SupportsFloat,
        tri_ke: SupportsFloat | None = None,
        tri_ka: SupportsFloat | None = None,
        tri_kd: SupportsFloat | None = None,
        tri_drag: SupportsFloat | None = None,
        tri_lift: SupportsFloat | None = None,
        edge_ke: SupportsFloat | None = None,
        edge_kd: SupportsFloat | None = None,
        add_springs: bool = False,
        spring_ke: SupportsFloat | None = None,
        spring_kd: SupportsFloat | None = None,
        particle_radius: SupportsFloat | None = None,
    ) -> None: ...
    def add_soft_grid(
        self,
        *,
        pos: _Vector = (0.0, 0.0, 0.0),
        rot: _Vector = (0.0, 0.0, 0.0, 1.0),
        vel: _Vector = (0.0, 0.0, 0.0),
        dim_x: SupportsIndex,
        dim_y: SupportsIndex,
        dim_z: SupportsIndex,
        cell_x: SupportsFloat,
        cell_y: SupportsFloat,
        cell_z: SupportsFloat,
        density: SupportsFloat,
        k_mu: SupportsFloat | None = None,
        k_lambda: SupportsFloat | None = None,
        k_damp: SupportsFloat | None = None,
        fix_left: bool = False,
        fix_right: bool = False,
        fix_top: bool = False,
        fix_bottom: bool = False,
        tri_ke: SupportsFloat | None = 0.0,
        tri_ka: SupportsFloat | None = 0.0,
        tri_kd: SupportsFloat | None = 0.0,
        tri_drag: SupportsFloat | None = 0.0,
        tri_lift: SupportsFloat | None = 0.0,
        add_surface_mesh_edges: bool = True,
        edge_ke: SupportsFloat | None = 0.0,
        edge_kd: SupportsFloat | None = 0.0,
        particle_radius: SupportsFloat | None = None,
    ) -> None: ...
    def add_soft_mesh(
        self,
        *,
        pos: _Vector = (0.0, 0.0, 0.0),
        rot: _Vector = (0.0, 0.0, 0.0, 1.0),
        scale: SupportsFloat = 1.0,
        vel: _Vector = (0.0, 0.0, 0.0),
        mesh: object | None = None,
        vertices: Sequence[_Vector] | NDArray[Any] | None = None,
        indices: Sequence[SupportsIndex] | NDArray[Any] | None = None,
        density: SupportsFloat | None = None,
        k_mu: SupportsFloat | _Vector | None = None,
        k_lambda: SupportsFloat | _Vector | None = None,
        k_damp: SupportsFloat | _Vector | None = None,
        tri_ke: SupportsFloat | None = 0.0,
        tri_ka: SupportsFloat | None = 0.0,
        tri_kd: SupportsFloat | None = 0.0,
        tri_drag: SupportsFloat | None = 0.0,
        tri_lift: SupportsFloat | None = 0.0,
        add_surface_mesh_edges: bool = True,
        edge_ke: SupportsFloat | None = 0.0,
        edge_kd: SupportsFloat | None = 0.0,
        particle_radius: SupportsFloat | None = None,
    ) -> None: ...
    def add_shape(
        self,
        *,
        body: SupportsIndex = -1,
        type: GeoType | int,
        xform: _Transform | None = None,
        cfg: _ShapeConfig | None = None,
        scale: _Vector | None = None,
        src: object | None = None,
        is_static: bool = False,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_plane(
        self,
        plane: _Vector = (0.0, 0.0, 1.0, 0.0),
        *,
        xform: _Transform | None = None,
        width: SupportsFloat = 10.0,
        length: SupportsFloat = 10.0,
        body: SupportsIndex = -1,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_ground_plane(
        self,
        *,
        height: SupportsFloat = 0.0,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_sphere(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        radius: SupportsFloat = 1.0,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_box(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        hx: SupportsFloat = 0.5,
        hy: SupportsFloat = 0.5,
        hz: SupportsFloat = 0.5,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_capsule(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        radius: SupportsFloat = 1.0,
        half_height: SupportsFloat = 0.5,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_cylinder(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        radius: SupportsFloat = 1.0,
        half_height: SupportsFloat = 0.5,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_cone(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        radius: SupportsFloat = 1.0,
        half_height: SupportsFloat = 0.5,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_ellipsoid(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        rx: SupportsFloat = 1.0,
        ry: SupportsFloat = 0.75,
        rz: SupportsFloat = 0.5,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_mesh(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        mesh: object | None = None,
        vertices: Sequence[_Vector] | NDArray[Any] | None = None,
        indices: Sequence[SupportsIndex] | NDArray[Any] | None = None,
        scale: SupportsFloat | _Vector | None = None,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_convex_hull(
        self,
        body: SupportsIndex,
        *,
        xform: _Transform | None = None,
        mesh: object | None = None,
        vertices: Sequence[_Vector] | NDArray[Any] | None = None,
        scale: SupportsFloat | _Vector | None = None,
        max_vertices: SupportsIndex = 64,
        cfg: _ShapeConfig | None = None,
        color: _Vector | None = None,
        label: str | None = None,
    ) -> int: ...
    def add_shape_collision_filter_pair(self, a: SupportsIndex, b: SupportsIndex) -> None: ...
    @property
    def world_count(self) -> int: ...
    @property
    def current_world(self) -> int: ...
    def begin_world(self, *, gravity: _Vector | None = None) -> int: ...
    def end_world(self) -> None: ...
    def add_builder(self, builder: ModelBuilder, xform: _Transform | None = None) -> None: ...
    def add_world(self, builder: ModelBuilder, xform: _Transform | None = None) -> int: ...
    def replicate(
        self, builder: ModelBuilder, world_count: SupportsIndex, spacing: _Vector = ...
    ) -> None: ...
    def color(self, include_bending: bool | None = None, balance_colors: bool = True) -> None: ...
    def set_coloring(
        self,
        groups: Iterable[Sequence[SupportsIndex] | NDArray[Any]],
        allow_conflicts: bool = False,
    ) -> None: ...
    def add_mjcf(
        self,
        source: str | os.PathLike[str],
        *,
        xform: _Transform | None = None,
        collapse_fixed_joints: bool = False,
        enable_self_collisions: bool = True,
        package_dirs: Sequence[str | os.PathLike[str]] | None = None,
        unsupported: str = "error",
        filter_overlaps: bool = False,
    ) -> io.RobotImport: ...
    def add_urdf(
        self,
        source: str | os.PathLike[str],
        *,
        xform: _Transform | None = None,
        floating: bool | None = None,
        base_joint: dict[str, Any] | None = None,
        parent_body: SupportsIndex = -1,
        scale: SupportsFloat = 1.0,
        hide_visuals: bool = False,
        parse_visuals_as_colliders: bool = False,
        up_axis: Axis | int | str | _Vector = 2,
        force_show_colliders: bool = False,
        enable_self_collisions: bool = True,
        ignore_inertial_definitions: bool = False,
        joint_ordering: str | None = "dfs",
        bodies_follow_joint_ordering: bool = True,
        collapse_fixed_joints: bool = False,
        mesh_maxhullvert: SupportsIndex | None = None,
        joint_damping_mode: str = "passive",
        package_dirs: Sequence[str | os.PathLike[str]] | None = None,
        mimic: str = "follow",
        mend_inertias: bool = True,
        unsupported: str = "error",
        filter_overlaps: bool = False,
        ignore_zero_effort: bool = False,
    ) -> io.RobotImport: ...
    def finalize(
        self,
        device: _DeviceLike = None,
        *,
        requires_grad: bool = False,
        skip_validation: bool = False,
    ) -> Model: ...

def eval_fk(model: Model, joint_q: DeviceArray, joint_qd: DeviceArray, state: SimState) -> None: ...
def eval_mimic(model: Model, joint_q: DeviceArray, joint_qd: DeviceArray) -> None: ...
def eval_ik(model: Model, state: SimState, joint_q: DeviceArray, joint_qd: DeviceArray) -> None: ...
def eval_inverse_dynamics(model: Model, state: SimState, qdd: _Vector) -> NDArray[np.float32]: ...
def eval_actuator_forces(
    model: Model, state: SimState, control: Control | None = None
) -> NDArray[np.float32]: ...
def eval_bias(model: Model, state: SimState) -> NDArray[np.float32]: ...
def eval_forward_dynamics(model: Model, state: SimState, tau: _Vector) -> NDArray[np.float32]: ...
def eval_mass_matrix(
    model: Model, state: SimState, include_armature: bool = True
) -> NDArray[np.float32]: ...
def eval_jacobian(model: Model, state: SimState) -> NDArray[np.float32]: ...
def eval_inverse_dynamics_derivatives(
    model: Model, state: SimState, qdd: _Vector
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def eval_forward_dynamics_derivatives(
    model: Model, state: SimState, tau: _Vector
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def eval_center_of_mass(model: Model, state: SimState) -> NDArray[np.float32]: ...
def eval_energy(model: Model, state: SimState) -> NDArray[np.float32]: ...
