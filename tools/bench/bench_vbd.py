#!/usr/bin/env python3
"""Time a substep of VBD: a cloth of 64 x 32 cells with bending and damping, 10 iterations.
    python tools/bench/bench_vbd.py [--engine novaphy|newton] [--threads N] [--sphere]
        [--cells X Y] [--device cuda:0] [--capture] [--backward [unrolled|implicit]] [--gradient]

Prints a JSON line: wall and CPU time of a substep (the fastest of several rounds), and a hash of
the last positions. With --sphere the cloth falls on a sphere with friction. --capture replays a
graph of ten substeps.

--backward also measures CPU times of DiffSolverVBD: a step without a tape, a step that a tape
records, and its derivative with all work of the tape. It prints the ratio of the derivative to the
step without a tape. With `implicit` it also prints the residuals.

--gradient also measures the wall time for each substep of a rollout of ten substeps with its
derivative, and a hash of the gradient with respect to the first positions and velocities. On a
device, or with --capture, it replays a graph.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time

import numpy as np

DT, ITERATIONS, WARM_UP, TURNS, CAPTURED = 1.0 / 300.0, 10, 20, 5, 10
GRADIENT_TURNS = 15
CLOTH = {
    "dim_x": 64, "dim_y": 32, "cell_x": 0.02, "cell_y": 0.02, "mass": 4e-4,
    "tri_ke": 1e3, "tri_ka": 1e3, "tri_kd": 1e-2, "edge_ke": 1e-2, "edge_kd": 1e-4,
    "particle_radius": 0.01,
}  # fmt: skip


def fill(builder, engine, sphere, cells):
    """Add the cloth and, if asked for, the sphere to a builder."""
    cloth = CLOTH | {"dim_x": cells[0], "dim_y": cells[1]}
    rotation = (0.0, 0.0, 0.0, 1.0)
    vector, quat = tuple, tuple
    if engine == "newton":
        import warp as wp

        vector, quat = (lambda v: wp.vec3(*v)), (lambda q: wp.quat(*q))
    zero = (0.0, 0.0, 0.0)
    builder.add_cloth_grid(
        pos=vector((-0.64, -0.32, 0.5)), rot=quat(rotation), vel=vector(zero),
        fix_left=not sphere, **cloth,
    )  # fmt: skip
    if sphere:
        pose = ((0.0, 0.0, 0.2), rotation)
        if engine == "newton":
            import warp as wp

            pose = wp.transform(wp.vec3(*pose[0]), wp.quat(*rotation))
        builder.add_shape_sphere(-1, xform=pose, radius=0.25)
    builder.color(include_bending=True)


def novaphy_run(args):
    """Make the NovaPhy model. Return run(substeps) and a function that returns the positions."""
    import novaphy

    if args.threads:
        novaphy.set_num_threads(args.threads)
    builder = novaphy.ModelBuilder()
    fill(builder, "novaphy", args.sphere, args.cells)
    model = builder.finalize(args.device)
    solver = novaphy.solvers.SolverVBD(model, iterations=ITERATIONS)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts() if args.sphere else None
    states = [model.state(), model.state()]

    def run(substeps):
        for _ in range(substeps):
            if contacts is not None:
                pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], None, contacts, DT)
            states.reverse()

    if args.capture:
        from novaphy import nova

        eager = run
        with nova.ScopedCapture() as capture:
            eager(CAPTURED)
        capture.graph.prepare()

        def run(substeps):
            for _ in range(substeps // CAPTURED):
                capture.graph.launch()
            novaphy.synchronize(args.device)

    def backward(kind):
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffSolverVBD(model, iterations=ITERATIONS, gradient=kind)
        states[0].requires_grad = True

        def step():
            solver.step(states[0], states[1], None, contacts, DT)

        def cpu_ms(work):
            start = time.process_time()
            work()
            return 1e3 * (time.process_time() - start)

        turns = []
        for _ in range(GRADIENT_TURNS):
            forward = cpu_ms(step)
            with nova.Tape() as tape:
                recorded = cpu_ms(step)
                loss = nova.sum(diff.state_particle_q_tensor(states[1]))
            turns.append((forward, recorded, cpu_ms(lambda t=tape, end=loss: t.backward(end))))
        forward, recorded, back = (min(times) for times in zip(*turns, strict=True))
        info = solver.gradient_info()
        return {
            "forward_cpu_ms": forward, "recorded_cpu_ms": recorded, "backward_cpu_ms": back,
            "backward_by_forward": back / forward, "primal_residual": info.primal.relative,
            "linear_residual": info.linear_residual, "linear_sweeps": info.linear_sweeps,
        }  # fmt: skip

    def gradient():
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffSolverVBD(model, iterations=ITERATIONS)
        trajectory = diff.Trajectory(model, CAPTURED)
        start, end = trajectory[0], trajectory[CAPTURED]
        start.particle_q.assign(states[0].particle_q.numpy())
        start.particle_qd.assign(states[0].particle_qd.numpy())
        leaves = [
            diff.state_particle_q_tensor(start, True), diff.state_particle_qd_tensor(start, True)
        ]  # fmt: skip

        def iterate():
            for leaf in leaves:
                leaf.zero_grad()
            with nova.Tape() as tape:
                solver.rollout(trajectory, None, contacts, DT)
                q = diff.state_particle_q_tensor(end)
                loss = nova.sum(q * q)
            tape.backward(loss)

        if args.capture or args.device != "cpu":
            with nova.ScopedCapture() as capture:
                iterate()
            capture.graph.prepare()
            iterate = capture.graph.launch
        times = []
        for _ in range(TURNS):
            novaphy.synchronize(args.device)
            start_of_turn = time.perf_counter()
            iterate()
            novaphy.synchronize(args.device)
            times.append((time.perf_counter() - start_of_turn) / CAPTURED)
        found = b"".join(np.ascontiguousarray(leaf.grad.numpy()).tobytes() for leaf in leaves)
        return min(times), hashlib.sha256(found).hexdigest()[:16]

    return run, lambda: states[0].particle_q.numpy(), backward, gradient


def newton_run(args):
    """Make the Newton model on the CPU. Return run(substeps) and a function of the positions."""
    import newton
    import warp as wp

    wp.config.quiet = True
    wp.set_device("cpu")
    builder = newton.ModelBuilder()
    fill(builder, "newton", args.sphere, args.cells)
    model = builder.finalize()
    solver = newton.solvers.SolverVBD(model, iterations=ITERATIONS)
    states, control = [model.state(), model.state()], model.control()
    contacts = model.contacts() if args.sphere else None

    def run(substeps):
        for _ in range(substeps):
            states[0].clear_forces()
            if contacts is not None:
                model.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, DT)
            states.reverse()

    return run, lambda: states[0].particle_q.numpy(), None, None


def main() -> None:
    """Measure, and print the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--engine", choices=("novaphy", "newton"), default="novaphy")
    parser.add_argument("--threads", type=int, help="of NovaPhy; Newton's cpu device has one")
    parser.add_argument("--sphere", action="store_true", help="on a sphere, with friction")
    parser.add_argument("--cells", type=int, nargs=2, default=(64, 32), help="of the cloth")
    parser.add_argument("--device", default="cpu", help="of NovaPhy")
    parser.add_argument("--capture", action="store_true", help="replay a graph")
    parser.add_argument(
        "--backward", nargs="?", const="unrolled", choices=("unrolled", "implicit"),
        help="also the derivative of a step",
    )  # fmt: skip
    parser.add_argument("--gradient", action="store_true", help="also a rollout with its gradient")
    parser.add_argument("--substeps", type=int, default=200, help="of a turn")
    args = parser.parse_args()
    make = novaphy_run if args.engine == "novaphy" else newton_run
    run, positions, backward, gradient = make(args)
    run(WARM_UP)
    wall, cpu = [], []
    for _ in range(TURNS):
        start, used = time.perf_counter(), time.process_time()
        run(args.substeps)
        wall.append((time.perf_counter() - start) / args.substeps)
        cpu.append((time.process_time() - used) / args.substeps)
    result = {
        "engine": args.engine, "threads": args.threads, "sphere": args.sphere,
        "particles": (args.cells[0] + 1) * (args.cells[1] + 1), "device": args.device,
        "wall_ms": 1e3 * min(wall), "cpu_ms": 1e3 * min(cpu),
        "hash": hashlib.sha256(np.ascontiguousarray(positions()).tobytes()).hexdigest()[:16],
    }  # fmt: skip
    if args.backward and backward is not None:
        result |= {"gradient": args.backward} | backward(args.backward)
    if args.gradient and gradient is not None:
        seconds, result["gradient_hash"] = gradient()
        result["gradient_wall_ms"] = 1e3 * seconds
    print(json.dumps(result))


if __name__ == "__main__":
    main()
