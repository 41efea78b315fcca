"""Every float array of a model, a state, a control and contacts, in every differentiable solver.

Its gradient is that of differences, or a recorded step refuses it by its name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import novaphy

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32) - 0.5
FACES = [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1,
         2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3]  # fmt: skip
# Arrays that no step reads, because states start with copies.
STARTS = {f"model.{a}_{b}" for a in ("particle", "body", "joint") for b in ("q", "qd")}
STARTS |= {"model.act"}


@dataclasses.dataclass
class Scene:
    model: Callable[[], novaphy.Model]
    solver: Callable[[novaphy.Model], object]
    contacts: str = "none"  # or "given", with materials of rows; "found": by a pipeline of rollout
    control: bool = False
    steps: int = 3
    dt: float = 2e-3
    follows: tuple[str, ...] = ()  # arrays of a state that follow from others


def soft() -> novaphy.Model:
    """A cloth, a block and a spring above a plane and a ball, which they touch."""
    builder = novaphy.ModelBuilder()
    material = novaphy.ShapeConfig(ke=50.0, kd=1.0, kf=2.0, mu=0.4)
    builder.add_ground_plane(cfg=material)
    builder.add_shape_sphere(-1, xform=((0.1, 0.1, 0.0), UPRIGHT), radius=0.2, cfg=material)
    builder.add_cloth_grid(
        pos=(0, 0, 0.2), dim_x=2, dim_y=2, cell_x=0.1, cell_y=0.1, mass=0.02,
        tri_ke=30.0, tri_ka=30.0, tri_kd=0.02, edge_ke=0.1, edge_kd=1e-3, particle_radius=0.02,
    )  # fmt: skip
    builder.add_soft_grid(
        pos=(0.5, 0, 0.0), dim_x=1, dim_y=1, dim_z=1, cell_x=0.1, cell_y=0.1, cell_z=0.1,
        density=100, k_mu=300, k_lambda=300, k_damp=0.1, particle_radius=0.02,
    )  # fmt: skip
    builder.add_spring(8, 9, 20.0, 0.1)
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_kf = 50.0, 1.0, 2.0
    draw = np.random.default_rng(1)
    shift = 5e-3 * draw.normal(size=(model.particle_count, 3))
    model.particle_q.assign(model.particle_q.numpy() + shift.astype(np.float32))
    model.particle_qd.assign(0.3 * draw.normal(size=shift.shape).astype(np.float32))
    return model


def for_vbd(model: novaphy.Model) -> novaphy.Model:
    model.soft_contact_kf = 1000.0
    model.shape_material_kf.assign(0 * model.shape_material_kf.numpy() + 1000.0)
    return model


def actuate(builder: novaphy.ModelBuilder, joints: list[int], links: list[int]) -> None:
    """Actuators of all kinds, at the ends of ranges of all kinds."""
    dynamics = novaphy.ActuatorDynamics
    ranges = dict.fromkeys(("ctrl_range", "force_range", "act_range"), (-5.0, 5.0))
    for joint, options in (
        (0, {"gear": 2.0, "gain": (4.0, 0.0, 0.0), "bias": (0.1, 0.0, 0.0), "ctrl": 0.2,
             "ctrl_range": (-1.0, 0.15), "dynamics": dynamics.FILTER_EXACT, "time": 0.01}),
        (0, {"gain": (2.0, -0.3, -0.2), "bias": (0.1, -3.0, -0.6), "ctrl": 0.3, "gear": -1.2,
             "ctrl_range": (-1.0, 1.0), "force_range": (-1e10, 1e10)}),
        (1, {"gear": -1.5, "ctrl": 0.3, "force_range": (-0.2, 0.1)}),
        (1, {"gear": 0.5, "ctrl": 0.3, "act": 0.4, "dynamics": dynamics.FILTER, "time": 0.02}),
        (1, {"ctrl": 0.3, "act": 0.3, "act_range": (0.2, 0.3005),
             "dynamics": dynamics.INTEGRATOR}),
    ):  # fmt: skip
        builder.add_actuator(joints[joint], **(ranges | options))
    builder.add_body_actuator(
        links[1], frame=((0.1, 0.0, 0.2), UPRIGHT), reference_body=links[0], ctrl=0.3,
        reference=((0.0, 0.1, 0.0), UPRIGHT), wrench=(0.5, 0.3, 1.0, 0.1, 0.2, 0.3),
        gain=(1.0, 0.2, 0.1), bias=(0.1, -2.0, -0.3), **ranges,
    )  # fmt: skip


def bodies(articulated: bool) -> novaphy.Model:
    """A ball, a box and a mesh on a plane, and an arm whose tip, a ball, touches it."""
    builder = novaphy.ModelBuilder()
    material = novaphy.ShapeConfig(ke=500.0, kd=5.0, kf=20.0, mu=0.4, density=300.0)
    light = novaphy.ShapeConfig(ke=500.0, kd=5.0, kf=20.0, mu=0.4, density=0.0)
    builder.add_ground_plane(cfg=material)

    def body(x: float, z: float) -> int:
        return builder.add_body(xform=((x, 0.0, z), UPRIGHT))

    builder.add_shape_sphere(body(0.0, 0.098), radius=0.1, cfg=material)
    builder.add_shape_box(body(1.0, 0.098), hx=0.1, hy=0.08, hz=0.1, cfg=material)
    mesh = body(2.0, 0.098)
    builder.add_shape_mesh(mesh, vertices=0.2 * CORNERS, indices=FACES, cfg=material)
    links = [
        builder.add_link(
            xform=((3.0 + 0.3 * k, 0.0, 0.1), UPRIGHT), mass=1.0, com=(0.1, 0.01, 0.02),
            inertia=np.diag([0.02, 0.03, 0.04]), gravcomp=0.3 * articulated,
        )
        for k in range(2)
    ]  # fmt: skip
    drive = {
        "target_ke": 20.0, "target_kd": 1.0, "target_q": 0.1, "target_qd": 0.1, "damping": 0.2,
        "limit_ke": 30.0, "limit_kd": 1.0, "axis": (0.0, 1.0, 0.0),
    }  # fmt: skip
    if articulated:
        drive |= {"armature": 0.05, "friction": 0.02}
    base = ((3.0, 0.0, 0.1), UPRIGHT)
    joints = [
        # Beyond its upper limit; the second at its effort limit.
        builder.add_joint_revolute(
            -1, links[0], parent_xform=base, limit_lower=-1.0, limit_upper=-0.01, **drive
        ),
        builder.add_joint_revolute(
            links[0], links[1], parent_xform=((0.3, 0, 0), UPRIGHT), effort_limit=0.5, **drive
        ),
    ]
    builder.add_articulation(joints)
    if articulated:
        actuate(builder, joints, links)
        builder.set_fluid(density=3.0, viscosity=0.1, wind=(0.5, -0.3, 0.2))
    tip = ((0.2, 0.0, 0.0), UPRIGHT)
    builder.add_shape_sphere(links[1], xform=tip, radius=0.103, cfg=light)
    model = builder.finalize()
    draw = np.random.default_rng(2)
    free = model.joint_qd.numpy()
    free[:18] = 0.2 * draw.normal(size=18)
    free[18:] = (0.3, -0.2)
    model.joint_qd.assign(free)
    moving = model.body_qd.numpy()
    moving[:3] = free[:18].reshape(3, 6)
    model.body_qd.assign(moving)
    return model


def semi(**options):
    def make(model):
        config = novaphy.solvers.DiffSolverConfig(**options)
        return novaphy.solvers.DiffSemiImplicitSolver(model, config)

    return make


ELEMENTS = {
    "enable_springs": True,
    "enable_triangles": True,
    "enable_bending": True,
    "enable_tetrahedra": True,
}
STATIC = {"enable_static_contacts": True}


def featherstone(model):
    return novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_erp=1.0, pgs_iterations=3000, contact_gradient="code"
    )


def vbd(gradient: str):
    return lambda model: novaphy.solvers.DiffSolverVBD(
        model,
        iterations=30,
        gradient=gradient,
        **({"allow_unconverged": True} if gradient == "implicit" else {}),
    )


SCENES = {
    "semi, particles": Scene(soft, semi(**ELEMENTS), "given", True),
    "semi, static contacts": Scene(soft, semi(**ELEMENTS, **STATIC), "none", True),
    "semi, bodies": Scene(lambda: bodies(False), semi(), "given", True),
    "semi, bodies, pipeline": Scene(lambda: bodies(False), semi(), "found", True),
    "featherstone": Scene(lambda: bodies(True), featherstone, "given", True),
    "featherstone, pipeline": Scene(
        lambda: bodies(True), featherstone, "found", False, follows=("state.body_q",)
    ),
    "featherstone, no contacts": Scene(lambda: bodies(True), featherstone, "none", False),
    "vbd": Scene(lambda: for_vbd(soft()), vbd("unrolled"), "given", True, dt=5e-3),
    "vbd, implicit": Scene(lambda: for_vbd(soft()), vbd("implicit"), "given", True, dt=5e-3),
    "vbd, bodies": Scene(lambda: for_vbd(bodies(False)), vbd("implicit"), "given", True, dt=5e-3),
    "vbd, bodies, pipeline": Scene(
        lambda: for_vbd(bodies(False)), vbd("implicit"), "found", True, dt=5e-3
    ),
}


class Run:
    """The arrays of a rollout, by name, and its loss."""

    def __init__(self, scene: Scene):
        self.scene, self.model = scene, scene.model()
        self.trajectory = diff.Trajectory(self.model, scene.steps)
        self.solver = scene.solver(self.model)
        self.control = self.model.control() if scene.control else None
        self.pipeline = self.contacts = None
        first = self.trajectory[0]
        objects = {"model": self.model, "state": first, "control": self.control}
        if scene.contacts != "none":
            self.pipeline = novaphy.CollisionPipeline(self.model)
        if scene.contacts == "given":
            self.contacts = self.pipeline.contacts()
            self.pipeline.collide(first, self.contacts)
            self.pipeline = None
            objects["contacts"] = self.contacts
        found = {
            f"{owner}.{name}": array
            for owner, thing in objects.items()
            for name in dir(thing)
            if not name.startswith("_")
            and isinstance(array := getattr(thing, name, None), novaphy.DeviceArray)
            and array.size > 0
            and array.numpy().dtype == np.float32
        }
        self.names: dict[int, list[str]] = {}  # names of arrays with the same memory
        for name, array in found.items():
            self.names.setdefault(array.ptr, []).append(name)
        self.arrays = {names[0]: found[names[0]] for names in self.names.values()}

    def final(self):
        self.solver.rollout(
            self.trajectory, self.control, self.contacts, self.scene.dt, pipeline=self.pipeline
        )
        return self.trajectory[self.scene.steps]

    def parts(self, state):
        """The arrays of the last state, their tensors, and weights."""
        draw = np.random.default_rng(7)
        kinds = ("particle", "joint" if "eatherstone" in type(self.solver).__name__ else "body")
        for kind in kinds:
            for name in (f"{kind}_q", f"{kind}_qd"):
                array = getattr(state, name)
                if array.size > 0:
                    size = 0.1 if name.endswith("qd") else 1.0
                    weights = (size * draw.normal(size=array.numpy().shape)).astype(np.float32)
                    yield array, getattr(diff, f"state_{name}_tensor"), weights

    def value(self) -> float:
        state = self.final()
        return sum(float((a.numpy().astype(float) * w).sum()) for a, _, w in self.parts(state))

    def gradient(self, name: str) -> np.ndarray:
        self.arrays[name].requires_grad = True
        with nova.Tape() as tape:
            state = self.final()
            loss = None
            for _, tensor, weights in self.parts(state):
                x = tensor(state)
                term = nova.sum(x * nova.tensor(weights.reshape(x.shape)))
                loss = term if loss is None else loss + term
            if not loss.requires_grad and not len(tape):
                return np.zeros(self.arrays[name].numpy().shape)
            tape.backward(loss)
        return self.arrays[name].grad.numpy().astype(float)


def direction(name: str, values: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """A step of size 1 within symmetric matrices, unit vectors or unit quaternions."""
    way = draw.normal(size=values.shape)
    is_unit = name.endswith(("joint_axis", "normal"))
    if not is_unit and (values >= 0).all() and values.any():
        way *= values  # values stay >= 0
    if name.endswith(("actuator_gain", "actuator_bias")):  # a motor stays one
        way *= values != 0
    if name.endswith("inertia"):
        way = 0.1 * values * (way + np.swapaxes(way, -1, -2)) / np.abs(values).max()
    if values.ndim == 2 and values.shape[1] == 7:  # poses
        q = values[:, 3:]
        way[:, 3:] -= q * np.sum(way[:, 3:] * q, axis=1, keepdims=True)
    if is_unit:
        way -= values * np.sum(way * values, axis=1, keepdims=True)
    if name == "state.joint_q":  # quaternions of free joints
        for k in range(3, 21, 7):
            q = values[k : k + 4]
            way[k : k + 4] -= q * (way[k : k + 4] @ q)
    way = np.where(np.isfinite(way), way, 0.0)  # not in rows without a contact
    return way / np.linalg.norm(way)


def slopes(scene: Scene, name: str, way: np.ndarray) -> list[tuple[float, float]]:
    """Differences along a direction, each with what rounding makes of it."""
    found = []
    is_pose = way.ndim == 2 and way.shape[1] == 7
    for relative in (1e-1, 1e-2, 3e-3, 1e-3):
        ends = []
        for sign in (1, -1):
            run = Run(scene)
            values = run.arrays[name].numpy().astype(float)
            eps = relative * (0.1 if is_pose else max(0.1, float(np.nanmax(np.abs(values)))))
            run.arrays[name].assign((values + sign * eps * way).astype(np.float32))
            ends.append(run.value())
        found.append(((ends[0] - ends[1]) / (2 * eps), 5e-6 / eps))
    return found


@pytest.mark.parametrize("scene", SCENES)
def test_the_gradient_by_every_array_is_right_or_refused_by_name(scene):
    if scene.startswith("vbd") and not novaphy.has_vbd():
        pytest.skip("built with NOVAPHY_BUILD_VBD=OFF")
    draw, wrong, right, refused = np.random.default_rng(3), [], 0, 0
    made = SCENES[scene]
    for name in Run(made).arrays:
        run = Run(made)
        names = run.names[run.arrays[name].ptr]
        if STARTS & set(names) or name in made.follows:
            continue

        def is_by_name(error: Exception, names: list[str] = names) -> bool:
            return any(n.split(".")[1] in str(error) for n in names)

        way = direction(name, run.arrays[name].numpy().astype(float), draw)
        try:
            gradient = float((run.gradient(name) * way)[way != 0].sum())
        except (NotImplementedError, ValueError) as error:
            assert is_by_name(error), (names, error)
            refused += 1
            continue
        try:
            differences = slopes(made, name, way)
        except (NotImplementedError, ValueError) as error:  # a value that is refused has no slope
            assert is_by_name(error), (names, error)
            continue
        errors = [abs(d - gradient) for d, _ in differences]
        bounds = [0.02 * max(abs(d), abs(gradient)) + noise for d, noise in differences]
        if not any(e <= b for e, b in zip(errors, bounds, strict=True)):
            wrong.append((name, gradient, [d for d, _ in differences]))
        right += 1
    assert not wrong, wrong
    assert right > 5 and refused > 5
