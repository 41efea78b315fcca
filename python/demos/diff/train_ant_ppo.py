"""Train the Ant's actor (111-256-256-8) by proximal policy optimization on a batch of worlds.

The method is that of Schulman et al., "Proximal policy optimization algorithms" (2017), with layers
of nova: Gaussian actions with a tanh, generalized advantages, clipped ratios, Adam. The networks
read the 27 observations that are not always 0. The written file has the normalization of the
observations in its first layer, whose columns 27 to 110 are 0. The first part of the training may
use longer substeps (--coarse), and the rest uses substeps of 1 ms. The same seed gives the same
file.

    python train_ant_ppo.py --steps 8e6 --out walker.npz
    python train_ant_ppo.py --resume walker.checkpoint.npz --steps 2e7 --out walker.npz
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from pathlib import Path

import numpy as np
from ant_common import HIDDEN, OBSERVATIONS, judge, load_actor, provenance

import novaphy
from novaphy import nova
from novaphy.envs import ACTIONS, AntWorlds, asset_hash, rotate

SEEN = 27  # number of observations that the networks read
GAMMA, LAMBDA, CLIP = 0.99, 0.95, 0.2
EPISODE = 1000  # frames
START_LOG_STD = -0.7
REWARD = "0.5 + 2 clip(vx, -1, 1.5) - 0.5 |vy| - 0.02 |a|^2 - 0.02 |da|^2 - (1 - up)"


def fresh(seed: int) -> dict[str, np.ndarray]:
    """Return random initial parameters of actor and critic, drawn by Philox."""
    rng = np.random.Generator(np.random.Philox(key=[seed, 1]))
    sizes = {"0": (HIDDEN, SEEN), "2": (HIDDEN, HIDDEN)}
    parameters: dict[str, np.ndarray] = {}
    for net, last in (("pi", ACTIONS), ("v", 1)):
        for layer, shape in {**sizes, "4": (last, HIDDEN)}.items():
            gain = {"4": 0.01 if net == "pi" else 1.0}.get(layer, np.sqrt(2.0))
            weight = rng.standard_normal(shape) * gain / np.sqrt(shape[1])
            parameters[f"{net}.{layer}.weight"] = weight.astype(np.float32)
            parameters[f"{net}.{layer}.bias"] = np.zeros(shape[0], np.float32)
    parameters["log_std"] = np.full(ACTIONS, START_LOG_STD, np.float32)
    return parameters


class Agent:
    """Actor, critic, and the normalization of observations."""

    def __init__(self, parameters: dict[str, np.ndarray], device: str, lr: float) -> None:
        """Make an agent with the parameters on a device, and the learning rate `lr`."""
        self.device = device
        self.p = {
            k: nova.tensor(v, device=device, requires_grad=True) for k, v in parameters.items()
        }
        self.adam = nova.optim.Adam(list(self.p.values()), lr=lr)
        self.count, self.mean, self.m2 = 1e-4, np.zeros(SEEN), np.zeros(SEEN)

    def observe(self, x: np.ndarray) -> None:
        """Update the running mean and variance by observations {n, 27} (Chan et al. 1983)."""
        n, mean = len(x), x.mean(axis=0)
        delta, total = mean - self.mean, self.count + n
        self.m2 += ((x - mean) ** 2).sum(axis=0) + delta**2 * self.count * n / total
        self.mean += delta * n / total
        self.count = total

    def scale(self) -> np.ndarray:
        """Return the standard deviations of the observations {27}."""
        return np.sqrt(self.m2 / self.count) + 1e-2

    def normal(self, x: np.ndarray) -> np.ndarray:
        """Return normalized observations {n, 27}."""
        return np.clip((x - self.mean) / self.scale(), -10.0, 10.0).astype(np.float32)

    def net(self, name: str, x: nova.Tensor) -> nova.Tensor:
        """Return the output of a network of three layers, "pi" or "v"."""
        h = nova.relu(nova.linear(x, self.p[f"{name}.0.weight"], self.p[f"{name}.0.bias"]))
        h = nova.relu(nova.linear(h, self.p[f"{name}.2.weight"], self.p[f"{name}.2.bias"]))
        return nova.linear(h, self.p[f"{name}.4.weight"], self.p[f"{name}.4.bias"])

    def look(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return action means {n, 8} and values {n} for normalized observations {n, 27}."""
        t = nova.tensor(x, device=self.device)
        return self.net("pi", t).numpy(), self.net("v", t).numpy()[:, 0]

    def loss(self, batch: list[nova.Tensor], entropy: float) -> tuple[nova.Tensor, nova.Tensor]:
        """Return the loss of a minibatch, and the estimated KL divergence from the old policy."""
        x, u, old, advantage, returns = batch
        log_p = nova.gaussian_log_density(u, self.net("pi", x), self.p["log_std"], squashed=False)
        change = log_p - old
        ratio = nova.exp(change)
        gain = nova.minimum(ratio * advantage, nova.clamp(ratio, 1 - CLIP, 1 + CLIP) * advantage)
        error = self.net("v", x).reshape(-1) - returns
        loss = -1.0 * nova.mean(gain) + 0.5 * nova.mean(error * error)
        return loss - entropy * nova.sum(self.p["log_std"]), nova.mean(ratio - 1.0 - change)

    def update(self, data: list[np.ndarray], rng, epochs: int, minibatch: int) -> float:
        """Train for `epochs` epochs on the data. Return the KL divergence at the end."""
        n, divergence = len(data[0]), 0.0
        for _ in range(epochs):
            order = rng.permutation(n)
            for k in range(0, n - minibatch + 1, minibatch):
                rows = order[k : k + minibatch]
                batch = [nova.tensor(a[rows], device=self.device) for a in data]
                with nova.Tape() as tape:
                    loss, gap = self.loss(batch, 1e-3)
                    tape.backward(loss)
                nova.clip_grad_norm_(list(self.p.values()), 1.0)
                self.adam.step()
                self.adam.zero_grad()
            divergence = gap.item()
            if divergence > 0.03:
                break
        # The learning rate adapts to the KL divergence (as in "Learning to walk in minutes", 2021).
        if divergence > 0.02:
            self.adam.lr = max(self.adam.lr / 1.5, 1e-5)
        elif divergence < 0.005:
            self.adam.lr = min(self.adam.lr * 1.5, 1e-3)
        return divergence

    def actor(self) -> dict[str, nova.Tensor]:
        """Return the actor with the normalization folded into its first layer."""
        p = {k: v.numpy() for k, v in self.p.items()}
        first = np.zeros((HIDDEN, OBSERVATIONS))
        first[:, :SEEN] = p["pi.0.weight"] / self.scale()
        bias = p["pi.0.bias"] - first[:, :SEEN] @ self.mean
        values = {
            "latent_pi.0.weight": first,
            "latent_pi.0.bias": bias,
            "latent_pi.2.weight": p["pi.2.weight"],
            "latent_pi.2.bias": p["pi.2.bias"],
            "mu.weight": p["pi.4.weight"],
            "mu.bias": p["pi.4.bias"],
        }
        return {k: nova.tensor(np.float32(v)) for k, v in values.items()}


def reward(ants: AntWorlds, before: np.ndarray, a: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the rewards {n} of a frame that began at coordinates `before` {n, 15}."""
    q = ants.q
    v = (q[:, :2] - before[:, :2]) * 20.0
    up = rotate(q[:, 3:7], np.broadcast_to(np.float32([0, 0, 1]), (len(q), 3)))[:, 2]
    return (
        0.5
        + 2.0 * np.clip(v[:, 0], -1.0, 1.5)
        - 0.5 * np.abs(v[:, 1])
        - 0.02 * (a**2).sum(axis=1)
        - 0.02 * ((a - last) ** 2).sum(axis=1)
        - (1.0 - up)
    )


def collect(agent: Agent, ants: AntWorlds, last: np.ndarray, rng, frames: int):
    """Simulate frames of all worlds. Return training data, last actions, and statistics."""
    n = ants.num_worlds
    xs, us, logs, rewards, values, masks, raw = [], [], [], [], [], [], []
    std = np.exp(agent.p["log_std"].numpy())
    seen = ants.observations()[:, :SEEN]
    speed = fallen = 0.0
    for _ in range(frames):
        raw.append(seen)
        x = agent.normal(seen)
        mean, value = agent.look(x)
        z = rng.standard_normal(mean.shape, np.float32)
        u = mean + std * z
        a = np.tanh(u)
        before = ants.q
        ants.step(a)
        r = reward(ants, before, a, last)
        last = a
        bad = ~ants.healthy() | (r < -20.0) | ~np.isfinite(r)
        r = np.where(bad, -1.0, r).astype(np.float32)
        late = ants.frame >= EPISODE
        speed += np.where(bad, 0.0, (ants.q[:, 0] - before[:, 0]) * 20.0).mean()
        fallen += bad.mean()
        if (late & ~bad).any():  # the value estimates the return after a truncated episode's end
            cut = agent.look(agent.normal(ants.observations()[:, :SEEN]))[1]
            r = r + np.where(late & ~bad, GAMMA * cut, 0.0).astype(np.float32)
        seen = (
            ants.reset(bad | late)[:, :SEEN]
            if (bad | late).any()
            else ants.observations()[:, :SEEN]
        )
        last[bad | late] = 0.0
        xs.append(x)
        us.append(u)
        logs.append((-0.5 * z * z - np.log(std) - 0.9189385332).sum(axis=1))
        rewards.append(r)
        values.append(value)
        masks.append(~(bad | late))
    ahead, advantage = agent.look(agent.normal(seen))[1], np.zeros(n, np.float32)
    advantages = []
    for r, v, mask in zip(reversed(rewards), reversed(values), reversed(masks), strict=True):
        delta = r + GAMMA * ahead * mask - v
        advantage = delta + GAMMA * LAMBDA * mask * advantage
        advantages.append(advantage)
        ahead = v
    advantages = np.concatenate(advantages[::-1])
    returns = (advantages + np.concatenate(values)).astype(np.float32)
    normed = (advantages - advantages.mean()) / (advantages.std() + 1e-6)
    data = [np.concatenate(xs), np.concatenate(us), np.concatenate(logs), normed, returns]
    agent.observe(np.concatenate(raw))
    figures = (float(np.mean(rewards)), speed / frames, fallen / frames * EPISODE)
    return [np.ascontiguousarray(d, np.float32) for d in data], last, figures


def save_checkpoint(path: Path, agent: Agent, steps: int, curve: list[list[float]]) -> None:
    """Write everything that a resumed training needs."""
    arrays = {f"p/{k}": v.numpy() for k, v in agent.p.items()}
    names = list(agent.p)
    arrays |= {f"m/{k}": v.numpy() for k, v in zip(names, agent.adam.m, strict=True)}
    arrays |= {f"v/{k}": v.numpy() for k, v in zip(names, agent.adam.v, strict=True)}
    novaphy.io.save_npz(
        path, **arrays, t=agent.adam.t.numpy(), lr=np.float64(agent.adam.lr), steps=np.int64(steps),
        count=np.float64(agent.count), mean=agent.mean, m2=agent.m2, curve=np.array(curve),
    )  # fmt: skip


def load_checkpoint(path: str, device: str) -> tuple[Agent, int, list[list[float]]]:
    """Load the checkpoint that save_checkpoint wrote."""
    with np.load(path, allow_pickle=False) as file:
        names = [k[2:] for k in file.files if k.startswith("p/")]
        agent = Agent({k: file[f"p/{k}"] for k in names}, device, float(file["lr"]))
        for kind, tensors in (("m", agent.adam.m), ("v", agent.adam.v)):
            for name, tensor in zip(names, tensors, strict=True):
                tensor.assign(file[f"{kind}/{name}"])
        agent.adam.t.assign(file["t"])
        agent.count, agent.mean, agent.m2 = float(file["count"]), file["mean"], file["m2"]
        return agent, int(file["steps"]), file["curve"].tolist()


def main() -> int:
    """Train and write the file. With --evaluate, test the actor on seeds not used in training."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=float, default=8e6, help="frames of all worlds in total")
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--frames", type=int, default=32, help="per update")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--minibatch", type=int, default=8192)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ant", choices=("dva", "gym"), default="dva")
    parser.add_argument("--lr", type=float, default=5e-4)
    parser.add_argument("--device", default="cpu", help="of the networks; worlds run on the CPU")
    parser.add_argument(
        "--coarse", type=float, default=0.8, metavar="PART", help="of the steps with 20 substeps"
    )
    parser.add_argument("--seconds", type=float, default=np.inf, help="stop, with a checkpoint")
    parser.add_argument("--resume", metavar="CHECKPOINT.npz")
    parser.add_argument("--out", default="ant_walker.npz")
    parser.add_argument("--evaluate", type=int, default=100, metavar="N", help="held-out starts")
    args = parser.parse_args()
    out = Path(args.out)
    checkpoint = out.with_suffix(".checkpoint.npz")
    begun = time.perf_counter()
    agent, steps, curve = Agent(fresh(args.seed), args.device, args.lr), 0, []
    if args.resume:
        agent, steps, curve = load_checkpoint(args.resume, args.device)
    ants, last = None, np.zeros((args.worlds, ACTIONS), np.float32)
    while steps < args.steps and time.perf_counter() - begun < args.seconds:
        substeps = 20 if steps < args.coarse * args.steps else 50
        if ants is None or ants.substeps != substeps:
            ants = AntWorlds(
                args.worlds, ant=args.ant, seed=args.seed, substeps=substeps, noise=0.1
            )
            first = np.random.Generator(np.random.Philox(key=[args.seed, 2]))
            ants.frame[:] = first.integers(0, EPISODE, args.worlds)
        if steps == 0:  # before the first update, so that observations are normalized from there on
            collect(agent, ants, last, np.random.default_rng(args.seed), args.frames)
        rng = np.random.Generator(np.random.Philox(key=[args.seed, 3 + steps]))
        start = time.perf_counter()
        data, last, figures = collect(agent, ants, last, rng, args.frames)
        middle = time.perf_counter()
        divergence = agent.update(data, rng, args.epochs, args.minibatch)
        end = time.perf_counter()
        steps += args.worlds * args.frames
        curve.append([steps, *figures, end - begun])
        if len(curve) % 5 == 1:
            print(
                f"{steps / 1e6:6.2f}e6 steps, {end - begun:5.0f} s ({middle - start:.2f} + "
                f"{end - middle:.2f}): reward {figures[0]:6.3f}, {figures[1]:6.3f} m/s, "
                f"{figures[2]:5.2f} falls in 1000 frames, divergence {divergence:.4f}, "
                f"std {np.exp(agent.p['log_std'].numpy()).mean():.3f}, lr {agent.adam.lr:.1e}",
                flush=True,
            )
        if len(curve) % 50 == 0:
            save_checkpoint(checkpoint, agent, steps, curve)
    save_checkpoint(checkpoint, agent, steps, curve)
    meta = {
        "env": "AntWorlds, 20 Hz, 1 ms",
        "ant": args.ant,
        "asset": asset_hash(args.ant),
        "reward": REWARD,
        "seed": args.seed,
        "steps": steps,
        "commit": provenance(),
        "script": shlex.join(["train_ant_ppo.py", *sys.argv[1:]]),
    }
    nova.save_parameters(out, agent.actor(), meta)
    novaphy.io.save_npz(out.with_suffix(".curve.npz"), curve=np.float32(curve))
    if args.evaluate:
        actor, _ = load_actor(out, args.ant)
        result = judge(
            actor, AntWorlds(args.evaluate, ant=args.ant, seed=10_000, noise=0.1), EPISODE
        )
        print(
            f"{args.evaluate} held-out starts: {result['survived'].mean():.0%} survive, "
            f"{result['velocity'].mean():.3f} m/s"
        )
        for name, value in result.items():
            print(f"  {name}: median {np.round(np.median(value, axis=0), 4)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
