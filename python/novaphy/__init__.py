"""NovaPhy: a differentiable physics engine.

The engine is a native library, and this package is its Python interface. The subpackages
(``novaphy.nova``, ``novaphy.diff``, ``novaphy.solvers``, ``novaphy.viewer``, ``novaphy.io``,
``novaphy.envs``, ``novaphy.assets``, ``novaphy.testing``) are imported at their first use.

Conventions: SI units, float32, z up by default, quaternions ``(x, y, z, w)``, transforms ``(px, py,
pz, qx, qy, qz, qw)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._core import (
    ActuatorDynamics,
    Axis,
    BackendInfo,
    BodyFlags,
    CollisionPipeline,
    Contacts,
    Control,
    Device,
    DeviceArray,
    DeviceType,
    Error,
    Event,
    GeoType,
    JointDofConfig,
    JointTargetMode,
    JointType,
    Model,
    ModelBuilder,
    ModelFlags,
    ParticleFlags,
    ScopedDevice,
    ShapeConfig,
    ShapeFlags,
    SimState,
    SleepConfig,
    backends,
    build_info,
    dtype,
    eval_actuator_forces,
    eval_bias,
    eval_center_of_mass,
    eval_energy,
    eval_fk,
    eval_forward_dynamics,
    eval_forward_dynamics_derivatives,
    eval_ik,
    eval_inverse_dynamics,
    eval_inverse_dynamics_derivatives,
    eval_jacobian,
    eval_mass_matrix,
    eval_mimic,
    float32,
    get_default_device,
    get_device,
    get_devices,
    has_cuda,
    has_diff,
    has_io,
    has_nvrtc,
    has_vbd,
    int32,
    is_device_available,
    load_backend,
    mat22,
    mat33,
    num_threads,
    quat,
    set_default_device,
    set_num_threads,
    spatial_vector,
    synchronize,
    transform,
    uint8,
    uint32,
    uint64,
    vec2,
    vec2i,
    vec3,
    vec3i,
    vec4,
    vec4i,
    version,
)
from ._planned import explain_members, missing_from_module

if TYPE_CHECKING:
    from . import assets, diff, envs, io, nova, solvers, testing, viewer
    from ._select import Selection
    from .viewer import (
        ViewerFile,
        ViewerGL,
        ViewerHTML,
        ViewerNull,
        ViewerViser,
        create_viewer,
    )

State = SimState
__version__ = version()
for _cls in (
    CollisionPipeline,
    Contacts,
    Control,
    JointDofConfig,
    Model,
    ModelBuilder,
    ShapeConfig,
    SimState,
):
    explain_members(_cls, "State" if _cls is SimState else _cls.__name__)

_SUBPACKAGES = ("assets", "diff", "envs", "io", "nova", "solvers", "testing", "viewer")
_FROM_VIEWER = (
    "ViewerFile",
    "ViewerGL",
    "ViewerHTML",
    "ViewerNull",
    "ViewerViser",
    "create_viewer",
)

__all__ = [
    "ActuatorDynamics",
    "Axis",
    "BackendInfo",
    "BodyFlags",
    "CollisionPipeline",
    "Contacts",
    "Control",
    "Device",
    "DeviceArray",
    "DeviceType",
    "Error",
    "Event",
    "GeoType",
    "JointDofConfig",
    "JointTargetMode",
    "JointType",
    "Model",
    "ModelBuilder",
    "ModelFlags",
    "ParticleFlags",
    "ScopedDevice",
    "ShapeConfig",
    "ShapeFlags",
    "SimState",
    "SleepConfig",
    "State",
    "ViewerFile",
    "ViewerGL",
    "ViewerHTML",
    "ViewerNull",
    "ViewerViser",
    "__version__",
    "assets",
    "backends",
    "build_info",
    "create_viewer",
    "diff",
    "dtype",
    "envs",
    "eval_actuator_forces",
    "eval_bias",
    "eval_center_of_mass",
    "eval_energy",
    "eval_fk",
    "eval_forward_dynamics",
    "eval_forward_dynamics_derivatives",
    "eval_ik",
    "eval_inverse_dynamics",
    "eval_inverse_dynamics_derivatives",
    "eval_jacobian",
    "eval_mass_matrix",
    "eval_mimic",
    "float32",
    "get_default_device",
    "get_device",
    "get_devices",
    "has_cuda",
    "has_diff",
    "has_io",
    "has_nvrtc",
    "has_vbd",
    "int32",
    "io",
    "is_device_available",
    "load_backend",
    "mat22",
    "mat33",
    "nova",
    "num_threads",
    "quat",
    "set_default_device",
    "set_num_threads",
    "solvers",
    "spatial_vector",
    "synchronize",
    "testing",
    "transform",
    "uint8",
    "uint32",
    "uint64",
    "vec2",
    "vec2i",
    "vec3",
    "vec3i",
    "vec4",
    "vec4i",
    "version",
    "viewer",
]


def _select(self: Model, pattern: str, *, world: int | None = None) -> Selection:
    """Return the joints, bodies, shapes and actuators whose label matches a pattern.

    Args:
        pattern: a shell pattern (*, ?, [...]). A label matches if the pattern fits the label, or
            fits "articulation/label", as "*/knee*" does.
        world: the index of the world to search. None searches all worlds.

    Returns:
        A Selection: the indices of the matches, and access to their rows in arrays.

    Raises:
        TypeError: the pattern is not a str.
        ValueError: nothing matches.
        IndexError: the world does not exist.
    """
    from ._select import Selection

    return Selection(self, pattern, world)


Model.select = _select  # type: ignore[method-assign]


def __getattr__(name: str) -> object:
    """Import a subpackage or a viewer at its first use; explain names that are not supported."""
    import importlib

    if name in _SUBPACKAGES:
        return importlib.import_module("." + name, __name__)
    if name in _FROM_VIEWER:
        return getattr(importlib.import_module(".viewer", __name__), name)
    raise missing_from_module("novaphy", name)


def __dir__() -> list[str]:
    """Return every public name, including names that are imported at their first use."""
    return sorted(set(globals()) | set(__all__))
