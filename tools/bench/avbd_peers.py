#!/usr/bin/env python3
"""Time rigid bodies in SolverVBD beside Newton's SolverVBD, MuJoCo and SolverFeatherstone.
stack, stacks: one or 100 stacks of ten boxes (0.2 m, 1,000 kg/m^3, 1e5 N/m) stand for 2 s. Prints
    the overlap of a stack relative to the static law, and the largest speed of the last second.
chain: 10 or 40 hinged links fall for 2 s. The last link may be 100 times as heavy. Prints the
    largest gap of a joint.

All engines take steps of 1/120 s on one thread. Newton's contacts warm start. MuJoCo has the
contacts of its defaults, whose overlap follows another law. Each engine prints a JSON line for each
scene, with the median times of a step and of the search for contacts (us). MuJoCo's time of a step
contains its search. MuJoCo resets a chain that becomes unstable (is_unstable).
    PYTHONPATH=build/tests/python tools/bench/avbd_peers.py --engine novaphy
    tools/bench/avbd_peers.py --engine newton   # pip install newton
    tools/bench/avbd_peers.py --engine mujoco   # pip install mujoco
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("NOVAPHY_NUM_THREADS", "1")

import numpy as np

DT, STEPS, G, DENSITY, KE, MU = 1 / 120, 240, 9.81, 1000.0, 1e5, 0.5
HALF, MASS, LINK = 0.1, 8.0, (0.1, 0.02, 0.02)
CHAINS = ((10, 1.0), (40, 1.0), (10, 100.0), (40, 100.0))
Times = dict[str, list[float]]


def rotated_x(q: np.ndarray) -> np.ndarray:
    """Return the x axis of poses {n, 7} in the world's frame."""
    x, y, z, w = q[:, 3:].T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=1)


def gap_of(q: np.ndarray) -> float:
    """Return the largest gap (m) between the ends of the links with poses {n, 7}."""
    half = LINK[0] * rotated_x(q)
    ends = np.vstack([np.zeros(3), (q[:, :3] + half)[:-1]])
    return float(np.linalg.norm(ends - (q[:, :3] - half), axis=1).max())


class Columns:
    """Boxes in columns of ten, and what their overlap and speed say."""

    def __init__(self, count: int) -> None:
        self.name = "stack" if count == 1 else "stacks"
        k = np.arange(10 * count)
        column, level = k // 10, k % 10
        self.places = np.stack(
            [0.5 * (column % 10), 0.5 * (column // 10), HALF * (2 * level + 1)], axis=1
        )
        self.speeds: list[float] = []

    def see(self, k: int, z: np.ndarray, v: np.ndarray) -> None:
        """Take the heights (m) and velocities (m/s) after step k."""
        self.z = z
        if k >= STEPS - 120:
            self.speeds.append(float(np.abs(v).max()))

    def result(self) -> dict[str, float]:
        """Return the overlap relative to the static law, and the speed (m/s)."""
        law = 55 * MASS * G / (4 * KE)
        return {"sink_over_law": float(1.9 - self.z[9]) / law, "speed": max(self.speeds)}


def same_api(engine: Any, make: Callable[[Any], Any], solver: str, **search: str) -> None:
    """Run the scenes in NovaPhy or Newton, whose builders have the same functions."""
    config = getattr(engine, "ShapeConfig", None) or engine.ModelBuilder.ShapeConfig
    turned = (0.0, 0.0, 0.0, 1.0)

    def run(model: Any, see: Callable[[int, Any], None], collides: bool) -> Times:
        states, control = [model.state(), model.state()], model.control()
        stepper, pipeline = make(model), engine.CollisionPipeline(model, **search)
        contacts, times = pipeline.contacts(), Times(step=[], search=[])
        for k in range(STEPS):
            states[0].clear_forces()
            start = time.perf_counter()
            if collides:
                pipeline.collide(states[0], contacts)
            middle = time.perf_counter()
            stepper.step(states[0], states[1], control, contacts if collides else None, DT)
            times["step"].append(time.perf_counter() - middle)
            times["search"].append(middle - start)
            states.reverse()
            see(k, states[0])
        return times

    for count in (1, 100):
        columns = Columns(count)
        builder, cfg = engine.ModelBuilder(), config(ke=KE, kd=0.0, mu=MU, density=DENSITY)
        builder.add_ground_plane(cfg=cfg)
        for place in columns.places:
            body = builder.add_body(xform=(tuple(place), turned))
            builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=cfg)
        if hasattr(builder, "color"):
            builder.color()

        def look(k: int, s: Any, columns: Columns = columns) -> None:
            columns.see(k, s.body_q.numpy()[:, 2], s.body_qd.numpy()[:, :3])

        report(columns.name, solver, run(builder.finalize(), look, True), columns.result())
    for links, heavy in CHAINS:
        builder, before = engine.ModelBuilder(), -1
        for k in range(links):
            body = builder.add_link(xform=((0.1 + 0.2 * k, 0.0, 0.0), turned))
            cfg = config(density=DENSITY * (heavy if k == links - 1 else 1.0))
            builder.add_shape_box(body, hx=LINK[0], hy=LINK[1], hz=LINK[2], cfg=cfg)
            builder.add_joint_revolute(
                before, body, axis=(0, 1, 0),
                parent_xform=((LINK[0] if k else 0.0, 0, 0), turned),
                child_xform=((-LINK[0], 0, 0), turned),
            )  # fmt: skip
            before = body
        builder.add_articulation(list(range(links)))
        builder.color()
        gaps: list[float] = []

        def measure(k: int, s: Any, gaps: list[float] = gaps) -> None:
            if k % 6 == 0:
                gaps.append(gap_of(s.body_q.numpy().astype(float)))

        times = run(builder.finalize(), measure, False)
        report(f"chain {links} {heavy:g}", solver, times, {"gap_mm": 1e3 * max(gaps)})


def run_novaphy() -> None:
    """Run SolverVBD and SolverFeatherstone."""
    import novaphy

    for solver in ("SolverVBD", "SolverFeatherstone"):
        same_api(novaphy, getattr(novaphy.solvers, solver), f"novaphy {solver}")


def run_newton() -> None:
    """Run Newton's SolverVBD with warm started contacts on the CPU."""
    import newton
    import warp as wp

    wp.config.quiet = True
    wp.set_device("cpu")

    def make(model: Any) -> Any:
        return newton.solvers.SolverVBD(model, iterations=10, rigid_contact_history=True)

    same_api(newton, make, "newton SolverVBD", contact_matching="latest")


def run_mujoco() -> None:
    """Run MuJoCo."""
    import mujoco

    head = f'<mujoco><option timestep="{DT}" integrator="implicitfast"/><worldbody>'

    def run(body: str, see: Callable[[int, Any], None]) -> tuple[Times, bool]:
        model = mujoco.MjModel.from_xml_string(head + body + "</worldbody></mujoco>")
        data, times = mujoco.MjData(model), Times(step=[], search=[])
        for k in range(STEPS):
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            middle = time.perf_counter()
            mujoco.mj_collision(model, data)
            times["step"].append(middle - start)
            times["search"].append(time.perf_counter() - middle)
            see(k, data)
        return times, data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0

    for count in (1, 100):
        columns = Columns(count)
        text = f'<geom type="plane" size="0 0 1" friction="{MU}"/>'
        for x, y, z in columns.places:
            text += (f'<body pos="{x} {y} {z}"><freejoint/><geom type="box" size="{HALF} {HALF} '
                     f'{HALF}" density="{DENSITY}" friction="{MU}"/></body>')  # fmt: skip

        def look(k: int, d: Any, columns: Columns = columns) -> None:
            columns.see(k, d.xpos[1:, 2].copy(), d.qvel.reshape(-1, 6)[:, :3])

        report(columns.name, "mujoco", run(text, look)[0], columns.result())
    for links, heavy in CHAINS:
        text = ""
        for k in range(links):
            density = DENSITY * (heavy if k == links - 1 else 1.0)
            text += (f'<body pos="{2 * LINK[0] if k else LINK[0]} 0 0"><joint axis="0 1 0" '
                     f'pos="{-LINK[0]} 0 0"/><geom type="box" size="{LINK[0]} {LINK[1]} {LINK[2]}" '
                     f'density="{density}" contype="0" conaffinity="0"/>')  # fmt: skip
        times, fails = run(text + "</body>" * links, lambda k, d: None)
        report(f"chain {links} {heavy:g}", "mujoco", times, {"gap_mm": 0.0, "is_unstable": fails})


def report(scene: str, solver: str, times: Times, result: dict[str, float]) -> None:
    """Print a JSON line with the median times (us)."""
    medians = {name: round(1e6 * statistics.median(all_of), 1) for name, all_of in times.items()}
    result = {name: float(f"{value:.4g}") for name, value in result.items()}
    print(json.dumps({"scene": scene, "solver": solver, **medians, **result}), flush=True)


def main() -> None:
    """Print a JSON line for each scene of an engine."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    runs = {"novaphy": run_novaphy, "newton": run_newton, "mujoco": run_mujoco}
    parser.add_argument("--engine", choices=sorted(runs), default="novaphy")
    runs[parser.parse_args().engine]()


if __name__ == "__main__":
    main()
