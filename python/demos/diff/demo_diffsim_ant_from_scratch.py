"""Teach an Ant of 182 kg to walk from zero, with 80 parameters and analytic gradients.

The actor gives 8 torques 20 times a second: the tanh of 80 weights times 10 features, which are 1,
the first and second harmonic of a phase, height, velocity and tilt of the torso. All weights start
at 0. A curriculum lets it stand over longer and longer horizons, then move. Frames of the actor's
own rollout are the worlds of one batch; their derivatives give the gradient and the Gauss-Newton
matrix of segments of some frames, summed over the horizon. A step is kept only when the regular
solver, over the whole horizon, measures a lower loss; all candidates are one batch too.

The Ant learns to stand, upright and still, and does not yet walk: what it reaches of a gait and
what it does not is printed (docs/guide/trained-policy.md).

    python demo_diffsim_ant_from_scratch.py
    python demo_diffsim_ant_from_scratch.py --headless 600 --out gait.npz
    python demo_diffsim_ant_from_scratch.py --load gait.npz --headless 600  # 1, while a check fails
    python demo_diffsim_ant_from_scratch.py --load gait.npz --record gait.html
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
from demo_common import run, save_figure, verdict

from novaphy import nova, viewer
from novaphy.envs import ACTIONS, AntWorlds, asset_hash, check_meta, rotate

GAIT = DATA / "periodic_ant_natural_gait.npz"
PERIOD = 16  # frames of a phase
FEATURES = 10
HEIGHT = 0.60  # m, of the torso when it stands
# Of height, velocities and tilts.
SCALE = np.array([5.0, 1.0, 1.0, 5.0, 5.0])
NATURAL = ("1", "sin p", "cos p", "sin 2p", "cos 2p", "height", "vx", "vy", "tilt x", "tilt y")
HEADING = ("1", "sin p", "cos p", "sin 2p", "cos 2p", "y", "heading", "vy", "tilt x", "tilt y")
# Name, frames, iterations, part of the gait's amplitude. Standing comes first over all horizons:
# what has learned to walk over few frames falls later, where derivatives no longer help.
STAGES = (
    ("stand", 24, 5, 0.0),
    ("stand-60", 60, 8, 0.0),
    ("stand-200", 200, 8, 0.0),
    ("200", 200, 12, 0.05),
    ("400", 400, 8, 0.05),
)
# The pose that distortion is measured from: a trot, of hips and ankles (rad).
SWAY, ANKLE, LIFT = 0.30, 1.15, 0.55
HIP_SIGN, ANKLE_SIGN = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, -1.0, 1.0])
DIAGONAL = np.array([0.0, np.pi, 0.0, np.pi])  # phase of the legs
SPEED = 2.0  # m/s, times the amplitude
WEIGHTS = {
    "speed": 2.0, "tilt": 6.0, "heading": 3.0, "drift": 2.0, "pose": 4.0, "jump": 0.01,
    "symmetry": 1.0,
}  # fmt: skip
SMALL = 3e-3  # weight of the squares of the weights
LENGTHS = (8, 16, 30)  # frames of segments, in turn
CLIP = 1.0  # norm of the gradient
DAMPING = 10.0 ** np.linspace(-6.0, 3.0, 16)  # over the largest curvature


def phase(frame: np.ndarray) -> np.ndarray:
    """Of a frame."""
    return 2.0 * np.pi * np.asarray(frame) / PERIOD


def reference(frame: np.ndarray, amplitude: float) -> np.ndarray:
    """Hinges {n, 8} of the trot at the end of frames {n}."""
    p = phase(np.asarray(frame) + 1.0)[:, None] + DIAGONAL
    pose = np.empty((len(p), 8))
    pose[:, 0::2] = -HIP_SIGN * amplitude * SWAY * np.cos(p)
    pose[:, 1::2] = ANKLE_SIGN * (ANKLE - amplitude * LIFT * np.maximum(0.0, -np.sin(p)))
    return pose


def swings(frame: np.ndarray) -> np.ndarray:
    """Which feet {n, 4} the trot has in the air in the middle of frames {n}."""
    return np.sin(phase(np.asarray(frame) + 0.5)[:, None] + DIAGONAL) < 0.0


def axis(q: np.ndarray, k: int) -> np.ndarray:
    """An axis of the torso in the world {n, 3}."""
    return rotate(q[:, 3:7].astype(np.float64), np.broadcast_to(np.eye(3)[k], (len(q), 3)))


class Actor:
    """80 weights {8, 10}; the features it sees, and their derivatives."""

    def __init__(self, names: tuple[str, ...], weights: np.ndarray | None = None) -> None:
        """From zeros."""
        self.names = names
        self.weights = np.zeros((ACTIONS, FEATURES)) if weights is None else weights

    def features(self, q: np.ndarray, qd: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """{n, 10}."""
        p = np.broadcast_to(phase(frame), (len(q),))
        up = axis(q, 2)
        if self.names == HEADING:
            body = [q[:, 1], axis(q, 0)[:, 1], qd[:, 1], up[:, 0], up[:, 1]]
        else:
            body = [q[:, 2] - HEIGHT, qd[:, 0], qd[:, 1], up[:, 0], up[:, 1]]
        waves = [np.ones_like(p), np.sin(p), np.cos(p), np.sin(2 * p), np.cos(2 * p)]
        return np.concatenate([np.stack(waves, 1), np.stack(body, 1) * SCALE], axis=1)

    def feature_jacobian(self, q: np.ndarray) -> np.ndarray:
        """The features' derivatives by tangents and rates {n, 10, 28}."""
        out = np.zeros((len(q), FEATURES, 28))
        if self.names == HEADING:
            out[:, 5, 1] = 1.0
            out[:, 6, 3:6] = np.cross(axis(q, 0), np.eye(3)[1])
        else:
            out[:, 5, 2] = out[:, 6, 14] = 1.0
        out[:, 7, 15] = 1.0
        out[:, 8:, 3:6] = np.stack([np.cross(axis(q, 2), np.eye(3)[k]) for k in range(2)], 1)
        out[:, 5:] *= SCALE[:, None]
        return out

    def act(self, features: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Actions {n, 8}; with weights {n, 8, 10} each row by its own."""
        w = self.weights if weights is None else weights
        return np.tanh(np.einsum("...af,nf->na" if w.ndim == 2 else "naf,nf->na", w, features))


def residuals(q, qd, a, last, frame, amplitude: float):
    """What the loss of frames {n} sums the squares of {n, 26}, at their ends; its derivatives by
    tangents and rates {n, 26, 28}, and by the actions {n, 26, 8}: by those before, less that."""
    w = {name: np.sqrt(value) for name, value in WEIGHTS.items()}
    n = len(q)
    q, qd = q.astype(np.float64), qd.astype(np.float64)
    r, by_state, by_action = np.zeros((n, 26)), np.zeros((n, 26, 28)), np.zeros((n, 26, 8))
    up, ahead = axis(q, 2), axis(q, 0)
    r[:, 0] = w["speed"] * (qd[:, 0] - SPEED * amplitude)
    by_state[:, 0, 14] = w["speed"]
    r[:, 1:3] = w["tilt"] * up[:, :2]
    r[:, 3] = w["heading"] * ahead[:, 1]
    for row, vector, k in ((1, up, 0), (2, up, 1), (3, ahead, 1)):  # e x vector, component k
        by_state[:, row, 3:6] = w["heading" if row == 3 else "tilt"] * np.cross(
            vector, np.eye(3)[k]
        )
    r[:, 4], by_state[:, 4, 1] = w["drift"] * q[:, 1], w["drift"]
    r[:, 5], by_state[:, 5, 15] = 0.5 * w["drift"] * qd[:, 1], 0.5 * w["drift"]
    r[:, 6:14] = w["pose"] * (q[:, 7:] - reference(frame, amplitude))
    by_state[:, 6:14, 6:14] = w["pose"] * np.eye(8)
    # Hinges of diagonal legs mirror each other: their sums vanish.
    r[:, 14:18] = w["symmetry"] * (q[:, 7:11] + q[:, 11:15])
    by_state[:, 14:18, 6:10] = by_state[:, 14:18, 10:14] = w["symmetry"] * np.eye(4)
    r[:, 18:26], by_action[:, 18:26] = w["jump"] * (a - last), w["jump"] * np.eye(8)
    return r, by_state, by_action


class Trainer:
    """Gradient steps on an actor over a horizon."""

    def __init__(self, actor: Actor, kind: str, ant: str, seed: int, verbose: bool) -> None:
        """With the gradient of the kind "frozen" or "exact"."""
        self.actor, self.kind, self.ant, self.seed, self.verbose = actor, kind, ant, seed, verbose
        self.search = AntWorlds(len(DAMPING), ant=ant, seed=seed)
        self.frames = {}
        self.label = ""
        self.losses: list[float] = []

    def rollouts(self, weights: np.ndarray, horizon: int, amplitude: float, keep: bool = False):
        """Losses {n} of weights {n, 8, 10} over the horizon; with `keep` the first one's states."""
        ants = self.search
        n = ants.num_worlds
        ants.reset()
        last, total, kept = np.zeros((n, ACTIONS)), np.zeros(n), []
        alive = np.ones(n, bool)
        for k in range(horizon):
            q, qd = ants.q, ants.qd
            a = self.actor.act(self.actor.features(q, qd, k), weights)
            if keep:
                kept.append((q[0], qd[0], a[0]))
            ants.step(a)
            alive &= ants.healthy()
            r = residuals(ants.q, ants.qd, a, last, np.full(n, k), amplitude)[0]
            loss = (r**2).sum(axis=1)
            total += np.where(alive, loss, 50.0)
            last = a
        total = total / horizon + SMALL * (weights**2).sum(axis=(1, 2))
        return np.nan_to_num(total, nan=1e9), kept

    def gradient(self, kept, horizon: int, amplitude: float, length: int):
        """The gradient {80} of the loss, and the Gauss-Newton matrix {80, 80}: both summed over
        segments of `length` frames that begin in every frame of the rollout."""
        actor, n = self.actor, horizon
        if n not in self.frames:
            self.frames = {n: make_frames(AntWorlds(n, ant=self.ant), self.kind)}
        frames = self.frames[n]
        q, qd, a = (np.stack([row[i] for row in kept]) for i in range(3))
        f = actor.features(q, qd, np.arange(n))
        if self.kind == "frozen" and amplitude > 0.0:
            # A derivative with a contact held does not see that its foot could lift.
            frames.released[:] = swings(np.arange(n))
        by_state, by_action = frame_jacobians(frames, q, qd, a)
        ends = frames.ants.q, frames.ants.qd
        before = np.concatenate([np.zeros((1, ACTIONS)), a[:-1]])
        r, r_state, r_action = residuals(*ends, a, before, np.arange(n), amplitude)
        self.label = frames.label()
        slope = (1.0 - a**2)[..., None]
        # Of actions with features, and of features with states.
        by_features = slope * actor.weights
        of_state = by_features @ actor.feature_jacobian(q)
        direct = np.einsum("nab,nf->nabf", slope * np.eye(ACTIONS), f).reshape(n, ACTIONS, -1)
        gradient, matrix = np.zeros(80), np.zeros((80, 80))
        change = np.zeros((n, 28, 80))  # of the segment that began `step` frames ago
        last = np.zeros((n, ACTIONS, 80))
        for step in range(min(length, n)):
            rows = slice(step, n)  # frames that are the step-th of a segment
            action = direct[rows] + of_state[rows] @ change[: n - step]
            change = by_state[rows] @ change[: n - step] + by_action[rows] @ action
            j = r_state[rows] @ change + r_action[rows] @ (action - last[: n - step])
            last = action
            gradient += np.einsum("nrp,nr->p", j, r[rows])
            flat = j.reshape(-1, 80)
            matrix += flat.T @ flat
        return gradient / (n * length), matrix / (n * length)

    def stage(
        self, name: str, horizon: int, iterations: int, amplitude: float, until: float
    ) -> float:
        """Iterations of one horizon; the part of them that found a lower loss."""
        actor, accepted, tried = self.actor, 0, 0
        n = self.search.num_worlds
        first = None
        for k in range(iterations):
            if time.perf_counter() > until:
                break
            losses, kept = self.rollouts(
                np.tile(actor.weights, (n, 1, 1)), horizon, amplitude, True
            )
            before = losses[0]
            first = before if first is None else first
            g, matrix = self.gradient(kept, horizon, amplitude, LENGTHS[k % len(LENGTHS)])
            g = g + SMALL * actor.weights.ravel()
            matrix = matrix + SMALL * np.eye(80)
            values, vectors = np.linalg.eigh(matrix)
            size = max(values[-1], 1e-12)
            steps = []
            for damping in DAMPING:
                step = vectors @ ((vectors.T @ g) / (np.maximum(values, 0.0) + damping * size))
                steps.append(step / max(1.0, np.linalg.norm(step) / CLIP))
            steps = np.array(steps).reshape(n, ACTIONS, FEATURES)
            candidates = actor.weights - steps
            losses, _ = self.rollouts(candidates, horizon, amplitude)
            best = int(np.argmin(losses))
            tried += 1
            if losses[best] < before:
                actor.weights = candidates[best]
                accepted += 1
            self.losses.append(min(losses[best], before))
            if self.verbose:
                print(f"    {name} {k}: {before:.4f} -> {losses[best]:.4f} ({best})", flush=True)
        last = self.losses[-1] if self.losses else np.nan
        print(
            f"stage {name}: {horizon} frames, {accepted} of {tried} steps accepted, loss "
            f"{first if first is not None else np.nan:.4f} -> {last:.4f}, gradient: {self.label}",
            flush=True,
        )
        return accepted / max(tried, 1) if tried else 1.0


def random_search(
    actor: Actor, ant: str, seed: int, seconds: float, horizon: int = 60
) -> list[float]:
    """The yardstick: gaussian steps of changing length on the same loss; the losses."""
    trainer = Trainer(actor, "frozen", ant, seed, False)
    n, rng = trainer.search.num_worlds, np.random.Generator(np.random.Philox(key=[seed, 9]))
    until, width = time.perf_counter() + seconds, 0.1
    best = trainer.rollouts(np.tile(actor.weights, (n, 1, 1)), horizon, 1.0)[0][0]
    losses = [best]
    while time.perf_counter() < until:
        candidates = actor.weights + width * rng.standard_normal((n, ACTIONS, FEATURES))
        found, _ = trainer.rollouts(candidates, horizon, 1.0)
        k = int(np.argmin(found))
        width *= 1.3 if found[k] < best else 0.9
        if found[k] < best:
            best, actor.weights = found[k], candidates[k]
        losses.append(best)
    return losses


def validate(
    actor: Actor,
    ants: AntWorlds,
    frames: Iterable[int],
    each: Callable[[int, AntWorlds], None] | None = None,
) -> dict[str, np.ndarray]:
    """Play the actor in all worlds: what GaitMeter measures, and where the Ants end."""
    ants.reset()
    meter = GaitMeter(ants)
    alive = np.ones(ants.num_worlds, bool)
    drift = np.zeros(ants.num_worlds)
    path = [ants.q]
    for k, _ in enumerate(frames):
        q, qd = ants.q, ants.qd
        ants.step(actor.act(actor.features(q, qd, k)), each=meter)
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


def checks_of(result: dict[str, np.ndarray], ratio: float) -> dict[str, tuple[bool, str]]:
    """What is asked of 600 frames, whether it is so, and the figure."""
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
    """The shorter of the distances at friction 0.5 and 1.2 over the longer one."""
    ants = AntWorlds(2, ant=ant)
    ants.vary(friction=[0.5, 1.2])
    distance = validate(actor, ants, range(frames))["distance"]
    return float(max(distance.min(), 0.0) / max(distance.max(), 1e-6))


def save(path: str, actor: Actor, ant: str, seed: int, kind: str) -> None:
    """Write the weights with what they are."""
    meta = {
        "ant": ant,
        "asset": asset_hash(ant),
        "commit": provenance(),
        "features": list(actor.names),
        "gradient": kind,
        "period": PERIOD,
        "script": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "seed": seed,
    }
    nova.save_parameters(path, {"weights": nova.tensor(np.float32(actor.weights))}, meta)


def load(path: str, ant: str) -> Actor:
    """The actor of a file.

    Raises:
        ValueError: another Ant, another shape, NaN, pickled objects, features of another kind.
    """
    like = {"weights": nova.zeros((ACTIONS, FEATURES))}
    values, meta = nova.load_parameters(path, like)
    check_meta(path, meta, ant)
    names = tuple(meta.get("features", ()))
    if names not in (NATURAL, HEADING) or meta.get("period") != PERIOD:
        raise ValueError(f"{path}: expected features {NATURAL} or {HEADING} and period {PERIOD}")
    return Actor(names, values["weights"].numpy().astype(np.float64))


def plot(path: str, losses: list[float], result: dict[str, np.ndarray]) -> None:
    """The loss, the way of the torso, and the hinges over two seconds."""
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
    """The flags."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 600, "frames of 1/20 s that are played after the training")
    parser.add_argument("--load", metavar="PATH.npz", help="play this file; no training")
    parser.add_argument("--out", metavar="PATH.npz", default="ant_gait.npz", help="what is written")
    parser.add_argument("--gradient", choices=("frozen", "exact"), default="frozen")
    parser.add_argument("--heading", action="store_true", help="features y and heading")
    parser.add_argument("--ant", choices=("dva", "gym"), default="dva")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", metavar="PATH.npz", help="weights to go on from, instead of 0")
    parser.add_argument("--stages", default="", help="names of stages, comma separated; all")
    parser.add_argument("--repeat", type=float, default=1.0, help="factor of all iterations")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of training at most")
    parser.add_argument("--random-search", action="store_true", help="the yardstick, no gradient")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--plot", metavar="PATH.png", help="draw loss and motion")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    known = [stage[0] for stage in STAGES]
    args.stages = args.stages.split(",") if args.stages else known
    for name in args.stages:
        if name not in known:
            parser.error(f"--stages: expected names of {', '.join(known)}, got {name}")
    return args


def train(args: argparse.Namespace) -> tuple[Actor, list[float], dict[str, bool]]:
    """Train as asked; the actor, the losses, and what failed."""
    actor = Actor(HEADING if args.heading else NATURAL)
    if args.start:
        actor = load(args.start, args.ant)
    begun = time.perf_counter()
    if args.random_search:
        losses = random_search(actor, args.ant, args.seed, min(args.seconds, 1200.0))
        print(f"random search: loss {losses[0]:.4f} -> {losses[-1]:.4f}, {len(losses)} batches")
        return actor, losses, {}
    trainer = Trainer(actor, args.gradient, args.ant, args.seed, args.verbose)
    checks = {}
    for name, horizon, iterations, amplitude in STAGES:
        if name in args.stages:
            count = max(1, round(iterations * args.repeat))
            rate = trainer.stage(name, horizon, count, amplitude, begun + args.seconds)
            checks[f"steps that are accepted in stage {name}"] = rate > 0.0
            save(args.out, actor, args.ant, args.seed, args.gradient)
    print(f"trained for {time.perf_counter() - begun:.0f} s")
    return actor, trainer.losses, checks


def main() -> int:
    """Train or load, play, and print what is asked of a gait; 0 when all of it is so."""
    args = arguments()
    checks: dict[str, bool] = {}
    if args.load:
        actor, losses = load(args.load, args.ant), []
    else:
        actor, losses, checks = train(args)
        save(args.out, actor, args.ant, args.seed, args.gradient)
    ants = AntWorlds(1, ant=args.ant)
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
    if args.headless >= 600:
        checks |= {name: passed for name, (passed, _) in told.items()}
    print(
        f"ant on {ants.model.device}: {args.headless} frames, {result['distance'][0]:.3f} m, "
        f"{verdict(checks)}"
    )
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
