"""The scenes that hash_scenes.py hashes. They are small versions of the programs of this folder."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Hashed = dict[str, list[np.ndarray]]
SCENES: dict[str, Callable[[str], Hashed]] = {}
ON_DEVICES: set[str] = set()


def scene(name: str, on_devices: bool = False) -> Callable:
    """Register a scene: a function that takes a device and returns arrays by name."""

    def register(function: Callable[[str], Hashed]) -> Callable[[str], Hashed]:
        SCENES[name] = function
        if on_devices:
            ON_DEVICES.add(name)
        return function

    return register


def steps(model, solver, count: int, dt: float, pipeline=None, control=None) -> Hashed:
    """Run steps from the initial state of a model, with a search for contacts in each step."""
    import novaphy

    now, after = model.state(), model.state()
    start = arrays_of(now)
    if model.joint_count > 0:
        novaphy.eval_fk(model, now.joint_q, now.joint_qd, now)
    contacts = pipeline.contacts() if pipeline else None
    for _ in range(count):
        now.clear_forces()
        if pipeline:
            pipeline.collide(now, contacts)
        solver.step(now, after, control, contacts, dt)
        now, after = after, now
    return {"inputs": start, "states": arrays_of(now)}


def arrays_of(state) -> list[np.ndarray]:
    """Return the positions and velocities of a state."""
    names = ("particle_q", "particle_qd", "body_q", "body_qd", "joint_q", "joint_qd")
    return [getattr(state, name).numpy() for name in names]


def gradients(model, solver, count: int, dt: float, pipeline=None, control=None) -> Hashed:
    """Return the gradient of the sum of squares of a rollout's last state by its first state."""
    import novaphy
    from novaphy import diff, nova

    trajectory = diff.Trajectory(model, count)
    first, last = trajectory[0], trajectory[count]
    kinds = ("particle_q", "particle_qd") if model.particle_count else ("joint_q", "joint_qd")
    leaves = [getattr(diff, f"state_{kind}_tensor")(first, True) for kind in kinds]
    if model.joint_count > 0:
        novaphy.eval_fk(model, first.joint_q, first.joint_qd, first)
    inputs = arrays_of(first)
    arguments = {"pipeline": pipeline} if pipeline else {}
    with nova.Tape() as tape:
        solver.rollout(trajectory, control, None, dt, **arguments)
        q = getattr(diff, f"state_{kinds[0]}_tensor")(last)
        loss = nova.sum(q * q)
    tape.backward(loss)
    grads = [leaf.grad.numpy() for leaf in leaves]
    return {"inputs": inputs, "states": arrays_of(last), "gradients": grads}


@scene("ball", on_devices=True)
def ball(device: str) -> Hashed:
    """Run the scene of novaphy_ball.py: balls thrown at a wall, one training iteration."""
    import novaphy_ball

    balls = novaphy_ball.Balls(20, "rollout", device)
    gradient = balls.gradient(balls.start)
    return {"states": [balls.last.particle_q.numpy()], "gradients": [gradient]}


@scene("soft body", on_devices=True)
def soft_body(device: str) -> Hashed:
    """Run novaphy_deformable.py: tetrahedra, one training iteration of 48 substeps."""
    return deformable("soft_body", 2, 48, device)


@scene("cloth", on_devices=True)
def cloth(device: str) -> Hashed:
    """Run novaphy_deformable.py: triangles and bending edges."""
    return deformable("cloth", 6, 48, device)


def deformable(name: str, n: int, count: int, device: str) -> Hashed:
    import novaphy_deformable

    scene = novaphy_deformable.Deformable(name, n, "captured", count, device)
    inputs = [scene.model.particle_q.numpy(), scene.model.particle_qd.numpy()]
    scene.iterate()  # the update of the parameters is the gradient
    return {
        "inputs": inputs, "states": [scene.positions()], "gradients": [scene.params.numpy()]
    }  # fmt: skip


def boxes(name: str, n: int, device: str, count: int = 10) -> Hashed:
    import novaphy_rigid

    scene = novaphy_rigid.Boxes(name, n, 0.1, 1.0, device)
    inputs = arrays_of(scene.now)
    for _ in range(count):
        scene.step()
    return {"inputs": inputs, "states": arrays_of(scene.now)}


@scene("columns")
def columns(device: str) -> Hashed:
    """Run novaphy_rigid.py: boxes on each other."""
    return boxes("columns", 40, device)


@scene("pile")
def pile(device: str) -> Hashed:
    """Run novaphy_rigid.py: one pile."""
    return boxes("pile", 60, device)


@scene("few columns", on_devices=True)
def few_columns(device: str) -> Hashed:
    """Run novaphy_rigid.py: few enough boxes for the stand-in for a device."""
    return boxes("columns", 12, device, 3)


@scene("mixed")
def mixed(device: str) -> Hashed:
    """Run novaphy_rigid.py: all shapes on a mesh."""
    return boxes("mixed", 25, device, 40)


@scene("dice", on_devices=True)
def dice(device: str) -> Hashed:
    """Run novaphy_rigid.py: one training iteration of dice."""
    import novaphy_rigid

    scene = novaphy_rigid.Dice(3, device)
    scene.step()
    last = scene.trajectory[novaphy_rigid.DIE_SUBSTEPS]
    return {"states": arrays_of(last), "gradients": [scene.spin.grad.numpy()]}


@scene("worlds of stacks")
def stacks(device: str) -> Hashed:
    """Run novaphy_rigid_cuda.py: boxes and a ball, with a search for contacts in every step."""
    import novaphy_rigid_cuda

    import novaphy

    builder = novaphy.ModelBuilder()
    builder.replicate(novaphy_rigid_cuda.stack(), 3)
    model = builder.finalize(device, requires_grad=True)
    pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=48 * 3)
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    from novaphy import diff, nova

    trajectory = diff.Trajectory(model, 24)
    twist = diff.state_body_qd_tensor(trajectory[0], True)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, novaphy_rigid_cuda.DT, pipeline=pipeline)
        end = diff.state_body_qd_tensor(trajectory[24])
        loss = nova.sum(end * end)
    tape.backward(loss)
    return {"states": arrays_of(trajectory[24]), "gradients": [twist.grad.numpy()]}


def vbd_model(device: str, cells: tuple[int, int], sphere: bool):
    import bench_vbd

    import novaphy

    builder = novaphy.ModelBuilder()
    bench_vbd.fill(builder, "novaphy", sphere, cells)
    return builder.finalize(device)


@scene("vbd cloth of 2145")
def vbd_cloth(device: str) -> Hashed:
    """Run bench_vbd.py: a cloth that hangs from its left side."""
    import novaphy

    model = vbd_model(device, (64, 32), False)
    return steps(model, novaphy.solvers.SolverVBD(model, iterations=10), 8, 1 / 300)


@scene("vbd cloth of 200 on a sphere")
def vbd_sphere(device: str) -> Hashed:
    """Run bench_vbd.py: a cloth with contacts and friction."""
    import novaphy

    model = vbd_model(device, (24, 7), True)
    pipeline = novaphy.CollisionPipeline(model)
    solver = novaphy.solvers.SolverVBD(model, iterations=10)
    return steps(model, solver, 90, 1 / 300, pipeline)


@scene("vbd unrolled gradient")
def vbd_unrolled(device: str) -> Hashed:
    """Run bench_vbd.py: the gradient of the iterations."""
    import novaphy

    model = vbd_model(device, (24, 7), False)
    return gradients(model, novaphy.solvers.DiffSolverVBD(model, iterations=10), 5, 1 / 300)


@scene("small vbd cloth on a sphere", on_devices=True)
def vbd_small(device: str) -> Hashed:
    """Run bench_vbd.py: a small cloth on the sphere, with its gradient."""
    import novaphy

    model = vbd_model(device, (6, 3), True)
    model.particle_q.assign(model.particle_q.numpy() + np.float32([0.58, 0.29, -0.042]))
    pipeline = novaphy.CollisionPipeline(model)
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=4)
    return gradients(model, solver, 2, 1 / 300, pipeline)


@scene("vbd implicit gradient")
def vbd_implicit(device: str) -> Hashed:
    """Run bench_vbd.py: the gradient of the step's solution."""
    import novaphy

    model = vbd_model(device, (12, 4), False)
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=10, gradient="implicit")
    return gradients(model, solver, 3, 1 / 300)


@scene("cloth of vbd_step_size")
def step_size(device: str) -> Hashed:
    """Run vbd_step_size.py: explicit steps, and VBD with an adaptive guess."""
    import vbd_step_size

    import novaphy

    model = vbd_step_size.make_model()
    explicit = steps(model, novaphy.solvers.SolverSemiImplicit(model), 20, 1e-3)
    solver = novaphy.solvers.SolverVBD(model, iterations=10, initial_guess="adaptive")
    return explicit | {"implicit states": steps(model, solver, 8, 1e-2)["states"]}


@scene("fr3", on_devices=True)
def fr3(device: str) -> Hashed:
    """Run novaphy_articulation.py: arms that hold a pose by their drives."""
    import novaphy_articulation

    import novaphy

    model = novaphy_articulation.replicated(novaphy_articulation.arm(), 5, device)
    model.joint_qd.assign(np.linspace(-1, 1, 35, dtype=np.float32))
    return steps(model, novaphy.solvers.SolverFeatherstone(model), 50, 1e-3)


@scene("fr3 gradient", on_devices=True)
def fr3_gradient(device: str) -> Hashed:
    """Run novaphy_articulation.py: a rollout of an arm and its adjoint."""
    import novaphy_articulation

    import novaphy

    model = novaphy_articulation.arm().finalize(device, requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    return gradients(model, solver, 20, 1e-3)


@scene("chain of 30", on_devices=True)
def chain(device: str) -> Hashed:
    """Run novaphy_articulation.py: links on hinges."""
    import novaphy_articulation

    import novaphy

    model = novaphy_articulation.chain(30).finalize(device)
    model.joint_qd.assign(np.linspace(-1, 1, 30, dtype=np.float32))
    return steps(model, novaphy.solvers.SolverFeatherstone(model), 40, 1e-3)


def landed_ants(device: str, worlds: int, requires_grad: bool):
    """Return Ants that stand on their feet, and random torques."""
    import novaphy_articulation

    import novaphy

    many = novaphy.ModelBuilder()
    ant = novaphy_articulation.demo_articulated_scenes.build_ant()
    many.replicate(ant, worlds, (3.0, 0.0, 0.0))
    model = many.finalize(device, requires_grad=requires_grad)
    q = model.joint_q.numpy().reshape(worlds, -1)
    q[:, 2] = 0.5 + np.arange(worlds, dtype=np.float32) / 64
    model.joint_q.assign(q.ravel())
    torques = np.linspace(-30, 30, 14 * worlds, dtype=np.float32).reshape(worlds, 14)
    torques[:, :6] = 0.0
    control = model.control()
    control.joint_f.assign(torques.ravel())
    return model, novaphy.CollisionPipeline(model), control


@scene("ant")
def ant(device: str) -> Hashed:
    """Run novaphy_articulation.py: Ants with contacts."""
    import novaphy

    model, pipeline, control = landed_ants(device, 5, False)
    solver = novaphy.solvers.SolverFeatherstone(model)
    return steps(model, solver, 120, 1e-3, pipeline, control)


@scene("ant gradient")
def ant_gradient(device: str) -> Hashed:
    """Run novaphy_articulation.py: the exact gradient through contacts."""
    import novaphy

    model, pipeline, control = landed_ants(device, 2, True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="code"
    )
    return gradients(model, solver, 20, 1e-3, pipeline, control)


@scene("few steps of an ant", on_devices=True)
def ant_few(device: str) -> Hashed:
    """Run novaphy_articulation.py: two Ants, for slow devices."""
    import novaphy

    model, pipeline, control = landed_ants(device, 1, True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="code"
    )
    return gradients(model, solver, 3, 1e-3, pipeline, control)


@scene("ant of the policy")
def ant_policy(device: str) -> Hashed:
    """Run bench_policies.py: frames of the Ant of the policy file."""
    import bench_policies

    from novaphy.envs import AntWorlds

    ants, torques = AntWorlds(3, device=device), bench_policies.torques(3)
    for _ in range(3):
        ants.step(torques)
    return {"inputs": [torques], "states": [ants.q, ants.qd]}


@scene("linear", on_devices=True)
def linear(device: str) -> Hashed:
    """Run novaphy_linear.py: a layer and its gradients."""
    from novaphy import nova

    rng = np.random.default_rng(0)
    inputs = [rng.normal(size=s).astype(np.float32) for s in ((300, 40), (24, 40))]
    leaves = [nova.tensor(v, device=device, requires_grad=True) for v in inputs]
    with nova.Tape() as tape:
        out = nova.linear(*leaves)
        loss = nova.sum(out * out)
    tape.backward(loss)
    return {
        "inputs": inputs, "states": [out.numpy()], "gradients": [x.grad.numpy() for x in leaves]
    }  # fmt: skip
