"""AntWorlds: a batch of Ant robots, stepped by SolverFeatherstone at the rate of a policy."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import assets, nova
from .._core import CollisionPipeline, Model, ModelBuilder, SimState, eval_fk
from ..solvers import SolverFeatherstone

Array = NDArray[Any]  # float32

# Parameter sets: file, gear (N m per unit of action), lowest torso height of a healthy Ant (m), and
# the hinge that each action drives. Hinges hip_1, ankle_1, hip_2, ... have the numbers 0 to 7.
ANTS: dict[str, tuple[str, float, float, tuple[int, ...]]] = {
    "dva": ("ant_heavy.xml", 200.0, 0.27, (0, 1, 2, 3, 4, 5, 6, 7)),
    "gym": ("ant.xml", 150.0, 0.2, (6, 7, 0, 1, 2, 3, 4, 5)),
}
START_HEIGHT = 0.75  # m, torso height after a reset
START_JOINTS = (0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0)  # rad, hinge angles after a reset
LIMIT_KE, LIMIT_KD = 1e3, 10.0  # N m/rad, N m s/rad: stiffness and damping of hinge limits
HIGHEST = 1.0  # m: the largest torso height of a healthy Ant
OBSERVATIONS, ACTIONS = 111, 8
ACTIONS_LIMIT = 1.0
COORDS, DOFS = 15, 14
FEET = (2, 4, 6, 8)  # indices of the feet's bodies in a world
TIPS = np.array([(0.4, 0.4, 0.0), (-0.4, 0.4, 0.0), (-0.4, -0.4, 0.0), (0.4, -0.4, 0.0)])
TIP_RADIUS = 0.08  # m, radius of the sphere at the tip of a foot
# The parameters of AntWorlds.vary, which may differ between worlds, with their defaults.
VARIED = {
    "friction": 0.75,  # coefficient of friction of feet on the ground
    "mass": 1.0,  # factor of all masses and inertias
    "torso_mass": 1.0,  # additional factor of the torso's mass and inertia
    "gear": 1.0,  # factor of the torques: a number, or one number per action
    "slope": 0.0,  # rad, simulated by tilted gravity over level ground
    "slope_heading": 0.0,  # rad, direction of uphill: the angle from +x about +z
}
# The allowed ranges of parameters. Extreme mass factors would exceed the range of float32.
VARIED_RANGES = {"friction": (0.0, 1e3), "mass": (1e-3, 1e3), "torso_mass": (1e-3, 1e3)}


class AntWorlds:
    """A batch of Ants on the ground, each in its own world.

    The z axis points up. A frame of the policy lasts 1/20 s and has `substeps` steps with contacts.
    An action is the torque of a hinge divided by the gear: 200 N m for `dva`, 150 N m for `gym`.
    Actions are in the order of the file's motors. All arrays are float32, a row per world.

    `q` {worlds, 15} has the torso's position (m) and quaternion xyzw, and the hinge angles hip_1,
    ankle_1, ... (rad). `qd` {worlds, 14} has the torso's velocity (m/s, of the origin) and angular
    velocity (rad/s), both in world axes, and the hinge rates (rad/s).
    """

    def __init__(
        self,
        num_worlds: int = 1,
        *,
        ant: str = "dva",
        seed: int = 0,
        substeps: int = 50,
        noise: float = 0.0,
        device: str | None = None,
        **solver_options: Any,
    ) -> None:
        """Build the worlds and reset all Ants.

        Args:
            num_worlds: number of worlds.
            ant: "dva" (density 1000 kg/m³, 182 kg) or "gym" (density 5 kg/m³, armature 1 kg m²).
            seed: seed of the initial noise.
            substeps: solver steps per frame; 50 means steps of 1 ms.
            noise: resets add uniform noise in +-noise to q, normal noise of this deviation to qd.
            device: device of the simulation (None: the default device). Every device gives the same
                bits. Devices other than the CPU replay a captured frame.
            solver_options: options of SolverFeatherstone.

        Raises:
            ValueError: an argument is out of range.
            ImportError: the build has no readers of robot files.
        """
        if ant not in ANTS:
            raise ValueError(f"ant: expected one of {', '.join(ANTS)}, got {ant!r}")
        for name, value, least in (("num_worlds", num_worlds, 1), ("substeps", substeps, 1)):
            if value < least:
                raise ValueError(f"{name}: expected a number >= {least}, got {value}")
        if not 0.0 <= noise < 1.0:
            raise ValueError(f"noise: expected 0 <= noise < 1, got {noise}")
        file, self.gear, self.lowest, self.hinge_of_action = ANTS[ant]
        self.ant, self.seed, self.noise = ant, seed, noise
        self.num_worlds, self.substeps, self.dt = num_worlds, substeps, 0.05 / substeps
        self.model = build_ants(file, num_worlds, device=device)
        self.solver_options = {"angular_damping": 0.0, **solver_options}
        self.solver = SolverFeatherstone(self.model, **self.solver_options)
        self.pipeline = CollisionPipeline(self.model)
        self.contacts, self.control = self.pipeline.contacts(), self.model.control()
        self.state, self._after = self.model.state(), self.model.state()
        self._starts = self.model.state()  # the state after a reset
        self._replays = not self.model.device.is_cpu
        self._graphs: dict[int, nova.Graph] = {}  # captured frame, by id of its first state
        self._masses = self.model.body_mass.numpy().reshape(num_worlds, -1)
        self._inertias = self.model.body_inertia.numpy().reshape(num_worlds, -1, 3, 3)
        self._gravity = float(np.abs(self.model.gravity.numpy()).max())
        self.varied = {
            name: np.full(
                (num_worlds, ACTIONS) if name == "gear" else num_worlds, value, np.float32
            )
            for name, value in VARIED.items()
        }
        self.frame, self._resets = np.zeros(num_worlds, np.int64), 0  # frame: count since reset
        self.reset()

    @property
    def total_mass(self) -> float:
        """The mass of an unmodified Ant (kg)."""
        return float(self._masses[0].sum())

    @property
    def q(self) -> Array:
        """A copy of the joint coordinates {worlds, 15}."""
        return self.state.joint_q.numpy().reshape(self.num_worlds, COORDS)

    @property
    def qd(self) -> Array:
        """A copy of the joint rates {worlds, 14}."""
        return self.state.joint_qd.numpy().reshape(self.num_worlds, DOFS)

    def set_state(self, q: ArrayLike, qd: ArrayLike, frame: ArrayLike = 0) -> None:
        """Set the coordinates q {worlds, 15} and rates qd {worlds, 14} of all Ants.

        Contact impulses of the solver are cleared.

        Raises:
            ValueError: another shape, or numbers that are not finite.
        """
        for name, value, width in (("q", q, COORDS), ("qd", qd, DOFS)):
            rows = np.asarray(value, np.float32)
            if rows.shape != (self.num_worlds, width) or not np.isfinite(rows).all():
                raise ValueError(
                    f"{name}: expected {{{self.num_worlds}, {width}}} finite numbers, "
                    f"got {rows.shape}"
                )
        self._write(np.asarray(q, np.float32), np.asarray(qd, np.float32), self.state)
        self._forget()
        self.frame[:] = frame

    def _forget(self) -> None:
        """Make the solver read the model again and clear its contact impulses."""
        self.solver.notify_model_changed(0)
        self._graphs.clear()  # a graph replays the parameter values of its capture

    def _write(self, q: Array, qd: Array, state: SimState) -> None:
        state.joint_q.assign(np.ascontiguousarray(q).ravel())
        state.joint_qd.assign(np.ascontiguousarray(qd).ravel())
        eval_fk(self.model, state.joint_q, state.joint_qd, state)

    def reseed(self, seed: int) -> None:
        """Use another seed for later resets."""
        self.seed, self._resets = seed, 0

    def start(self) -> tuple[Array, Array]:
        """Return q {worlds, 15} and qd {worlds, 14} that the next reset gives each world."""
        q = np.tile(
            np.array([0, 0, START_HEIGHT, 0, 0, 0, 1, *START_JOINTS], np.float32),
            (self.num_worlds, 1),
        )
        qd = np.zeros((self.num_worlds, DOFS), np.float32)
        if self.noise > 0.0:
            rng = np.random.Generator(np.random.Philox(key=[self.seed, self._resets]))
            q[:, 3:] += rng.uniform(-self.noise, self.noise, (self.num_worlds, 12))
            q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
            qd += self.noise * rng.standard_normal(qd.shape)
        return q, qd

    def reset(self, worlds: ArrayLike | None = None) -> Array:
        """Reset Ants and return the observations {worlds, 111} of all Ants.

        Args:
            worlds: a mask {worlds}. None: reset all, and clear the solver's contact impulses.
        """
        mask = np.ones(self.num_worlds, bool) if worlds is None else np.asarray(worlds, bool)
        if mask.shape != (self.num_worlds,):
            raise ValueError(
                f"worlds: expected {{{self.num_worlds}}} truth values, got {mask.shape}"
            )
        if worlds is None or mask.any():
            q, qd = self.start()
            self._resets += 1
            self.frame[mask] = 0
            # The masked rows are copied on the device, so all other worlds keep their bits.
            self._write(q, qd, self._starts)
            begins = nova.tensor(mask.astype(np.int32)[:, None], device=self.model.device)
            for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
                start, now = (
                    nova.from_device_array(getattr(state, name)).reshape(self.num_worlds, -1)
                    for state in (self._starts, self.state)
                )
                now.copy_(nova.where(begins, start, now))
            if worlds is None:
                self._forget()
        return self.observations()

    def vary(self, **values: ArrayLike) -> None:
        """Change parameters of the worlds, such as `friction`, `mass`, `torso_mass` and `slope`.

        Args:
            values: a number per name, or one number per world; `gear` may be {worlds, 8}.

        Raises:
            ValueError: an unknown name, another shape, or numbers out of range. Nothing is changed.
        """
        changed = {}
        for name, value in values.items():
            if name not in VARIED:
                raise ValueError(f"vary: expected names of {', '.join(VARIED)}, got {name!r}")
            rows = np.asarray(value, np.float32)
            to = self.varied[name]
            if name == "gear" and rows.ndim == 1 and rows.shape == (self.num_worlds,):
                rows = rows[:, None]
            try:
                changed[name] = np.broadcast_to(rows, to.shape)
            except ValueError:
                raise ValueError(
                    f"{name}: expected {to.shape} or a number, got {rows.shape}"
                ) from None
            check_varied(name, rows)
        for name, rows in changed.items():
            self.varied[name][...] = rows
        if "friction" in values:
            mu = self.model.shape_material_mu.numpy().reshape(self.num_worlds, -1)
            mu[:] = self.varied["friction"][:, None]
            self.model.shape_material_mu.assign(mu.ravel())
        if "mass" in values or "torso_mass" in values:
            factor = np.repeat(self.varied["mass"][:, None], self._masses.shape[1], axis=1)
            factor[:, 0] *= self.varied["torso_mass"]
            self.model.body_mass.assign((self._masses * factor).ravel())
            inertia = self._inertias * factor[..., None, None]
            self.model.body_inertia.assign(inertia.reshape(-1, 3, 3))
        if "slope" in values or "slope_heading" in values:
            slope, heading = self.varied["slope"], self.varied["slope_heading"]
            down = [
                -np.sin(slope) * np.cos(heading),
                -np.sin(slope) * np.sin(heading),
                -np.cos(slope),
            ]
            self.model.gravity.assign(np.float32(self._gravity * np.stack(down, axis=1)))
        self._forget()

    def joint_forces(self, actions: ArrayLike) -> Array:
        """Return joint forces {worlds, 14} (N m) of actions {worlds, 8}, clipped to +-1."""
        a = np.asarray(actions, np.float32)
        if a.shape != (self.num_worlds, ACTIONS):
            raise ValueError(f"actions: expected {{{self.num_worlds}, {ACTIONS}}}, got {a.shape}")
        if not np.isfinite(a).all():
            world = int(np.flatnonzero(~np.isfinite(a).all(axis=1))[0])
            raise ValueError(f"actions: expected finite numbers, got {a[world]} in world {world}")
        forces = np.zeros((self.num_worlds, DOFS), np.float32)
        columns = 6 + np.array(self.hinge_of_action)
        forces[:, columns] = self.gear * self.varied["gear"] * np.clip(a, -1.0, 1.0)
        return forces

    def step(
        self,
        actions: ArrayLike,
        *,
        push: ArrayLike | None = None,
        each: Callable[[int, SimState], None] | None = None,
    ) -> None:
        """Step all worlds by one frame of 1/20 s.

        Args:
            actions: {worlds, 8}, constant over the frame.
            push: force on the torso during the frame, {worlds, 3} (N, world axes).
            each: called after every substep with the index of the substep and the state.
        """
        forces = self.joint_forces(actions)
        if push is not None:
            force = np.asarray(push, np.float32)
            if force.shape != (self.num_worlds, 3) or not np.isfinite(force).all():
                raise ValueError(
                    f"push: expected {{{self.num_worlds}, 3}} finite numbers, got {force.shape}"
                )
            forces[:, :3] = force
        self.control.joint_f.assign(forces.ravel())
        if self._replays and each is None:
            self._replay()
        else:
            self._run(each)
        self.frame += 1

    def _run(self, each: Callable[[int, SimState], None] | None = None) -> None:
        """Run the substeps of a frame."""
        for k in range(self.substeps):
            self.pipeline.collide(self.state, self.contacts)
            self.solver.step(self.state, self._after, self.control, self.contacts, self.dt)
            self.state, self._after = self._after, self.state
            if each is not None:
                each(k, self.state)

    def _replay(self) -> None:
        """Run the substeps of a frame by a captured graph. The first call captures the graph."""
        begins = id(self.state)
        if begins not in self._graphs:
            with nova.ScopedCapture() as capture:
                self._run()
            self._graphs[begins] = capture.graph
        elif self.substeps % 2:
            self.state, self._after = self._after, self.state
        self._graphs[begins].launch()
        self.solver.check_last_step()

    def observations(self) -> Array:
        """Return the observations of Gymnasium's Ant-v3, {worlds, 111}.

        The columns are torso height (m); quaternion w x y z; hinge angles (rad); velocity (world
        axes); angular velocity (body axes); hinge rates; and 84 zeros for contact forces.
        """
        return observations(self.q, self.qd)

    def healthy(self) -> NDArray[np.bool_]:
        """Return {worlds}: whether the state is finite and the torso height in its range."""
        q, qd = self.q, self.qd
        finite = np.isfinite(q).all(axis=1) & np.isfinite(qd).all(axis=1)
        return finite & (q[:, 2] >= self.lowest) & (q[:, 2] <= HIGHEST)


def check_varied(name: str, values: ArrayLike) -> None:
    """Raise ValueError for values of `AntWorlds.vary` that are not finite or out of range."""
    rows = np.asarray(values, np.float32)
    least, most = VARIED_RANGES.get(name, (-np.inf, np.inf))
    good = np.isfinite(rows) & (rows >= least) & (rows <= most)
    if not good.all():
        wanted = f" from {least:g} to {most:g}" if name in VARIED_RANGES else ""
        raise ValueError(f"{name}: expected finite numbers{wanted}, got {rows[~good].ravel()[0]}")


def build_ants(
    file: str, num_worlds: int, requires_grad: bool = False, device: str | None = None
) -> Model:
    """Build Ants from a file of `novaphy.assets`, each in its own world with its own ground."""
    one, many = ModelBuilder(), ModelBuilder()
    one.add_mjcf(assets.path(file))
    many.replicate(one, num_worlds)
    model = many.finalize(device, requires_grad=requires_grad)
    for array, value in ((model.joint_limit_ke, LIMIT_KE), (model.joint_limit_kd, LIMIT_KD)):
        numbers = array.numpy().reshape(num_worlds, DOFS)
        numbers[:, 6:] = value
        array.assign(numbers.ravel())
    for of_mujoco in (model.shape_mixing, model.shape_margin):  # MuJoCo fields, unused by D.VA
        of_mujoco.fill_(0.0)
    return model


def observations(q: Array, qd: Array) -> Array:
    """Return the observations {n, 111} (AntWorlds.observations) of q {n, 15} and qd {n, 14}."""
    out = np.zeros((len(q), OBSERVATIONS), np.float32)
    out[:, 0], out[:, 1], out[:, 2:5] = q[:, 2], q[:, 6], q[:, 3:6]
    out[:, 5:13], out[:, 13:16] = q[:, 7:], qd[:, :3]
    out[:, 16:19] = rotate_back(q[:, 3:7], qd[:, 3:6])
    out[:, 19:27] = qd[:, 6:]
    return out


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products a x b {..., 3}; faster than np.cross for few rows."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return out


def rotate(quaternion: Array, v: Array) -> Array:
    """Rotate vectors {n, 3} by quaternions xyzw."""
    u, w = quaternion[..., :3], quaternion[..., 3:]
    return v + 2.0 * _cross(u, _cross(u, v) + w * v)


def rotate_back(quaternion: Array, v: Array) -> Array:
    """Rotate vectors {n, 3} by the inverses of quaternions xyzw."""
    u, w = quaternion[..., :3], quaternion[..., 3:]
    return v + 2.0 * _cross(u, _cross(u, v) - w * v)


def feet(state: SimState, num_worlds: int) -> tuple[Array, Array, Array]:
    """Return tip centers {worlds, 4, 3} (m); heights, velocities of the tips' lowest points."""
    poses = state.body_q.numpy().reshape(num_worlds, -1, 7)[:, FEET]
    rates = state.body_qd.numpy().reshape(num_worlds, -1, 6)[:, FEET]
    arm = rotate(poses[..., 3:], np.broadcast_to(TIPS.astype(np.float32), poses[..., :3].shape))
    tip = poses[..., :3] + arm
    # The vector from the center of mass (half way to the tip) to the lowest point of the tip.
    offset = 0.5 * arm - np.array([0.0, 0.0, TIP_RADIUS], np.float32)
    speed = rates[..., :3] + np.cross(rates[..., 3:], offset)
    return tip, tip[..., 2] - TIP_RADIUS, speed


def asset_hash(ant: str) -> str:
    """Return the first 16 digits of the SHA-256 hash of a parameter set's file."""
    return hashlib.sha256(assets.path(ANTS[ant][0]).read_bytes()).hexdigest()[:16]


def check_meta(path: str, meta: Mapping[str, Any], ant: str) -> None:
    """Check that a policy belongs to an Ant.

    Raises:
        ValueError: meta names no Ant, another Ant, or another version of its file.
    """
    if meta.get("ant") != ant:
        raise ValueError(f"{path}: expected a policy of the Ant {ant!r}, got {meta.get('ant')!r}")
    asset = meta.get("asset", asset_hash(ant))
    if asset != asset_hash(ant):
        raise ValueError(
            f"{path}: expected a policy of {ANTS[ant][0]} with hash {asset_hash(ant)}, "
            f"got one of {asset}"
        )
