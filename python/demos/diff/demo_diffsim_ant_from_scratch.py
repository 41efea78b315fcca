"""Teach an Ant of 182 kg to walk from zero: 80 parameters, analytic gradients, a search at the end.

The actor computes 8 torques 20 times per second. A torque is the tanh of the dot product of 10
weights and 10 features of the hinge. The features are 1 and two harmonics of a phase, the tilt of
the torso towards the leg, and the angle and rate of the hinge. Two more features are the torso's
height and velocity for an ankle, and the torso's y and heading for a hip. All weights start at 0.

At first a servo at the hinges leads the Ant through a trot (ant_objective.py). The servo becomes
weaker from stage to stage, until the actor walks without it. To compute derivatives, all frames of
a rollout run in parallel, as worlds of one batch. From the derivatives follow the gradient and the
Gauss-Newton matrix of segments, summed over the horizon. A step is kept only if the regular solver
measures a lower loss over the whole horizon. All candidates of a step also run as one batch. At the
end the demo prints each bound of the gait with the measured value (docs/guide/trained-policy.md).

    python demo_diffsim_ant_from_scratch.py
    python demo_diffsim_ant_from_scratch.py --headless 600 --out gait.npz
    python demo_diffsim_ant_from_scratch.py --load gait.npz --headless 600  # 1 if a check fails
    python demo_diffsim_ant_from_scratch.py --load gait.npz --record gait.html
    python demo_diffsim_ant_from_scratch.py --load gait.npz --headless 600 --robustness 100
    python demo_diffsim_ant_from_scratch.py --start gait.npz --stages stride --out heading.npz
    python demo_diffsim_ant_from_scratch.py --random-search --seconds 300
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from ant_common import DATA, FPS, GaitMeter, make_stage, provenance, tilt
from ant_gradients import frame_jacobians, make_frames
from ant_objective import (
    ANKLE,
    ANKLE_SIGN,
    FAST,
    FREE,
    PERIOD,
    SIDES,
    SPEED,
    WEIGHTS,
    Servo,
    axis,
    phase,
    residuals,
)
from ant_polish import CANDIDATES as POLISHED
from ant_polish import FLOORS, FRAMES, GENERATIONS, polish
from ant_robustness import NAMES as ALL
from ant_robustness import Disturbances
from demo_common import run, save_figure, verdict

from novaphy import nova, viewer
from novaphy.envs import ACTIONS, AntWorlds, asset_hash, check_meta

GAIT = DATA / "periodic_ant_natural_gait.npz"
FEATURES = 10
HEIGHT = 0.61  # m, torso height of a walking Ant
WAVES = ("1", "sin p", "cos p", "sin 2p", "cos 2p")
# Ankles have the torso's height and velocity as features, hips the torso's y and heading.
NAMES = (*WAVES, "height/y", "velocity/heading", "tilt", "angle", "rate")
# The factors of the features after the waves, for hips and ankles in turn.
SCALE = np.array([[1.0, 3.0, 5.0, 2.0, 0.2], [5.0, 1.0, 5.0, 2.0, 0.2]] * 4)
ANGLES = ANKLE * np.stack([0.0 * ANKLE_SIGN, ANKLE_SIGN], axis=1).ravel()  # rad, in the stance
OUTWARD = np.repeat(SIDES / np.sqrt(2.0), 2, axis=0)  # direction of the leg of each hinge {8, 2}
# The decreasing strengths of the servo, and the stages (name, frames, iterations, strength).
STRENGTHS = (
    0.75, 0.6, 0.5, 0.42, 0.35, 0.28, 0.22, 0.17, 0.13,
    0.1, 0.075, 0.055, 0.04, 0.028, 0.018, 0.01, 0.004,
)  # fmt: skip
STAGES = (
    ("stand", 20, 5, 1.0),
    *((str(frames), frames, 5, 1.0) for frames in (4, 8, 12, 16, 24, 36)),
    ("60", 60, 10, 1.0),
    *((f"400-{strength}", 400, 3, strength) for strength in STRENGTHS),
    ("400", 400, 12, 0.0),
)
TROTS = {"stand": 0.0}  # stage -> scale of the strides; 1 in all other stages
# Stages of `polish` -> desired distance in FRAMES frames (m). "stride" runs on request only.
POLISH = {"polish": 1.3, "stride": 4.1}
# The stages for --variants, in the form of STAGES.
HEADING = (("heading", 200, 8, 0.0),)
TRAINED_ON = 10_000  # the first seed of training worlds; tests use other seeds
SMALL = 1e-3  # weight of the actor's squared weights in the loss (regularization)
LENGTHS = (4, 8, 16)  # segment lengths (frames); each length gives candidates for a step
CLIP = 2.0  # largest norm of a step of the weights
DAMPING = 10.0 ** np.linspace(-3.5, 3.0, 8)  # Levenberg damping, relative to the largest curvature
SHORTEST = 0.05  # smallest factor by which a step is shortened after failures
CANDIDATES = len(LENGTHS) * len(DAMPING)
ROWS_AT_ONCE = 256  # rows (frames times worlds) for which the loss is computed at once
FALLEN = 50.0  # loss per frame of an Ant that has fallen
CONTACTS = {"pgs_slop": 5e-4}  # m, overlap of feet and ground that the solver leaves


def make_worlds(count: int, ant: str) -> AntWorlds:
    """Make worlds of Ants with the contact options of this demo."""
    return AntWorlds(count, ant=ant, **CONTACTS)


class Actor:
    """80 weights {8, 10} and the features of the actor, with their derivatives."""

    def __init__(self, weights: np.ndarray | None = None) -> None:
        """Take weights {8, 10}; None: zeros."""
        self.weights = np.zeros((ACTIONS, FEATURES)) if weights is None else weights

    def features(self, q: np.ndarray, qd: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """Return the features {n, 8, 10} of the hinges, in the order of NAMES (see there), for
        coordinates q {n, 15}, rates qd {n, 14} and frames {n}."""
        q, qd = q.astype(np.float64), qd.astype(np.float64)
        p = np.broadcast_to(phase(frame), (len(q),))
        out = np.empty((len(q), ACTIONS, FEATURES))
        waves = [np.ones_like(p), np.sin(p), np.cos(p), np.sin(2 * p), np.cos(2 * p)]
        out[:, :, :5] = np.stack(waves, axis=1)[:, None]
        out[:, 0::2, 5], out[:, 0::2, 6] = q[:, 1:2], axis(q, 0)[:, 1:2]
        out[:, 1::2, 5], out[:, 1::2, 6] = q[:, 2:3] - HEIGHT, qd[:, :1] - SPEED
        out[:, :, 7] = axis(q, 2)[:, :2] @ OUTWARD.T
        out[:, :, 8], out[:, :, 9] = q[:, 7:] - ANGLES, qd[:, 6:]
        out[:, :, 5:] *= SCALE
        return out

    def feature_jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the derivatives of the features by tangents and rates {n, 8, 10, 28}."""
        out = np.zeros((len(q), ACTIONS, FEATURES, 28))
        out[:, 0::2, 5, 1] = out[:, 1::2, 5, 2] = out[:, 1::2, 6, 14] = 1.0
        out[:, 0::2, 6, 3:6] = np.cross(axis(q, 0), np.eye(3)[1])[:, None]
        turned = np.stack([np.cross(axis(q, 2), np.eye(3)[k]) for k in range(2)], axis=1)
        out[:, :, 7, 3:6] = np.einsum("ak,nks->nas", OUTWARD, turned)
        hinge = np.arange(ACTIONS)
        out[:, hinge, 8, 6 + hinge] = out[:, hinge, 9, 20 + hinge] = 1.0
        out[:, :, 5:] *= SCALE[..., None]
        return out

    def act(self, features: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Return actions {n, 8}. Weights {n, 8, 10}: one set per row; None: the actor's weights."""
        w = self.weights if weights is None else weights
        return np.tanh((w * features).sum(axis=-1))


class Trainer:
    """Gradient steps on an actor over a horizon."""

    def __init__(
        self,
        actor: Actor,
        kind: str,
        ant: str,
        verbose: bool = False,
        candidates: int = CANDIDATES,
        variants: int = 0,
    ) -> None:
        """Prepare a training with the gradient of the kind "frozen" or "exact". `variants` is the
        number of worlds with random parameters and pushes; 0: a single world without changes."""
        self.actor, self.kind, self.ant, self.verbose = actor, kind, ant, verbose
        self.variants = max(1, variants)
        self.search = make_worlds(candidates * self.variants, ant)
        seeds = np.tile(TRAINED_ON + np.arange(self.variants), candidates)
        self.disturbed = Disturbances(self.search, seeds, ALL if variants else ())
        self.servo = Servo(self.search)
        self.frames = {}
        self.weights, self.trot = FREE, 1.0
        self.label = ""
        self.losses: list[float] = []

    def rollouts(self, weights: np.ndarray, horizon: int):
        """Simulate weights {n, 8, 10} over a horizon. Return the losses {n}, and the states and
        actions of every frame {horizon, n, variants, ...}."""
        ants, n = self.search, self.search.num_worlds
        weights = np.repeat(weights, self.variants, axis=0)
        ants.reset()
        alive, upright, kept = np.ones(n, bool), [], []
        for k in range(horizon):
            frame = np.full(n, k)
            q, qd = ants.q, ants.qd
            a = self.actor.act(self.actor.features(q, qd, frame), weights)
            kept.append((q, qd, a))
            self.servo.lead(frame, 0)
            # After a substep the servo sets the targets of the next substep.
            ants.step(
                a,
                push=self.disturbed.push(k),
                each=lambda s, _, frame=frame: self.servo.lead(frame, s + 1),
            )
            alive = alive & ants.healthy()
            upright.append(alive)
        kept = [np.stack(x) for x in zip(*kept, strict=True)]
        squares = self.squares(*kept, (ants.q, ants.qd))
        total = sum(np.where(upright, squares, FALLEN))
        total = total / horizon + SMALL * (weights**2).sum(axis=(1, 2))
        total = np.nan_to_num(total, nan=1e9).reshape(-1, self.variants).mean(axis=1)
        return total, [x.reshape(horizon, len(total), self.variants, -1) for x in kept]

    def squares(self, q: np.ndarray, qd: np.ndarray, a: np.ndarray, end) -> np.ndarray:
        """Return the sums of squared residuals {horizon, n} at the ends of frames. The arrays are
        values {horizon, n, ...} at the starts of frames; `end` has those after the last frame."""
        horizon, n = a.shape[:2]
        q, qd = (np.concatenate([x[1:], x_end[None]]) for x, x_end in zip((q, qd), end))
        last = np.concatenate([np.zeros((1, n, ACTIONS)), a[:-1]])
        frame = np.broadcast_to(np.arange(horizon)[:, None, None], (horizon, n, 1))
        sums, count = np.empty((horizon, n)), max(1, ROWS_AT_ONCE // n)
        for k in range(0, horizon, count):
            rows = slice(k, k + count)
            flat = (x[rows].reshape(-1, x.shape[-1]) for x in (q, qd, a, last, frame))
            q_, qd_, a_, last_, frame_ = flat
            r = residuals(q_, qd_, a_, last_, frame_[:, 0], self.weights, self.trot)[0]
            sums[rows] = (r**2).sum(axis=1).reshape(-1, n)
        return sums

    def gradients(self, q: np.ndarray, qd: np.ndarray, a: np.ndarray, variant: int = 0):
        """Return a gradient {80} and a Gauss-Newton matrix {80, 80} for each segment length. Both
        are sums over segments that begin in every frame, for the loss of one variant with the
        rollout {horizon, ...}. The derivatives leave out pushes."""
        actor, n = self.actor, len(q)
        if n not in self.frames:
            frames = make_frames(make_worlds(n, self.ant), self.kind)
            self.frames = {n: (frames, Servo(frames.ants))}
        (frames, servo), at = self.frames[n], np.arange(n)
        changes = {name: rows[variant] for name, rows in self.disturbed.changes.items()}
        if changes:
            frames.vary(**changes)
        servo.set(self.servo.strength, self.trot)
        frames.lead = lambda substep: servo.lead(at, substep)
        by_state, by_action = frame_jacobians(frames, q, qd, a)
        before = np.concatenate([np.zeros((1, ACTIONS)), a[:-1]])
        ends = frames.ants.q, frames.ants.qd
        r, r_state, r_action = residuals(*ends, a, before, at, self.weights, self.trot)
        self.label = frames.label()
        slope = 1.0 - a**2
        # Derivatives of actions by states, and by weights.
        of_state = np.einsum(
            "na,af,nafs->nas", slope, actor.weights, actor.feature_jacobian(q), optimize=True
        )
        direct = np.einsum("na,ab,naf->nabf", slope, np.eye(ACTIONS), actor.features(q, qd, at))
        direct = direct.reshape(n, ACTIONS, -1)
        # The products take most of the time, so they are in single precision.
        r, by_state, by_action, of_state, direct, r_state, r_action = map(
            np.float32, (r, by_state, by_action, of_state, direct, r_state, r_action)
        )
        gradient, matrix, found = np.zeros(80), np.zeros((80, 80)), []
        change = np.zeros((n, 28, 80), np.float32)  # derivative of the state by the weights
        last = np.zeros((n, ACTIONS, 80), np.float32)
        lengths = {min(length, n) for length in LENGTHS}
        for step in range(max(lengths)):
            rows = slice(step, n)  # the frames that are number `step` in some segment
            action = direct[rows] + of_state[rows] @ change[: n - step]
            change = by_state[rows] @ change[: n - step] + by_action[rows] @ action
            j = r_state[rows] @ change + r_action[rows] @ (action - last[: n - step])
            last = action
            flat = j.reshape(-1, 80)
            gradient += r[rows].ravel() @ flat
            matrix += flat.T @ flat
            if step + 1 in lengths:
                found.append((gradient / (n * (step + 1)), matrix / (n * (step + 1))))
        return found

    def steps(self, q: np.ndarray, qd: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return steps of the weights {CANDIDATES, 8, 10}: one for each length and damping. Steps
        are repeated if the horizon is shorter than some lengths."""
        steps = []
        of_all = [self.gradients(q[:, v], qd[:, v], a[:, v], v) for v in range(self.variants)]
        for found in zip(*of_all, strict=True):
            g, matrix = (np.mean(x, axis=0) for x in zip(*found, strict=True))
            g = g + SMALL * self.actor.weights.ravel()
            values, vectors = np.linalg.eigh(matrix + SMALL * np.eye(80))
            for damping in DAMPING * max(values[-1], 1e-12):
                step = vectors @ ((vectors.T @ g) / (np.maximum(values, 0.0) + damping))
                steps.append(step / max(1.0, np.linalg.norm(step) / CLIP))
        return np.resize(steps, (CANDIDATES, ACTIONS, FEATURES))

    def enter(self, name: str, strength: float) -> None:
        """Set the strength of the servo and the weights of the loss for a stage."""
        self.trot = TROTS.get(name, 1.0)
        self.servo.set(strength, self.trot)
        self.weights = WEIGHTS if strength > 0.0 else FREE if self.variants == 1 else FAST

    def stage(
        self, name: str, horizon: int, iterations: int, strength: float, until: float
    ) -> float:
        """Run the iterations of a stage. Return the share of iterations that lowered the loss.
        After a failed step the next one is shorter; after three failures the stage ends."""
        actor, accepted, tried = self.actor, 0, 0
        self.enter(name, strength)
        losses, kept = self.rollouts(np.tile(actor.weights, (CANDIDATES, 1, 1)), horizon)
        first = before = losses[0]
        kept, scale, steps = [x[:, 0] for x in kept], 1.0, None
        for k in range(iterations):
            if time.perf_counter() > until or scale < SHORTEST:
                break
            steps = self.steps(*kept) if steps is None else steps
            candidates = actor.weights - scale * steps
            losses, found = self.rollouts(candidates, horizon)
            best = int(np.argmin(losses))
            tried += 1
            if self.verbose:
                print(f"    {name} {k}: {before:.4f} -> {losses[best]:.4f} ({best})", flush=True)
            if losses[best] < before:
                actor.weights, before = candidates[best], losses[best]
                kept, steps = [x[:, best] for x in found], None
                accepted, scale = accepted + 1, min(1.0, 3.0 * scale)
            else:
                scale *= 0.3
            self.losses.append(before)
        print(
            f"stage {name}: {horizon} frames, {accepted} of {tried} steps accepted, loss "
            f"{first:.4f} -> {before:.4f}, gradient: {self.label}",
            flush=True,
        )
        return accepted / max(tried, 1) if tried else 1.0


def search_stage(
    trainer: Trainer, rng: np.random.Generator, stage: tuple[str, int, int, float], seconds: float
) -> list[float]:
    """Search weights at random, for some seconds of processor time and at least one batch, with
    Gaussian steps of adaptive width. Return the loss after each batch."""
    name, horizon, _, strength = stage
    actor, n, losses = trainer.actor, trainer.search.num_worlds, []
    until, width = time.process_time() + seconds, 0.1
    trainer.enter(name, strength)
    best = trainer.rollouts(np.tile(actor.weights, (n, 1, 1)), horizon)[0][0]
    while not losses or time.process_time() < until:
        candidates = actor.weights + width * rng.standard_normal((n, ACTIONS, FEATURES))
        found, _ = trainer.rollouts(candidates, horizon)
        k = int(np.argmin(found))
        width *= 1.3 if found[k] < best else 0.9
        if found[k] < best:
            best, actor.weights = found[k], candidates[k]
        losses.append(best)
    return losses


def search_rng(seed: int, stage: int = 0) -> np.random.Generator:
    """Return the random generator of the random search, for a seed and a stage."""
    return np.random.Generator(np.random.Philox(key=[seed, 9], counter=[0, 0, 0, stage]))


def validate(
    actor: Actor,
    ants: AntWorlds,
    frames: Iterable[int],
    each: Callable[[int, AntWorlds], None] | None = None,
    push: Callable[[int], np.ndarray | None] = lambda _: None,
    weights: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Play the actor, or weights {worlds, 8, 10}, in all worlds. Return measures of the gait."""
    ants.reset()
    meter = GaitMeter(ants)
    alive = np.ones(ants.num_worlds, bool)
    drift = np.zeros(ants.num_worlds)
    path = [ants.q]
    for k, _ in enumerate(frames):
        q, qd = ants.q, ants.qd
        a = actor.act(actor.features(q, qd, k), weights)
        ants.step(a, push=push(k), each=meter)
        meter.end_frame()
        alive &= ants.healthy()
        drift = np.maximum(drift, np.abs(ants.q[:, 1]))
        path.append(ants.q)
        if each is not None:
            each(k, ants)
    result = meter.result()
    count = min(PERIOD, len(path) - 1)
    return {
        **result,
        "upright": alive & (np.degrees(tilt(ants.q)) < 45.0),
        "distance": ants.q[:, 0],
        "drift": drift,
        "velocity": (ants.q[:, 0] - path[-count - 1][:, 0]) / max(count / FPS, 1e-9),
        "touchdowns": result["touchdown_rate"] * PERIOD / FPS,
        "path": np.array(path),
    }


def polished(
    actor: Actor, stage: str, ant: str, seed: int, generations: int, until: float = np.inf
) -> list[float]:
    """Improve the actor's weights by `polish`. Return the best `excess` of every generation."""
    ants = make_worlds(POLISHED * len(FLOORS), ant)
    ants.vary(friction=np.tile(FLOORS, POLISHED))

    def play(weights: np.ndarray) -> dict[str, np.ndarray]:
        rows = np.repeat(weights, len(FLOORS), axis=0)
        return validate(actor, ants, range(FRAMES), weights=rows)

    actor.weights, lacks = polish(play, actor.weights, POLISH[stage], seed, generations, until)
    if lacks:
        better = sum(x < min(lacks[:k]) for k, x in enumerate(lacks) if k)
        print(
            f"stage {stage}: {FRAMES} frames on {len(FLOORS)} floors, {better} of {len(lacks)} "
            f"generations found less, lacks {lacks[0]:.3f} -> {min(lacks):.3f}, no gradient",
            flush=True,
        )
    return lacks


def checks_of(result: dict[str, np.ndarray], ratio: float) -> dict[str, tuple[bool, str]]:
    """Return the checks of a gait over 600 frames: name -> (passed, measured value as text)."""
    r = {k: v[0] for k, v in result.items() if k != "path"}
    touch = r["touchdowns"]
    return {
        "upright": (bool(r["upright"]), str(bool(r["upright"]))),
        "more than 0.792 m": (r["distance"] > 0.792, f"{r['distance']:.3f} m"),
        "lateral drift below 0.253 m": (r["drift"] < 0.253, f"{r['drift']:.3f} m"),
        "tilt below 5.32 degrees": (r["tilt"] < 5.32, f"{r['tilt']:.2f} degrees"),
        "a final velocity above 0": (r["velocity"] > 0.0, f"{r['velocity']:.3f} m/s"),
        "0.5 to 2 touchdowns of each foot per period": (
            bool(np.all((touch >= 0.5) & (touch <= 2.0))), f"{np.round(touch, 2)}"),
        "swing clearance of 2 cm": (r["clearance"] >= 0.02, f"{100 * r['clearance']:.1f} cm"),
        "slip below 20 % of the distance": (r["slip"] < 0.2, f"{r['slip']:.0%}"),
        "no foot below -5 mm": (r["lowest"] > -5e-3, f"{1e3 * r['lowest']:.1f} mm"),
        "joints in range (5 degrees of the limits' springs)": (
            r["excess"] < np.radians(5.0), f"{np.degrees(max(r['excess'], 0)):.1f} degrees beyond"),
        "at most half the distance lost between friction 0.5 and 1.2": (
            ratio >= 0.5, f"the shorter is {ratio:.0%} of the longer"),
    }  # fmt: skip


def friction_ratio(actor: Actor, ant: str, frames: int) -> float:
    """Return the shorter of the distances at friction 0.5 and 1.2, divided by the longer one."""
    ants = make_worlds(2, ant)
    ants.vary(friction=[0.5, 1.2])
    distance = validate(actor, ants, range(frames))["distance"]
    return float(max(distance.min(), 0.0) / max(distance.max(), 1e-6))


def robustness(actor: Actor, ant: str, seeds: int, frames: int) -> float:
    """Print how disturbed Ants walk (ant_robustness.py). Return the share that stays upright."""
    parts = [(), *((name,) for name in ALL), ALL]
    upright = np.ones(1)
    for names in parts:
        ants = make_worlds(seeds if names else 1, ant)
        result = validate(
            actor, ants, range(frames), push=Disturbances(ants, np.arange(len(ants.q)), names).push
        )
        upright, way = result["upright"], result["distance"]
        told = [*np.percentile(way[upright], (0, 50, 100)), np.median(result["drift"][upright])]
        print(
            f"  {', '.join(names) or 'nothing'}: {upright.sum()} of {len(upright)} upright, "
            + "way {:.2f} / {:.2f} / {:.2f} m (least, median, most), drift {:.2f} m".format(*told)
        )
    return float(upright.mean())


def save(actor: Actor, args: argparse.Namespace) -> None:
    """Write the weights and their metadata to args.out."""
    meta = {
        "ant": args.ant,
        "asset": asset_hash(args.ant),
        "commit": provenance(),
        "features": list(NAMES),
        "gradient": args.gradient,
        "period": PERIOD,
        "script": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "seed": args.seed,
        "without_gradient": [name for name in args.stages if name in POLISH],
    }
    nova.save_parameters(args.out, {"weights": nova.tensor(np.float32(actor.weights))}, meta)


def load(path: str, ant: str) -> Actor:
    """Load an actor from a file.

    Raises:
        ValueError: another Ant, another shape, NaN, pickled objects, features of another kind.
    """
    like = {"weights": nova.zeros((ACTIONS, FEATURES))}
    values, meta = nova.load_parameters(path, like)
    check_meta(path, meta, ant)
    if meta.get("features") != list(NAMES) or meta.get("period") != PERIOD:
        raise ValueError(f"{path}: expected features {NAMES} and period {PERIOD}")
    return Actor(values["weights"].numpy().astype(np.float64))


def plot(path: str, losses: list[float], result: dict[str, np.ndarray]) -> None:
    """Draw the loss, the path of the torso, and the hinges over the last two seconds."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13.0, 4.0), layout="constrained")
    if losses:
        axes[0].semilogy(losses, color="#2a6f97")
    axes[0].set(xlabel="iteration, over the stages", ylabel="loss", title="Loss")
    q = result["path"][:, 0]
    time_ = np.arange(len(q)) / FPS
    for k, name in enumerate("xyz"):
        axes[1].plot(time_, q[:, k], label=f"{name} [m]")
    axes[1].set(xlabel="time [s]", title="Torso")
    axes[1].legend()
    tail = slice(max(0, len(q) - 2 * FPS), None)
    for k in range(8):
        axes[2].plot(time_[tail], np.degrees(q[tail, 7 + k]), lw=1.0)
    axes[2].set(xlabel="time [s]", ylabel="degrees", title="Hinges, the last 2 s")
    save_figure(figure, path)


def arguments() -> argparse.Namespace:
    """Parse and check the flags."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 600, "frames of 1/20 s that are played after the training")
    parser.add_argument("--load", metavar="PATH.npz", help="play this file; no training")
    parser.add_argument("--out", metavar="PATH.npz", default="ant_gait.npz", help="what is written")
    parser.add_argument("--gradient", choices=("frozen", "exact"), default="frozen")
    parser.add_argument("--ant", choices=("dva", "gym"), default="dva")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", metavar="PATH.npz", help="weights to go on from, instead of 0")
    parser.add_argument("--stages", default="", help="names of stages, comma separated; all")
    parser.add_argument("--repeat", type=float, default=1.0, help="factor of all iterations")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of training at most")
    parser.add_argument("--random-search", action="store_true", help="the yardstick, no gradient")
    parser.add_argument(
        "--variants", type=int, default=0, metavar="N", help="train in N worlds that differ, pushed"
    )
    parser.add_argument(
        "--robustness", type=int, default=0, metavar="N", help="play N seeds that differ, pushed"
    )
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--plot", metavar="PATH.png", help="draw loss and motion")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.variants < 0:
        parser.error(f"--variants: expected a number of worlds >= 0, got {args.variants}")
    for name, value in (("repeat", args.repeat), ("seconds", args.seconds)):
        if not value > 0.0:
            parser.error(f"--{name}: expected a number > 0, got {value}")
    if not args.load and not Path(args.out).resolve().parent.is_dir():
        parser.error(f"--out: the folder of {args.out} does not exist")
    if args.robustness < 0 or (args.robustness and args.live):
        parser.error("--robustness: expected a number of seeds >= 0, and --headless with it")
    known = [*(stage[0] for stage in STAGES), *POLISH, *(stage[0] for stage in HEADING)]
    args.stages = args.stages.split(",") if args.stages else known[: len(STAGES) + 1]
    for name in args.stages:
        if name not in known:
            parser.error(f"--stages: expected names of {', '.join(known)}, got {name}")
    return args


def train(args: argparse.Namespace) -> tuple[Actor, list[float], dict[str, bool]]:
    """Run the training. Return the actor, the losses, and the checks by name."""
    actor = Actor()
    if args.start:
        actor = load(args.start, args.ant)
    trainer = Trainer(actor, args.gradient, args.ant, args.verbose, variants=args.variants)
    begun = time.perf_counter()
    if args.random_search:
        rng = search_rng(args.seed)
        losses = search_stage(trainer, rng, STAGES[-1], min(args.seconds, 1200.0))
        print(f"random search: loss {losses[0]:.4f} -> {losses[-1]:.4f}, {len(losses)} batches")
        return actor, losses, {}
    checks = {}
    for name, horizon, iterations, strength in (*STAGES, *HEADING):
        if name in args.stages:
            count = max(1, round(iterations * args.repeat))
            rate = trainer.stage(name, horizon, count, strength, begun + args.seconds)
            checks[f"steps that are accepted in stage {name}"] = rate > 0.0
            save(actor, args)
    for name in POLISH:
        if name in args.stages:
            count, until = max(1, round(GENERATIONS * args.repeat)), begun + args.seconds
            lacks = polished(actor, name, args.ant, args.seed, count, until)
            less = not lacks or min(lacks) < lacks[0] or min(lacks) == 0.0
            checks[f"less that lacks in stage {name}"] = less
    print(f"trained for {time.perf_counter() - begun:.0f} s, {time.process_time():.0f} s of cores")
    return actor, trainer.losses, checks


def main() -> int:
    """Train or load an actor, play it, and print the checks. Return 0 if all checks passed."""
    args = arguments()
    checks: dict[str, bool] = {}
    if args.load:
        actor, losses = load(args.load, args.ant), []
    else:
        actor, losses, checks = train(args)
        save(actor, args)
        actor = load(args.out, args.ant)  # play the weights of the file, in float32
    ants = make_worlds(1, args.ant)
    with make_stage(args, ants) as stage:
        for frames in stage.runs(args.headless):
            ants.reset()
            stage.show(0.0, ants.state)
            result = validate(actor, ants, frames, lambda k, a: stage.show((k + 1) / FPS, a.state))
    if args.plot:
        plot(args.plot, losses, result)
    ratio = friction_ratio(actor, args.ant, args.headless)
    told = checks_of(result, ratio)
    for name, (passed, figure) in told.items():
        print(f"  {'reached' if passed else 'NOT REACHED'}: {name}: {figure}")
    if args.robustness:
        upright = robustness(actor, args.ant, args.robustness, args.headless)
        checks[f"95 % of {args.robustness} seeds upright"] = upright >= 0.95
    if args.headless >= 600:
        checks |= {name: passed for name, (passed, _) in told.items()}
    print(
        f"ant on {ants.model.device}: {args.headless} frames, {result['distance'][0]:.3f} m, "
        f"{verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
