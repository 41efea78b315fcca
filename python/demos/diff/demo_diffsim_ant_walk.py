"""Play a trained Ant, and fine-tune the biases of its last layer by an analytic gradient.

The actor (111-256-256-8) reads observations 20 times per second, and gives torques for 50 steps of
1 ms. With --train, gradient descent changes the biases before the last tanh. The loss over H
frames, from eight states of walking Ants (--starts) in one batch, is

    -(x_H - x_0) / (0.05 H) + mean y^2 + mean tilt^2 + 1e-3 mean |change of the actions|^2

with the position x and the lateral offset y (m), and the angle of the torso, tilt (rad).

The gradient follows the effect of torques through the mass matrix of every step of 1 ms, projected
onto the null space of the contacts' normals. A gradient through many contacts is useless. Therefore
longer horizons are cut into segments of --segment frames, and the gradients of segments are summed.
A step is kept only if the regular solver measures a lower loss over the whole horizon.
--train-weights all tunes all weights of the actor in the same way.

    python demo_diffsim_ant_walk.py
    python demo_diffsim_ant_walk.py --headless 200
    python demo_diffsim_ant_walk.py --train 10 --train-horizon 8 --save-policy tuned.npz
    python demo_diffsim_ant_walk.py --train 5 --headless 200
    python demo_diffsim_ant_walk.py --policy tuned.npz --headless 200
    python demo_diffsim_ant_walk.py --train 2 --train-horizon 2 --gradient exact --train-weights all
    python demo_diffsim_ant_walk.py --check-gradient
    python demo_diffsim_ant_walk.py --adapt --train 10 --gradient exact --train-weights all --train-horizon 200 --segment 4 --starts 64
"""  # noqa: E501

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import numpy as np
from ant_common import (
    DATA,
    FPS,
    GaitMeter,
    act,
    load_actor,
    make_stage,
    mean_action,
    provenance,
    tilt,
)
from ant_gradients import DOFS, make_frames
from demo_common import run, verdict

from novaphy import nova, viewer
from novaphy.envs import ACTIONS, AntWorlds, rotate, rotate_back

POLICY = DATA / "ant_walker.npz"
WARM_UP = 40  # frames of walking before the states at which rollouts start
STEPS = 2.0 ** -np.arange(0.0, 6.0)  # step sizes that are tried, relative to LARGEST
LARGEST = 0.03  # largest change of a bias in a step; with all weights, of the norm of the change
# --gradient -> terms that the gradient includes besides frozen dynamics with frozen normals.
KINDS = {"frozen": (), "sticking": ("sticking",), "exact": ("observations",)}
# Term -> the part of the derivative that a gradient without the term leaves out.
LEFT_OUT = {
    "dynamics": "derivatives of mass matrix and bias",
    "sticking": "friction tangents",
    "observations": "observations across the 20 Hz refresh",
}
BIASES = ("mu.bias",)  # the arrays that are tuned without --train-weights all
MOST_FRAMES = 16_000  # limit of starts times horizon, because a frame takes 0.17 MB
ADAPTED = {"friction": 0.5, "torso_mass": 1.2}  # --adapt; one hip also loses 30 % of its gear
HELD_OUT, HELD_OUT_FRAMES = (2001, 2002, 2003), 200  # seeds of starts for the final test; frames
EYE = np.eye(3)

Actor = dict[str, nova.Tensor]


def adapted_gear() -> np.ndarray:
    """Return the gear factors {8} of the actions: 0.7 for the first hip, else 1."""
    gear = np.ones(ACTIONS)
    gear[0] = 0.7
    return gear


class Tuning:
    """The loss of a batch of starts, and its gradient with respect to the tuned values. The values
    are one vector: the eight biases, or the actor's arrays, flat, in the order of their names."""

    def __init__(self, actor: Actor, args: argparse.Namespace) -> None:
        """Let Ants walk for WARM_UP frames. Rollouts start at the states that they reach."""
        self.starts_count = args.starts
        self.actor, self.ant, self.adapt = actor, args.ant, args.adapt
        self.horizon, self.segment = args.train_horizon, args.segment
        self.kind, self.terms = args.gradient, KINDS[args.gradient]
        self.names = BIASES if args.train_weights == "biases" else tuple(actor)
        self.values = np.concatenate([actor[k].numpy().ravel() for k in self.names]).astype(float)
        self.shift = 0  # number of frames before the first segment, increased after a failed step
        warm = self.worlds(self.starts_count, seed=args.seed, noise=0.1)
        for _ in range(WARM_UP):
            warm.step(act(actor, warm.observations()))
        self.starts = warm.q, warm.qd
        self.last = act(actor, warm.observations())
        self.frames = self.make_frames(self.starts_count * self.segments())
        self.search = self.worlds(self.starts_count * len(STEPS))

    def worlds(self, count: int, **options) -> AntWorlds:
        """Make worlds of Ants, with --adapt with the changes to which the actor should adapt."""
        ants = AntWorlds(count, ant=self.ant, **options)
        if self.adapt:
            ants.vary(**ADAPTED, gear=np.tile(adapted_gear(), (count, 1)))
        return ants

    def make_frames(self, count: int):
        """Make frames of `count` worlds, with the derivatives of --gradient."""
        kind = "exact" if self.kind == "exact" else "frozen"
        return make_frames(self.worlds(count), kind, self.terms)

    def segments(self) -> int:
        """Return the number of segments of the horizon."""
        return max(1, self.horizon // self.segment)

    def label(self) -> str:
        """Return a description of the gradient."""
        if self.kind == "exact":
            return f"{self.frames.label()}; observations across the refresh included"
        left = (text for term, text in LEFT_OUT.items() if term not in self.terms)
        return "frozen: " + ", ".join(("contact creation and loss", *left))

    def with_values(self, values: np.ndarray) -> Actor:
        """Return the actor with other tuned values, in float32."""
        sizes = [self.actor[name].numpy().size for name in self.names]
        parts = np.split(np.float32(values), np.cumsum(sizes)[:-1])
        shaped = (part.reshape(self.actor[k].shape) for k, part in zip(self.names, parts))
        return {**self.actor, **dict(zip(self.names, map(nova.tensor, shaped)))}

    def means(self, observations: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return means {n, 8} before the tanh. Values {m, ...} are for n / m rows each."""
        values = np.atleast_2d(values)
        if self.names != BIASES:
            blocks = zip(values, np.split(observations, len(values)))
            means = [mean_action(self.with_values(v), nova.tensor(x)).numpy() for v, x in blocks]
            return np.concatenate(means).astype(np.float64)
        # The sum is in double precision, so that small differences of biases are not rounded off.
        plain = mean_action(self.actor, nova.tensor(observations)).numpy().astype(np.float64)
        bias = np.repeat(values, len(observations) // len(values), axis=0)
        return plain - self.actor["mu.bias"].numpy() + bias

    def losses(self, values: np.ndarray) -> np.ndarray:
        """Return the mean losses {m} over the starts of rollouts with values {m, ...}."""
        return self.losses_by_start(values).mean(axis=1)

    def losses_by_start(self, values: np.ndarray) -> np.ndarray:
        """Return the losses {m, starts} of simulated rollouts with values {m, ...}."""
        count = len(values) * self.starts_count
        ants = self.search if count == self.search.num_worlds else self.worlds(count)
        ants.set_state(*(np.tile(x, (len(values), 1)) for x in self.starts))
        last = np.tile(self.last, (len(values), 1))
        first, total = ants.q, np.zeros(count)
        for _ in range(self.horizon):
            a = np.tanh(self.means(ants.observations(), values))
            ants.step(a)
            total += self.frame_loss(ants.q, first, a, last)
            last = a
        total -= (ants.q[:, 0] - first[:, 0]) / (0.05 * self.horizon)
        return np.nan_to_num(total, nan=1e9).reshape(len(values), self.starts_count)

    def frame_loss(self, q, first, a, last) -> np.ndarray:
        """Return the loss at the end of a frame {n}, without the term of the distance."""
        aside = q[:, 1].astype(np.float64) - first[:, 1]
        jump = ((a - last) ** 2).sum(axis=1)
        return (aside**2 + tilt(q) ** 2 + 1e-3 * jump) / self.horizon

    def frame_gradient(self, q, first) -> np.ndarray:
        """Return the derivative of frame_loss with respect to tangents and rates {n, 28}."""
        g = np.zeros((len(q), 28))
        g[:, 1] = 2.0 * (q[:, 1].astype(np.float64) - first[:, 1])
        up = rotate(q[:, 3:7].astype(np.float64), np.broadcast_to(EYE[2], (len(q), 3)))
        side = np.linalg.norm(up[:, :2], axis=1)
        angle = np.arctan2(side, up[:, 2])
        # d(angle) = d|side| / up_z, because |up| = 1.
        g_up = np.zeros_like(up)
        scale = 2.0 * angle / np.maximum(side, 1e-9) / up[:, 2]
        g_up[:, :2] = up[:, :2] * scale[:, None]
        g[:, 3:6] = np.cross(up, g_up)
        return g / self.horizon

    def begin(self, values: np.ndarray):
        """Return the beginnings of all segments: coordinates, rates, the actions of the frame
        before, and the coordinates at the start of the rollout."""
        ants, found, last = self.worlds(self.starts_count), [], self.last
        ants.set_state(*self.starts)
        for k in range(self.shift + self.segment * (self.segments() - 1) + 1):
            if k >= self.shift and (k - self.shift) % self.segment == 0:
                found.append((ants.q, ants.qd, last))
            last = np.tanh(self.means(ants.observations(), values))
            ants.step(last)
        q, qd, last = (np.concatenate(x) for x in zip(*found, strict=True))
        return q, qd, last, np.tile(self.starts[0], (len(found), 1))

    def record(self, values: np.ndarray) -> list[dict]:
        """Run the frames of all segments as worlds of one batch. Return data for the gradient."""
        ants = self.frames.ants
        start, rate, last, first = self.begin(values)
        ants.set_state(start, rate)
        records = []
        for _ in range(min(self.segment, self.horizon)):
            seen, q, qd = ants.observations(), ants.q, ants.qd
            a = np.tanh(self.means(seen, values))
            kept = self.frames.run(a)
            records.append(
                {"kept": kept, "a": a, "last": last, "q": q, "qd": qd, "end": ants.q,
                 "seen": seen, "first": first}
            )  # fmt: skip
            last = a
        return records

    def gradient(self, values: np.ndarray, records: list[dict] | None = None) -> np.ndarray:
        """Return the gradient of the loss by the values, a mean over the starts."""
        actor = self.with_values(values)
        for name in self.names:
            actor[name].requires_grad = True
        by_bias = self.pull(actor, records or self.record(values))
        if self.names == BIASES:  # in double precision
            return by_bias.sum(axis=0) / self.starts_count
        found = [actor[name].grad.numpy().ravel() for name in self.names]
        return np.concatenate(found).astype(float) / self.starts_count

    def pull(self, actor: Actor, records: list[dict]) -> np.ndarray:
        """Return the gradient with respect to the biases {worlds, 8}, summed over the frames.
        Gradients of other tuned arrays, summed over all worlds, are added to their grad."""
        ants = self.frames.ants
        columns = 6 + np.array(ants.hinge_of_action)
        g = np.zeros((ants.num_worlds, 28))
        g[:, 0] = -1.0 / (0.05 * self.horizon)
        g_later, total = np.zeros((2, ants.num_worlds, ACTIONS))
        for r in reversed(records):
            g = g + self.frame_gradient(r["end"], r["first"])
            pulled, force = self.frames.pull(r["kept"], g[:, None])
            g, force = pulled[:, 0], force[:, 0]
            jump = 2e-3 * (r["a"] - r["last"]) / self.horizon
            g_a = force[:, columns] * ants.gear * ants.varied["gear"] + jump + g_later
            g_later = -jump
            g_mean = g_a * (1.0 - r["a"] ** 2)
            total += g_mean
            if self.names == BIASES and "observations" not in self.terms:
                continue
            seen = nova.tensor(r["seen"], requires_grad="observations" in self.terms)
            with nova.Tape() as tape:
                mean = mean_action(actor, seen)
            tape.backward(mean, nova.tensor(np.float32(g_mean)))
            if "observations" in self.terms:
                by_seen = seen.grad.numpy()[:, None, :27].astype(np.float64)
                g = g + (by_seen @ observation_jacobian(r["q"], r["qd"]))[:, 0]
        return total

    def train(self) -> tuple[float, float, bool]:
        """Take one step. Return the loss before and after it, and whether a candidate was kept."""
        gradient = self.gradient(self.values)
        # The step is scaled by the largest component for biases, and by the norm for all weights.
        size = np.linalg.norm(gradient, np.inf if self.names == BIASES else 2)
        direction = gradient / max(size, 1e-12)
        candidates = self.values - LARGEST * STEPS[:, None] * direction
        before = self.losses(self.values[None])[0]
        losses = self.losses(candidates)
        best = int(np.argmin(losses))
        if losses[best] < before:
            self.values = candidates[best].astype(np.float32).astype(np.float64)
            return before, losses[best], True
        self.shift = (self.shift + 1) % self.segment if self.segments() > 1 else 0
        return before, before, False

    def tuned(self) -> Actor:
        """Return the actor with the tuned values."""
        return self.with_values(self.values)

    def replay(self, records: list[dict], values: np.ndarray) -> float:
        """Return the loss of other values, by the linearized dynamics that the frames stored."""
        ants, dt = self.frames.ants, self.frames.ants.dt
        columns = 6 + np.array(ants.hinge_of_action)
        e, v = np.zeros((2, ants.num_worlds, DOFS))
        last, total = records[0]["last"].astype(np.float64), np.zeros(ants.num_worlds)
        for r in records:
            a = np.tanh(self.means(r["seen"], values))
            force = np.zeros_like(v)
            force[:, columns] = (a - r["a"]) * ants.gear * ants.varied["gear"]
            for inverse, k, d, back, by_state in r["kept"]:
                push = force - k * (e + dt * v) - d * v
                if by_state is not None:
                    for by, x in zip(by_state, (e, v)):
                        push = push - (by @ x[..., None])[..., 0]
                v = v + dt * np.einsum("nij,nj->ni", inverse, push)
                v = np.einsum("nji,nj->ni", back, v)
                e = e + dt * v
            q = moved(r["end"].astype(np.float64), e)
            total += self.frame_loss(q, r["first"], a, last)
            last = a
        way = records[-1]["end"][:, 0].astype(np.float64) + e[:, 0] - records[0]["q"][:, 0]
        return float((total - way / (0.05 * self.horizon)).sum() / self.starts_count)

    def directions(self) -> np.ndarray:
        """Return eight directions {8, ...}: one per bias, or random directions of all weights."""
        if self.names == BIASES:
            return np.eye(ACTIONS)
        return np.random.default_rng(0).standard_normal((ACTIONS, self.values.size))

    def check_gradient(self) -> bool:
        """Compare the gradient with differences of `replay` and of simulated rollouts."""
        passed, ways = True, self.directions()
        if self.kind != "exact":
            records = self.record(self.values)
            ad, fd = ways @ self.gradient(self.values, records), np.zeros(ACTIONS)
            for k, way in enumerate(ways):
                ends = [self.replay(records, self.values + s * 1e-4 * way) for s in (1, -1)]
                fd[k] = (ends[0] - ends[1]) / 2e-4
            error = float(np.abs(ad - fd).max() / np.abs(fd).max())
            passed = error <= 1e-3
            print(f"linearized replay: relative error {error:.1e} (tolerance 1e-03)")
        wanted, one = (self.horizon, self.segment, self.frames), None
        self.frames = self.make_frames(self.starts_count)
        print("real rollouts:  H   eps     cosine  ratio of norms")
        for self.horizon in (1, 2, 4, 8):
            self.segment = self.horizon
            ad = ways @ self.gradient(self.values)
            for eps in (1e-4, 3e-4, 1e-3, 3e-3, 1e-2):
                losses = self.losses(self.values + eps * np.concatenate([ways, -ways]))
                fd = (losses[:ACTIONS] - losses[ACTIONS:]) / (2.0 * eps)
                sizes = np.linalg.norm(ad), np.linalg.norm(fd)
                cosine = float(ad @ fd / max(sizes[0] * sizes[1], 1e-12))
                ratio = sizes[0] / max(sizes[1], 1e-12)
                print(f"{self.horizon:17d}   {eps:.0e}  {cosine:6.3f}  {ratio:.3f}")
                if self.horizon == 1 and eps == 3e-3:
                    one = cosine
        self.horizon, self.segment, self.frames = wanted
        print(f"gradient at H = 1: cosine {one:.3f} (0.9 or more away from events)")
        return passed


def observation_jacobian(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return derivatives of the first 27 observations by tangents and rates {n, 27, 28}."""
    q, qd = q.astype(np.float64), qd.astype(np.float64)
    d = np.zeros((len(q), 27, 28))
    d[:, 0, 2] = 1.0
    d[:, 5:13, 6:14] = d[:, 19:27, 20:28] = np.eye(8)
    d[:, 13:16, 14:17] = EYE
    for k in range(3):
        d[:, 1, 3 + k] = -0.5 * q[:, 3 + k]
        turn = np.broadcast_to(EYE[k], (len(q), 3))
        d[:, 2:5, 3 + k] = 0.5 * (q[:, 6:7] * turn + np.cross(turn, q[:, 3:6]))
        d[:, 16:19, 3 + k] = rotate_back(q[:, 3:7], np.cross(qd[:, 3:6], turn))
        d[:, 16:19, 17 + k] = rotate_back(q[:, 3:7], turn)
    return d


def moved(q: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Return coordinates {n, 15} moved by tangents {n, 14}."""
    q = q.copy()
    q[:, :3] += e[:, :3]
    angle = np.linalg.norm(e[:, 3:6], axis=1, keepdims=True)
    u = 0.5 * np.sinc(angle / (2.0 * np.pi)) * e[:, 3:6]
    w, v, s = np.cos(0.5 * angle), q[:, 3:6].copy(), q[:, 6:7].copy()
    q[:, 3:6] = w * v + s * u + np.cross(u, v)
    q[:, 6:7] = w * s - (u * v).sum(axis=1, keepdims=True)
    q[:, 7:] += e[:, 6:]
    return q


def returns(actor: Actor, ants: AntWorlds, tuning: Tuning, seed: int) -> np.ndarray:
    """Return the mean return (the negative of the tuning's loss) and the mean distance (m) of an
    actor from the starts of a seed."""
    ants.reseed(seed)
    ants.reset()
    first, last = ants.q, np.zeros((ants.num_worlds, ACTIONS))
    alive, way, cost = np.ones(ants.num_worlds, bool), *np.zeros((2, ants.num_worlds))
    for _ in range(HELD_OUT_FRAMES):
        a = act(actor, ants.observations())
        ants.step(a)
        alive &= ants.healthy()
        way[alive] = ants.q[alive, 0] - first[alive, 0]
        cost += np.where(alive, tuning.frame_loss(ants.q, first, a, last) * tuning.horizon, 1.0)
        last = a
    gained = way / (0.05 * HELD_OUT_FRAMES) - cost / HELD_OUT_FRAMES
    return np.array([gained.mean(), way.mean()])


def play(actor: Actor, args: argparse.Namespace) -> dict[str, bool]:
    """Play the actor in the viewers. Return the checks by name."""
    ants = AntWorlds(1, ant=args.ant)
    if args.adapt:
        ants.vary(**ADAPTED, gear=adapted_gear()[None])
    with make_stage(args, ants) as stage:
        for frames in stage.runs(args.headless):
            ants.reset()
            meter, alive = GaitMeter(ants), True
            stage.show(0.0, ants.state)
            for frame in frames:
                ants.step(act(actor, ants.observations()), each=meter)
                meter.end_frame()
                alive = alive and bool(ants.healthy()[0])
                stage.show(frame / FPS, ants.state)
    if not args.headless:
        return {}
    r, way = meter.result(), float(ants.q[0, 0])
    print(
        f"{args.headless} frames: {way:.3f} m, {way / args.headless * FPS:.3f} m/s, touchdowns "
        f"per second {np.round(r['touchdown_rate'][0], 2)}, "
        f"clearance {100 * r['clearance'][0]:.1f} cm, "
        f"slip {r['slip'][0]:.0%} of the distance, tilt at most {r['tilt'][0]:.1f} degrees"
    )
    checks = {"an Ant that stays up": alive}
    if args.headless >= FPS:  # in the first second the Ant drops onto its feet
        checks["a way forward"] = way > 0.0
    return checks


def arguments() -> argparse.Namespace:
    """Parse and check the flags."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    viewer.add_arguments(parser, 400, "frames of 1/20 s that are played")
    parser.add_argument("--policy", metavar="PATH.npz", default=str(POLICY), help="the actor")
    parser.add_argument("--save-policy", metavar="PATH.npz", help="write the tuned actor")
    parser.add_argument("--train", type=int, default=0, metavar="N", help="steps of fine-tuning")
    parser.add_argument("--train-horizon", type=int, default=8, metavar="H", help="frames")
    parser.add_argument(
        "--starts", type=int, default=8, metavar="N", help="states that are tuned on"
    )
    parser.add_argument("--segment", type=int, default=8, metavar="S", help="frames of a gradient")
    parser.add_argument("--check-gradient", action="store_true", help="compare with differences")
    parser.add_argument(
        "--gradient",
        choices=tuple(KINDS),
        default="frozen",
        help="frozen: normals of contacts held; sticking: their friction too where they stick",
    )
    parser.add_argument(
        "--train-weights",
        choices=("biases", "all"),
        default="biases",
        help="what is tuned: the biases of the last layer, or all weights",
    )
    parser.add_argument(
        "--adapt", action="store_true", help="friction 0.5, torso +20 %%, one hip -30 %%"
    )
    parser.add_argument("--ant", choices=("dva", "gym"), default="dva")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.train < 0:
        parser.error(f"--train: expected a number >= 0, got {args.train}")
    if not 1 <= args.train_horizon <= 400:
        parser.error(
            "--train-horizon: expected 1 to 400 frames, whose steps fit into memory, got "
            f"{args.train_horizon}"
        )
    for name, value in (("segment", args.segment), ("starts", args.starts)):
        if value < 1:
            parser.error(f"--{name}: expected a number >= 1, got {value}")
    most = MOST_FRAMES // args.train_horizon
    if args.starts > most:
        parser.error(
            f"--starts: expected at most {most} with this horizon, whose steps fit into memory, "
            f"got {args.starts}"
        )
    if args.save_policy and not Path(args.save_policy).resolve().parent.is_dir():
        parser.error(f"--save-policy: the folder of {args.save_policy} does not exist")
    if args.check_gradient and args.live:
        args.live, args.headless = False, 0
    return args


def report_adaptation(
    before: Actor, after: Actor, tuning: Tuning, args: argparse.Namespace
) -> None:
    """Print how much of the lost return the tuning recovers on held-out starts."""
    plain = AntWorlds(32, ant=args.ant, noise=0.1)
    changed = tuning.worlds(32, noise=0.1)
    found = np.array([
        [returns(before, plain, tuning, seed)]
        + [returns(x, changed, tuning, seed) for x in (before, after)]
        for seed in HELD_OUT
    ])  # fmt: skip
    print(f"adaptation, {len(HELD_OUT)} times 32 held-out starts, {HELD_OUT_FRAMES} frames")
    for k, name in enumerate(("return", "way (m)")):
        nominal, lost, tuned = found[:, :, k].T
        share = (tuned - lost).sum() / (nominal - lost).sum()
        shares = (tuned - lost) / (nominal - lost)
        print(
            f"  {name}: {nominal.mean():.3f} before the changes, {lost.mean():.3f} with them, "
            f"{tuned.mean():.3f} tuned: {share:.0%} of the loss is back "
            f"(by seed {', '.join(f'{x:.0%}' for x in shares)})"
        )


def main() -> int:
    """Tune, check and play the actor. Return 0 if every check passed."""
    args = arguments()
    actor, meta = load_actor(args.policy, args.ant)
    checks: dict[str, bool] = {}
    if args.check_gradient or args.train:
        tuning = Tuning(actor, args)
        if args.check_gradient:
            checks["a gradient within the tolerance"] = tuning.check_gradient()
        kept = 0
        for k in range(args.train):
            before, after, moved_ = tuning.train()
            kept += moved_
            print(
                f"  {k}: loss {before:.5f} -> {after:.5f}{'' if moved_ else ' (no candidate kept)'}"
            )
        print(tuning.label())
        tuned = tuning.tuned()
        if args.train:
            print(f"{kept} of {args.train} steps kept")
            if args.adapt:
                report_adaptation(actor, tuned, tuning, args)
        actor = tuned
    if args.save_policy:
        told = {
            "commit": provenance(),
            "script": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        }
        nova.save_parameters(args.save_policy, actor, {**meta, "tuned": told})
    checks |= play(actor, args)
    print(f"ant walks on cpu: {verdict(checks)}")
    return 0 if all(checks.values()) else 1


if __name__ == "__main__":
    run(main)
