#!/usr/bin/env python3
"""Time the parts of policy training: frames of the Ant in four engines, gradients, layers.

A frame of the policy is 1/20 s: 50 steps of 1 ms with contacts, under constant torques. The peers
are MuJoCo, MJX and Newton. Each measurement is a separate process with a given number of threads. A
time is the wall time of the fastest of several rounds. Peers that are not installed are left out,
and the page names them.
    python tools/bench/bench_policies.py           # lines of JSON
    python tools/bench/bench_policies.py --page    # docs/performance-policies.md
    python tools/bench/bench_policies.py --device cuda:0  # only frames on a device
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from run_peers import cpu_name

ROOT = Path(__file__).resolve().parents[2]
WORLDS = (1, 16, 256, 4096)
DEVICE_WORLDS = (1, 16, 256, 1024, 4096, 16384)
THREADS = (1, 2)
SUBSTEPS, DT = 50, 1e-3
FRAMES = 60  # frames of a timed gradient
BY_HAND = "## On a GPU"  # the page from this heading on is kept
LANDED = 20  # frames before the first timed frame
ANT = ROOT / "python" / "novaphy" / "assets" / "ant_heavy.xml"
START_JOINTS = (0, 1, 0, -1, 0, -1, 0, 1)


def fastest(run: Callable[[], object], turns: int) -> float:
    """Return the least wall time of a call (s), of several rounds."""
    run()
    times = []
    for _ in range(turns):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def turns_of(worlds: int) -> int:
    """Return the number of rounds, which is smaller for large batches."""
    return 10 if worlds < 1000 else 3


def torques(worlds: int) -> np.ndarray:
    """Return random torques {worlds, 8}, relative to the gear of the motors."""
    return np.random.default_rng(0).uniform(-0.3, 0.3, (worlds, 8)).astype(np.float32)


def novaphy_frames(worlds: int, device: str | None = None) -> dict[str, object]:
    """Time frames of AntWorlds with their observations."""
    from novaphy.envs import AntWorlds

    ants, a = AntWorlds(worlds, device=device), torques(worlds)
    for _ in range(LANDED):
        ants.step(a)
    where = hashlib.sha256(ants.q.tobytes()).hexdigest()[:16]
    seconds = fastest(lambda: (ants.step(a), ants.observations()), turns_of(worlds))
    return {"seconds": seconds, "hash": where}


def mujoco_frames(worlds: int) -> dict[str, object]:
    """Time MuJoCo on the same file, with its own contacts. Many worlds use all threads."""
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_path(str(ANT))
    model.opt.timestep, data = DT, mujoco.MjData(model)
    data.qpos[7:] = START_JOINTS
    data.ctrl[:] = torques(1)[0]
    mujoco.mj_step(model, data, nstep=LANDED * SUBSTEPS)
    if worlds == 1:
        return {"seconds": fastest(lambda: mujoco.mj_step(model, data, nstep=SUBSTEPS), 10)}
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros(size)
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states = np.tile(state, (worlds, 1))
    control = np.repeat(torques(worlds)[:, None].astype(float), SUBSTEPS, axis=1)
    threads = int(os.environ["NOVAPHY_NUM_THREADS"])
    several = [mujoco.MjData(model) for _ in range(threads)]
    with rollout.Rollout(nthread=threads) as roll:
        seconds = fastest(
            lambda: roll.rollout(model, several, states, control, nstep=SUBSTEPS), turns_of(worlds)
        )
    return {"seconds": seconds}


def mjx_frames(worlds: int) -> dict[str, object]:
    """Time MJX on the same file, compiled by XLA for the CPU."""
    import jax
    import mujoco
    from mujoco import mjx

    plain = mujoco.MjModel.from_xml_path(str(ANT))
    plain.opt.timestep = DT
    model = mjx.put_model(plain)
    data = mjx.make_data(plain)
    data = data.replace(qpos=data.qpos.at[7:].set(np.array(START_JOINTS, float)))

    @jax.jit
    def frame(data, control):
        def one(d, c):
            d = d.replace(ctrl=c)
            return jax.lax.fori_loop(0, SUBSTEPS, lambda _, x: mjx.step(model, x), d)

        return jax.vmap(one)(data, control)

    many = jax.tree_util.tree_map(lambda x: jax.numpy.stack([x] * worlds), data)
    a = jax.numpy.asarray(torques(worlds))
    for _ in range(2):
        many = jax.block_until_ready(frame(many, a))
    seconds = fastest(lambda: jax.block_until_ready(frame(many, a)), 2)
    return {"seconds": seconds}


def newton_frames(worlds: int) -> dict[str, object]:
    """Time Newton's SolverFeatherstone with penalty contacts on the CPU, on the same file."""
    import newton
    import warp as wp

    wp.config.quiet = True
    wp.set_device("cpu")
    one = newton.ModelBuilder()
    one.add_mjcf(str(ANT), up_axis="Z")
    many = newton.ModelBuilder()
    many.replicate(one, worlds)
    model = many.finalize()
    solver = newton.solvers.SolverFeatherstone(model)
    states, control = [model.state(), model.state()], model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, states[0])
    contacts = model.contacts()

    def frame() -> None:
        for _ in range(SUBSTEPS):
            states[0].clear_forces()
            model.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, DT)
            states.reverse()
        wp.synchronize()

    return {"seconds": fastest(frame, 2)}


def gradient(kind: str) -> dict[str, object]:
    """Time the gradient of the loss of 60 frames by the actor's 80 parameters, in segments."""
    sys.path[:0] = [str(ROOT / "python" / "demos"), str(ROOT / "python" / "demos" / "diff")]
    import demo_diffsim_ant_from_scratch as demo

    actor = demo.load(str(demo.GAIT), "dva")
    trainer = demo.Trainer(actor, kind, "dva", candidates=1)
    weights, kept = actor.weights[None], []

    def forward() -> None:
        kept[:] = [x[:, 0, 0] for x in trainer.rollouts(weights, FRAMES)[1]]

    def both() -> None:
        forward()
        trainer.gradients(*kept)

    return {"forward": fastest(forward, 5), "seconds": fastest(both, 5)}


def adjoint(_: str) -> dict[str, object]:
    """Time 60 recorded frames of an Ant, and one adjoint through all of them."""
    from novaphy import CollisionPipeline, diff, eval_fk, nova
    from novaphy.envs import AntWorlds
    from novaphy.solvers import DiffFeatherstoneSolver

    ants, a = AntWorlds(1), torques(1)
    for _ in range(LANDED):
        ants.step(a)
    model = ants.model
    solver, pipeline = DiffFeatherstoneSolver(model), CollisionPipeline(model)
    steps = FRAMES * SUBSTEPS
    trajectory, control = diff.Trajectory(model, steps), model.control()
    control.joint_f.assign(ants.joint_forces(a).ravel())
    control.joint_f.requires_grad = True
    first = trajectory[0]
    first.joint_q.assign(ants.q.ravel())
    first.joint_qd.assign(ants.qd.ravel())
    eval_fk(model, first.joint_q, first.joint_qd, first)

    def run() -> None:
        with nova.Tape() as tape:
            solver.rollout(trajectory, control, None, DT, pipeline=pipeline)
            loss = nova.sum(diff.state_joint_q_tensor(trajectory[steps]))
        tape.backward(loss)

    return {"seconds": fastest(run, 5)}


def layers(_: str) -> dict[str, object]:
    """Time a linear layer (4096 x 256 times 256 x 256) and its gradients."""
    script = Path(__file__).with_name("novaphy_linear.py")
    told = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    return json.loads(told.stdout)


PARTS: dict[str, Callable] = {
    "novaphy": novaphy_frames,
    "mujoco": mujoco_frames,
    "mjx": mjx_frames,
    "newton": newton_frames,
    "gradient": gradient,
    "adjoint": adjoint,
    "layers": layers,
}


def measure(part: str, what: object, threads: int, seconds: float) -> dict[str, object]:
    """Run a measurement in a separate process. Return its result, or the reason for a failure."""
    number = str(threads)
    environment = {
        **os.environ,
        "NOVAPHY_NUM_THREADS": number,
        "OMP_NUM_THREADS": number,
        "OPENBLAS_NUM_THREADS": number,
        "JAX_PLATFORMS": "cpu",
    }
    found: dict[str, object] = {"part": part, "what": what, "threads": threads}
    command = [sys.executable, __file__, "--part", part, "--what", str(what)]
    try:
        told = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=seconds, check=True
        )
        found |= json.loads(told.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired:
        found["missing"] = f"more than {seconds:.0f} s"
    except subprocess.CalledProcessError as error:
        last = (error.stderr.strip().splitlines() or ["no output"])[-1]
        absent = last.startswith(("ImportError", "ModuleNotFoundError"))
        found["missing"] = "not installed" if absent else last[:160]
    print(json.dumps(found), flush=True)
    return found


def everything(seconds: float) -> list[dict[str, object]]:
    """Run all measurements of the page. Return their rows."""
    found: list[dict[str, object]] = []
    gone: set[str] = set()  # packages that are not installed
    for worlds in WORLDS:
        for threads in THREADS:
            for part in ("novaphy", "mujoco", "mjx", "newton"):
                if part not in gone:
                    found.append(measure(part, worlds, threads, seconds))
                if found[-1].get("missing") == "not installed":
                    gone.add(part)
    found += [measure("gradient", kind, 1, seconds) for kind in ("frozen", "exact")]
    return [
        *found,
        measure("adjoint", "exact", 1, seconds),
        measure("layers", "linear", 1, seconds),
    ]


def version(package: str) -> str:
    """Return the version of an installed package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def cell(row: dict[str, object], worlds: int) -> str:
    """Return the frames of all worlds per second as text."""
    return f"{worlds / row['seconds']:,.0f}" if "seconds" in row else "–"


def page(rows: list[dict[str, object]], load: float) -> str:
    """Return the text of docs/performance-policies.md."""
    by = {(r["part"], r["what"], r["threads"]): r for r in rows}
    lines = [
        "# Performance of policies",
        "",
        "Written by `tools/bench/bench_policies.py --page`, but for the last part.",
        "",
        f"On {cpu_name()}, Python {platform.python_version()}, by the clock, the fastest of some",
        f"turns. Load average before the first: {load:.1f}"
        + (" (other work ran beside: times are upper bounds)." if load > 0.5 else "."),
        "",
        "## Frames of the Ant per second, all worlds together",
        "",
        "A frame is 1/20 s, 50 steps of 1 ms with contacts found anew, under torques. The others",
        "read the same file. Contacts and limits are each engine's own, so the motions differ.",
        "NovaPhy solves contacts by projected Gauss-Seidel, MuJoCo and MJX solve soft contacts by",
        "Newton's method. Newton runs SolverFeatherstone with penalty contacts, launched step by",
        "step, without torques. MuJoCo computes in float64, the others in float32.",
        "",
        "| worlds | threads | NovaPhy | "
        + " | ".join(
            f"{name} {version(package)}"
            for name, package in (
                ("MuJoCo", "mujoco"), ("MJX", "mujoco-mjx"), ("Newton", "newton"))
        )
        + " |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for worlds in WORLDS:
        for threads in THREADS:
            cells = [
                cell(by.get((part, worlds, threads), {}), worlds)
                for part in ("novaphy", "mujoco", "mjx", "newton")
            ]
            lines.append(f"| {worlds:,} | {threads} | {' | '.join(cells)} |")
    missing = sorted({f"{r['part']}: {r['missing']}" for r in rows if "missing" in r})
    lines += ["", *(f"A dash is {text}." for text in missing), *([""] if missing else [])]
    lines += [
        f"## {FRAMES} frames and their gradient, one world, one thread",
        "",
        "The first two rows time a rollout and the derivatives of its frames, as in training from",
        "zero. The frames are the worlds of one batch. The Gauss-Newton matrices have segments of",
        "4, 8 and 16 frames. The third row is one adjoint through all steps.",
        "",
        "| part | s | asked |",
        "|---|---|---|",
    ]
    for what, key, asked in (
        ("forward and frozen derivatives", ("gradient", "frozen", 1), 0.1),
        (
            "forward and exact derivatives, an adjoint for each row",
            ("gradient", "exact", 1),
            "",
        ),
        ("forward, recorded, and one exact adjoint", ("adjoint", "exact", 1), 0.25),
    ):
        row = by[key]
        lines.append(f"| {what} | {row.get('seconds', float('nan')):.3f} | {asked} |")
    forward = by["gradient", "frozen", 1].get("forward")
    if forward:
        lines.append(f"| the rollout alone | {forward:.3f} | |")
    layer = by["layers", "linear", 1]
    if "missing" not in layer:
        lines += [
            "",
            f"## A layer, 4,096 rows of 256 by 256, beside torch {version('torch')}, one thread",
            "",
            "| part | NovaPhy, ms | torch, ms | ratio | asked |",
            "|---|---|---|---|---|",
        ]
        lines += [
            f"| {name} | {layer[f'{name}_ms']} | {layer[f'{name}_torch_ms']} | "
            f"{layer[f'{name}_ratio']} | at most 3 |"
            for name in ("forward", "gradient")
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the measurements, then print or write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page of the results")
    parser.add_argument("--limit", type=float, default=180.0, help="seconds of a measurement")
    parser.add_argument("--part", choices=PARTS, help="one measurement, in this process")
    parser.add_argument("--device", help="NovaPhy's frames there, and nothing else")
    parser.add_argument("--what", default="1", help="its number of worlds, or its kind")
    args = parser.parse_args()
    if args.part:
        if args.part == "mjx" and hasattr(os, "sched_setaffinity"):  # XLA uses all visible cores
            cores = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, cores[: int(os.environ["NOVAPHY_NUM_THREADS"])])
        what = int(args.what) if args.what.isdigit() else args.what
        print(json.dumps(PARTS[args.part](what)))
        return
    if args.device:
        for worlds in DEVICE_WORLDS:
            row = {"worlds": worlds, **novaphy_frames(worlds, args.device)}
            print(json.dumps(row | {"frames/s": round(worlds / row["seconds"])}), flush=True)
        return
    load = os.getloadavg()[0]
    rows = everything(args.limit)
    if args.page:
        path = ROOT / "docs" / "performance-policies.md"
        by_hand = path.read_text("utf-8").partition(BY_HAND)
        path.write_text("\n".join([page(rows, load), "".join(by_hand[1:])]), "utf-8")


if __name__ == "__main__":
    main()
