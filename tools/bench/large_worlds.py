#!/usr/bin/env python3
"""Time one large world on one thread of the CPU.

Scenes:
* `cubes`: N x N x N cubes of 10 cm, face to face on a plane, `SolverFeatherstone` with default
  options at 1/240 s. Times a search with all gaps, a search for the step (`dt`), and the step.
* `terrain`: 20 boxes of 0.5 m on hills of 2 N² triangles, in cells of 2.5 cm, with the default
  gaps of shapes. Times the construction of the pipeline, and searches.
* `resting`: N boxes of 10 cm at rest in columns of ten, and a ball that is thrown at them. Times
  steps with the search, with and without `--sleep`.

Prints a JSON line for each size: medians of CPU time (s).
    NOVAPHY_NUM_THREADS=1 python tools/bench/large_worlds.py --scene cubes --n 8
    NOVAPHY_NUM_THREADS=1 python tools/bench/large_worlds.py --scene terrain --n 707
    NOVAPHY_NUM_THREADS=1 python tools/bench/large_worlds.py --scene resting --n 100000 --sleep
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np

import novaphy

SIDE, DT, CELL, HALF = 0.1, 1.0 / 240, 0.025, 0.25


def median_time(repeats: int, run: Callable[[], object]) -> float:
    """Return the median CPU time of a run (s)."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return statistics.median(times)


def cubes(n: int, repeats: int) -> dict[str, object]:
    """Time cubes that rest on each other."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for place in np.ndindex(n, n, n):
        at = SIDE * (np.array(place) + np.array([0.0, 0.0, 0.5]))
        body = builder.add_body(xform=(*map(float, at), 0.0, 0.0, 0.0, 1.0))
        builder.add_shape_box(body, hx=SIDE / 2, hy=SIDE / 2, hz=SIDE / 2)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=200 * n**3)
    solver = novaphy.solvers.SolverFeatherstone(model)
    found, now, then = pipeline.contacts(), model.state(), model.state()

    def step() -> None:
        nonlocal now, then
        pipeline.collide(now, found, dt=DT)
        solver.step(now, then, None, found, DT)
        now, then = then, now

    facts: dict[str, object] = {"step_s": median_time(repeats, step)}
    facts["search_of_step_s"] = median_time(repeats, lambda: pipeline.collide(now, found, dt=DT))
    facts["rows_of_step"] = int(found.rigid_contact_count.numpy()[0])
    facts["search_s"] = median_time(repeats, lambda: pipeline.collide(now, found))
    facts["rows"] = int(found.rigid_contact_count.numpy()[0])
    facts["top_m"] = float(now.body_q.numpy()[:, 2].max())
    assert not found.overflowed
    return facts


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the hills (m)."""
    return 0.25 * np.sin(1.3 * x) * np.sin(1.1 * y)


def terrain(n: int, repeats: int) -> dict[str, object]:
    """Time boxes whose lowest points touch the hills."""
    line = (np.arange(n + 1) - n / 2) * CELL
    x, y = np.meshgrid(line, line)
    z = height(x, y)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    row = n + 1
    corner = (np.arange(n)[:, None] * row + np.arange(n)).reshape(-1, 1)
    triangles = np.concatenate([corner + np.array(k) for k in ((0, 1, row + 1), (0, row + 1, row))])
    builder = novaphy.ModelBuilder()
    builder.add_shape_mesh(-1, mesh=novaphy.io.Mesh(vertices, triangles.astype(np.int32)))
    random = np.random.default_rng(1)
    reach = 0.4 * n * CELL
    for _ in range(20):
        at = random.uniform(-reach, reach, 2)
        below = (np.abs(x - at[0]) < 1.2 * HALF) & (np.abs(y - at[1]) < 1.2 * HALF)
        pose = (*map(float, at), float(z[below].max()) + HALF - 1e-3)
        turn = random.uniform(0.0, 1.5)
        body = builder.add_body(xform=(*pose, 0.0, 0.0, np.sin(turn), np.cos(turn)))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF)
    model = builder.finalize()
    start = time.process_time()
    pipeline = novaphy.CollisionPipeline(model)
    found, state = pipeline.contacts(), model.state()
    pipeline.collide(state, found)
    facts: dict[str, object] = {"first_s": time.process_time() - start, "triangles": len(triangles)}
    facts["search_s"] = median_time(repeats, lambda: pipeline.collide(state, found))
    facts["rows"] = int(found.rigid_contact_count.numpy()[0])
    return facts


def resting(n: int, repeats: int, solver: str, sleeps: bool) -> dict[str, object]:
    """Time n resting boxes in columns of ten, at which a ball is thrown."""
    surface = novaphy.ShapeConfig(ke=2e4, kd=40.0, kf=40.0, mu=0.5, gap=0.002)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    weight = 1000.0 * SIDE**3 * 9.81
    wide = max(1, round((n / 10) ** 0.5))
    for k in range(n):
        column, level = divmod(k, 10)
        sunk = sum(weight * (10 - i) / (4 * surface.ke) for i in range(level + 1))
        at = (2 * SIDE * (column % wide), 2 * SIDE * (column // wide), SIDE * (level + 0.5) - sunk)
        if solver == "featherstone":
            at = (*at[:2], SIDE * (level + 0.5))
        body = builder.add_body(xform=(*at, 0.0, 0.0, 0.0, 1.0))
        builder.add_shape_box(body, hx=SIDE / 2, hy=SIDE / 2, hz=SIDE / 2, cfg=surface)
    ball = builder.add_body(xform=(-SIDE, 0.0, 100.0, 0.0, 0.0, 0.0, 1.0))
    builder.add_shape_sphere(ball, radius=SIDE / 2, cfg=surface)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=12 * n)
    makers = {
        "semi-implicit": novaphy.solvers.SolverSemiImplicit,
        "featherstone": novaphy.solvers.SolverFeatherstone,
    }
    dt = 1e-3 if solver == "semi-implicit" else DT
    sleep = novaphy.SleepConfig(speed=0.02, spin=0.2, after=10 * dt) if sleeps else None
    steps = makers[solver](model, sleep=sleep)
    found, now, then = pipeline.contacts(), model.state(), model.state()

    def step() -> None:
        nonlocal now, then
        pipeline.collide(now, found, dt=dt)
        steps.step(now, then, None, found, dt)
        now, then = then, now

    for _ in range(round(2.0 / dt) if sleeps else 20):
        step()
        if (now.body_sleep.numpy()[:ball, 0] < 0).all():
            break
    asleep = int((now.body_sleep.numpy()[:, 0] < 0).sum())
    pose, speed = now.body_q.numpy(), now.body_qd.numpy()
    pose[ball] = (-SIDE, 0.0, 5.0 * SIDE, 0.0, 0.0, 0.0, 1.0)
    speed[ball] = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for state, field in ((pose, now.body_q), (speed, now.body_qd)):
        field.assign(state)
    if solver == "featherstone":
        novaphy.eval_ik(model, now, now.joint_q, now.joint_qd)
    facts: dict[str, object] = {"solver": solver, "sleep": sleeps, "asleep": asleep}
    facts["step_s"] = median_time(repeats, step)
    facts["asleep_behind"] = int((now.body_sleep.numpy()[:, 0] < 0).sum())
    facts["rows"] = int(found.rigid_contact_count.numpy()[0])
    facts["search_s"] = median_time(repeats, lambda: pipeline.collide(now, found, dt=dt))
    return facts


def main() -> None:
    """Run one scene for each size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", choices=("cubes", "terrain", "resting"), default="cubes")
    parser.add_argument("--n", type=int, nargs="+", default=[8])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--solver", choices=("semi-implicit", "featherstone"))
    parser.add_argument("--sleep", action="store_true")
    arguments = parser.parse_args()
    for n in arguments.n:
        if arguments.scene == "resting":
            solver = arguments.solver or "semi-implicit"
            facts = resting(n, arguments.repeats, solver, arguments.sleep)
        else:
            facts = (cubes if arguments.scene == "cubes" else terrain)(n, arguments.repeats)
        print(json.dumps({"scene": arguments.scene, "n": n} | facts), flush=True)


if __name__ == "__main__":
    main()
