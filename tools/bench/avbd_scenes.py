#!/usr/bin/env python3
"""Compare SolverVBD and SolverFeatherstone on rigid bodies with closed-form results.
stack: ten boxes (0.2 m, 1,000 kg/m^3) with a contact stiffness of 1e5 or 1e7 N/m stand still.
    Prints the overlap relative to the static law, and the largest speed after 2 s.
slide: a box slides until it stops. Prints the distance relative to v^2/(2 mu g), at steps of
    1/120 and 1/240 s.
chain: 10 or 40 links without contacts hang from the world and start level. The last link may be
    100 times as heavy. Prints the largest gap of a joint, and the energy above that of the start.
sheet: a box meets a free sheet of 0.34 kg, without gravity. Prints the lost momentum relative to
    the transferred momentum. Only SolverVBD.
hammock: a ball of 5 kg falls into a sheet with two fixed borders. Prints the contact force relative
    to the ball's weight, and the ball's speed, after 2 s. Only SolverVBD.
tower, stacks, arch, cards: a box of 20 or 1,000 times the mass on two boxes, 100 stacks of ten, an
    arch of wedges, and two cards that lean against each other stand. Prints the largest distance
    from the start (mm), and the largest speed of the last second. Only SolverVBD.
cable: a level cable of 0.5 m in 20 or 200 links, fixed at one end, sinks to rest. Prints the error
    of its tip relative to the sag of its own equilibrium in float64, and the largest gap. Only
    SolverVBD.

Each scene and solver prints a JSON line with the median time of a step (us), without the search for
contacts.
    PYTHONPATH=build/tests/python tools/bench/avbd_scenes.py
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import novaphy
from novaphy.solvers import SolverFeatherstone, SolverVBD

G, DENSITY, MU, HALF = 9.81, 1000.0, 0.5, 0.1
IDENTITY = (0.0, 0.0, 0.0, 1.0)
SOLVERS: dict[str, Callable[[novaphy.Model], Any]] = {
    "vbd": SolverVBD,
    "featherstone": SolverFeatherstone,
}


def box_builder(ke: float) -> novaphy.ModelBuilder:
    """Return a builder with a ground of contact stiffness ke (N/m)."""
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=ke, kd=0.0, mu=MU, density=DENSITY)
    builder.add_ground_plane()
    return builder


def add_box(builder: novaphy.ModelBuilder, z: float) -> int:
    """Add a box of 8 kg."""
    body = builder.add_body(xform=((0.0, 0.0, z), IDENTITY))
    builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF)
    return body


def chain(links: int, heavy: float) -> novaphy.Model:
    """Return a model of a level chain of links of 0.2 m, the last one `heavy` times as heavy."""
    builder, before = novaphy.ModelBuilder(), -1
    for k in range(links):
        density = DENSITY * (heavy if k == links - 1 else 1.0)
        body = builder.add_link(xform=((0.1 + 0.2 * k, 0.0, 0.0), IDENTITY))
        config = novaphy.ShapeConfig(density=density)
        builder.add_shape_box(body, hx=0.1, hy=0.02, hz=0.02, cfg=config)
        builder.add_joint_revolute(
            before, body, axis=(0, 1, 0), parent_xform=((0.1 if k else 0.0, 0, 0), IDENTITY),
            child_xform=((-0.1, 0, 0), IDENTITY),
        )  # fmt: skip
        before = body
    builder.add_articulation(list(range(links)))
    return builder.finalize()


def run(
    solver: Any,
    steps: int,
    dt: float,
    see: Callable[[int, novaphy.State], None],
    collides: bool = True,
) -> tuple[novaphy.State, float]:
    """Run steps of a solver. Return the last state and the median time of a step (us)."""
    model = solver.model
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    times = []
    for k in range(steps):
        if collides:
            pipeline.collide(state, contacts)
        before = time.perf_counter()
        solver.step(state, after, None, contacts, dt)
        times.append(time.perf_counter() - before)
        state, after = after, state
        see(k, state)
    return state, 1e6 * statistics.median(times)


def stack(make: Callable, ke: float, seconds: float) -> dict[str, float]:
    """Let a stack of ten boxes stand. Return its overlap and speed."""
    builder = box_builder(ke)
    for k in range(10):
        add_box(builder, HALF * (2 * k + 1))
    speeds = [0.0]

    def see(k: int, state: novaphy.State) -> None:
        if k >= 240:
            speeds.append(float(np.abs(state.body_qd.numpy()[:, :3]).max()))

    state, us = run(make(builder.finalize()), int(120 * seconds), 1 / 120, see)
    law = 55 * 8 * G / (4 * ke)
    sink = float(1.9 - state.body_q.numpy()[9, 2])
    return {"ke": ke, "sink_over_law": sink / law, "speed_from_2_s": max(speeds), "us": us}


def slide(make: Callable, rate: int) -> dict[str, float]:
    """Let a box with 2.58 m/s slide until it stops. Return its distance."""
    builder = box_builder(1e5)
    body = add_box(builder, HALF - 8 * G / 4e5)
    builder.body_qd[body] = (2.58, 0, 0, 0, 0, 0)
    state, us = run(make(builder.finalize()), rate, 1 / rate, lambda k, state: None)
    way = float(state.body_q.numpy()[0, 0])
    return {"rate": rate, "way_over_law": way / (2.58**2 / (2 * MU * G)), "us": us}


def rotations(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of quaternions {n, 4}."""
    x, y, z, w = q.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.eye(3) + 2 * w[:, None, None] * cross + 2 * cross @ cross


def swing(make: Callable, links: int, heavy: float) -> dict[str, float]:
    """Let a level chain fall. Return the largest gap and energy."""
    model = chain(links, heavy)
    mass, inertia = model.body_mass.numpy().astype(float), model.body_inertia.numpy().astype(float)
    gaps, energies = [], []

    def see(k: int, state: novaphy.State) -> None:
        if k % 6:
            return
        q, v = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
        turn = rotations(q[:, 3:])
        half = 0.1 * turn[:, :, 0]
        ends = np.vstack([np.zeros(3), (q[:, :3] + half)[:-1]])
        gaps.append(np.linalg.norm(ends - (q[:, :3] - half), axis=1).max())
        spin = np.einsum("bij,bj->bi", turn @ inertia @ turn.transpose(0, 2, 1), v[:, 3:])
        squares = mass * (v[:, :3] ** 2).sum(1) + (spin * v[:, 3:]).sum(1)
        energies.append(0.5 * squares.sum() + G * mass @ q[:, 2])

    _, us = run(make(model), 600, 1 / 120, see, collides=False)
    return {
        "links": links, "heavy": heavy, "gap_mm": 1e3 * float(max(gaps)),
        "energy_above_start_J": float(max(0.0, *energies)), "us": us,
    }  # fmt: skip


def add_sheet(builder: novaphy.ModelBuilder, cells: int, tri_ke: float, fixed: bool) -> None:
    """Add a square sheet of cells of 5 cm around the z axis, 2 g for each particle."""
    edge = -0.025 * cells
    builder.add_cloth_grid(
        pos=(edge, edge, 0), dim_x=cells, dim_y=cells, cell_x=0.05, cell_y=0.05, mass=2e-3,
        tri_ke=tri_ke, tri_ka=tri_ke, tri_kd=1e-3 * tri_ke, edge_ke=1e-3, particle_radius=0.01,
        fix_left=fixed, fix_right=fixed,
    )  # fmt: skip


def finalize(builder: novaphy.ModelBuilder) -> novaphy.Model:
    """Return the model, whose soft contacts have the material of the shapes without damping."""
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd = 1e4, 0.0
    return model


def sheet(mass: float) -> dict[str, Any]:
    """Let a box of a mass meet a free sheet. Return the loss of momentum."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    config = novaphy.ShapeConfig(ke=1e4, kd=0.0, mu=MU, density=mass / 0.008)
    add_sheet(builder, 12, 1e3, fixed=False)
    body = builder.add_body(xform=((0.03, 0.0, 0.12), IDENTITY))
    builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=config)
    builder.body_qd[body] = (0.0, 0.0, -2.0, 0.0, 0.0, 0.0)
    model = finalize(builder)
    masses = model.particle_mass.numpy().astype(float)
    state, us = run(SolverVBD(model), 12, 1 / 240, lambda k, state: None)
    speed = float(state.body_qd.numpy()[body, 2])
    handed = mass * (speed + 2.0)
    lost = handed + float(masses @ state.particle_qd.numpy()[:, 2].astype(float))
    return {"mass": mass, "lost": abs(lost) / handed, "speed": speed, "us": us}


def hammock(guess: str) -> dict[str, Any]:
    """Let a ball fall into a hammock. Return the force of its contacts over its weight."""
    builder = novaphy.ModelBuilder()
    density = 5.0 / (4 / 3 * np.pi * HALF**3)
    add_sheet(builder, 12, 2e3, fixed=True)
    body = builder.add_body(xform=((0.0, 0.0, 0.12), IDENTITY))
    config = novaphy.ShapeConfig(ke=1e4, kd=0.0, mu=MU, density=density)
    builder.add_shape_sphere(body, radius=HALF, cfg=config)
    state, us = run(
        SolverVBD(finalize(builder), initial_guess=guess), 240, 1 / 120, lambda k, state: None
    )
    apart = state.body_q.numpy()[body, 2] - state.particle_q.numpy()[:, 2]
    distance = np.linalg.norm(state.body_q.numpy()[body, :3] - state.particle_q.numpy(), axis=1)
    force = 1e4 * float((apart * (HALF + 0.01 - distance).clip(0) / distance).sum())
    speed = float(np.abs(state.body_qd.numpy()[body, :3]).max())
    return {"guess": guess, "force_over_weight": force / (5.0 * G), "speed": speed, "us": us}


def stand(builder: novaphy.ModelBuilder, seconds: float) -> dict[str, float]:
    """Let bodies stand. Return their largest way from the start and speed of the last second."""
    model = builder.finalize()
    speeds = []

    def see(k: int, state: novaphy.State) -> None:
        if k >= 120 * (seconds - 1):
            speeds.append(float(np.abs(state.body_qd.numpy()[:, :3]).max()))

    state, us = run(SolverVBD(model), int(120 * seconds), 1 / 120, see)
    way = np.linalg.norm((state.body_q.numpy() - model.body_q.numpy())[:, :3], axis=1)
    return {"way_mm": 1e3 * float(way.max()), "speed": max(speeds), "us": us}


def tower(ratio: float, ke: float) -> dict[str, float]:
    """Let a heavy box stand on two boxes. Return its way over the static law."""
    builder = box_builder(ke)
    add_box(builder, HALF)
    add_box(builder, 3 * HALF)
    top = builder.add_body(xform=((0.0, 0.0, 5 * HALF), IDENTITY))
    config = novaphy.ShapeConfig(ke=ke, kd=0.0, mu=MU, density=DENSITY * ratio)
    builder.add_shape_box(top, hx=HALF, hy=HALF, hz=HALF, cfg=config)
    law = 1e3 * 8 * G / (4 * ke) * (3 + 3 * ratio)
    stood = stand(builder, 60.0)
    return {"ratio": ratio, "ke": ke, "way_over_law": stood["way_mm"] / law, **stood}


def stacks() -> dict[str, float]:
    """Let 100 stacks of ten boxes stand for 5 s."""
    builder = box_builder(1e6)
    for k in range(1000):
        place = (0.5 * (k % 10), 0.5 * (k // 10 % 10), HALF * (2 * (k // 100) + 1))
        body = builder.add_body(xform=(place, IDENTITY))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF)
    return stand(builder, 5.0)


def arch(stones: int, ke: float) -> dict[str, float]:
    """Let a half ring of wedges without mortar stand for 10 s."""
    builder = box_builder(ke)
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=ke, kd=0.0, mu=0.8, density=DENSITY)
    for k in range(stones):
        angles = np.pi * np.array([k, k + 1]) / stones
        corners = np.array(
            [(r * np.cos(a), y, r * np.sin(a))
             for r in (0.8, 1.1) for a in angles for y in (-0.15, 0.15)]
        )  # fmt: skip
        middle = corners.mean(axis=0)
        body = builder.add_body(xform=(tuple(middle), IDENTITY))
        builder.add_shape_convex_hull(body, vertices=(corners - middle).astype(np.float32))
    return {"stones": stones, "ke": ke, **stand(builder, 10.0)}


def cards(ke: float) -> dict[str, float]:
    """Let two cards of 3 mm and 20 degrees lean against each other for 10 s."""
    builder = box_builder(ke)
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=ke, kd=0.0, mu=0.8, density=800.0)
    angle, height, half = np.radians(20.0), 0.05, 0.0015
    x = float(height * np.sin(angle) + half * np.cos(angle))
    z = float(height * np.cos(angle) + half * np.sin(angle))
    for side in (-1, 1):
        turn = (0.0, float(-side * np.sin(0.5 * angle)), 0.0, float(np.cos(0.5 * angle)))
        body = builder.add_body(xform=((side * x, 0.0, z), turn))
        builder.add_shape_box(body, hx=half, hy=0.04, hz=height)
    return {"ke": ke, **stand(builder, 10.0)}


def slopes_at_rest(links: int, length: float, bend: float, weight: float) -> np.ndarray:
    """Return the slopes (rad) of a level rod of a weight (N) whose first link is fixed.

    The links are rigid. The energy is the sum of (bend links/length)/2 (difference of slopes)^2 and
    the potential of the weight; bend: E I (N m^2). Newton's method finds its minimum.
    """
    k = bend * links / length
    below = weight / links * length / links * (links - np.arange(links) - 0.5)
    stiffness = k * (2 * np.eye(links) - np.eye(links, k=1) - np.eye(links, k=-1))
    stiffness[-1, -1] = k
    slopes = np.zeros(links)
    for _ in range(100):
        force = (stiffness @ slopes + below * np.cos(slopes))[1:]
        hessian = (stiffness - np.diag(below * np.sin(slopes)))[1:, 1:]
        change = np.linalg.solve(hessian, force)
        slopes[1:] -= change * min(1.0, 0.2 / max(float(np.abs(change).max()), 1e-12))
    return slopes


def cable_model(links: int, bend: float) -> novaphy.Model:
    """Return a level cable of 0.5 m with a radius of 5 mm, fixed at its start."""
    builder = novaphy.ModelBuilder()
    points = [(0.5 * k / links, 0.0, 0.0) for k in range(links + 1)]
    bodies, _ = builder.add_rod(
        points, radius=0.005, cfg=novaphy.ShapeConfig(density=DENSITY), bend_stiffness=bend,
        bend_damping=0.15 * bend,
    )  # fmt: skip
    builder.add_joint_fixed(-1, bodies[0], parent_xform=builder.body_q[bodies[0]])
    return builder.finalize()


def cable(links: int, bend: float, steps: int) -> dict[str, Any]:
    """Let a cable sink to rest. Return the error of its tip over the sag, and the largest gap."""
    model = cable_model(links, bend)
    slopes = slopes_at_rest(links, 0.5, bend, G * float(model.body_mass.numpy().sum()))
    tip = 0.5 / links * np.array([np.cos(slopes).sum(), np.sin(slopes).sum()])
    ends, gaps = np.zeros(2), []

    def see(k: int, state: novaphy.State) -> None:
        q = state.body_q.numpy().astype(float)
        half = 0.25 / links * rotations(q[:, 3:])[:, :, 2]
        gaps.append(np.linalg.norm((q[:-1, :3] + half[:-1]) - (q[1:, :3] - half[1:]), axis=1).max())
        ends[:] = (q[-1, :3] + half[-1])[[0, 2]]

    _, us = run(SolverVBD(model), steps, 1 / 120, see, collides=False)
    error = float(np.linalg.norm(ends - tip) / abs(tip[1]))
    return {
        "links": links, "sag_mm": -1e3 * float(tip[1]), "tip_over_sag": error,
        "gap_mm": 1e3 * float(max(gaps)), "us": us,
    }  # fmt: skip


def main() -> None:
    """Print a JSON line for each scene and solver."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="how long the stack stands")
    args = parser.parse_args()
    for name, make in SOLVERS.items():
        records = [("stack", lambda make=make, ke=ke: stack(make, ke, args.seconds))
                   for ke in (1e5, 1e7)]  # fmt: skip
        records += [
            ("slide", lambda make=make, rate=rate: slide(make, rate)) for rate in (120, 240)
        ]
        records += [
            ("chain", lambda make=make, n=n, heavy=heavy: swing(make, n, heavy))
            for n in (10, 40)
            for heavy in (1.0, 100.0)
        ]
        if name == "vbd":
            records += [("sheet", lambda mass=mass: sheet(mass)) for mass in (0.0034, 0.34, 34.0)]
            records += [
                ("hammock", lambda guess=guess: hammock(guess)) for guess in ("inertia", "previous")
            ]
            records += [
                ("tower", lambda ratio=ratio, ke=ke: tower(ratio, ke))
                for ratio in (20.0, 1000.0)
                for ke in (1e6, 1e7)
            ]
            records += [("arch", lambda n=n, ke=ke: arch(n, ke)) for n in (7, 11)
                        for ke in (1e5, 1e6)]  # fmt: skip
            records += [("cards", lambda ke=ke: cards(ke)) for ke in (1e4, 1e5)]
            records += [("stacks", stacks)]
            records += [
                ("cable", lambda case=case: cable(*case))
                for case in ((20, 0.05, 300), (20, 5e-3, 900), (200, 0.05, 300))
            ]
        for scene, record in records:
            print(json.dumps({"scene": scene, "solver": name, **record()}), flush=True)


if __name__ == "__main__":
    main()
