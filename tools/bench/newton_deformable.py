#!/usr/bin/env python3
"""Time training iterations of Newton on a soft body and on cloth.

deformable.py describes scenes and records. The rollout and its backward pass are captured once with
`wp.ScopedCapture` and replayed, as in the examples. Modes:
* `captured`: the examples without changes.
* `captured-lean`: without the kernels that have no effect in these scenes: no hash grid of the
  particles (`model.particle_grid = None`), no kernel over (triangle, particle) pairs
  (`enable_tri_contact=False`).
* `captured-bare`: as `captured-lean`, and without the 1,000 empty slots for rigid contacts
  (`rigid_contact_max=0`).

    pip install newton==1.8.0 warp-lang==1.19.0
    python tools/bench/newton_deformable.py --scene soft_body --n 2 4 --mode captured-lean
"""

from __future__ import annotations

from importlib.metadata import version

import newton
import numpy as np
import warp as wp
from deformable import BOUNDS, DT, GAP, MATERIAL, RATE, TARGET, cloth_grid, run, soft_grid

MODES = ("captured", "captured-lean", "captured-bare")


@wp.kernel
def assign_kernel(params: wp.array[wp.float32], materials: wp.array2d[wp.float32]):
    """Write the Lamé parameters of one tetrahedron."""
    tid = wp.tid()
    materials[tid, 0] = params[2 * tid]
    materials[tid, 1] = params[2 * tid + 1]


@wp.kernel
def centroid_kernel(q: wp.array[wp.vec3], centroid: wp.array[wp.vec3]):
    """Add one particle to the centroid."""
    wp.atomic_add(centroid, 0, q[wp.tid()] / wp.float32(q.shape[0]))


@wp.kernel
def loss_kernel(centroid: wp.array[wp.vec3], target: wp.vec3, loss: wp.array[float]):
    """Compute the squared distance of the centroid to the target."""
    delta = centroid[0] - target
    loss[0] = wp.dot(delta, delta)


@wp.kernel
def descend_kernel(
    x: wp.array[float], grad: wp.array[float], rate: float, lower: float, upper: float
):
    """Take one step of gradient descent within bounds."""
    tid = wp.tid()
    x[tid] = wp.clamp(x[tid] - grad[tid] * rate, lower, upper)


class Deformable:
    """A scene and its training iteration."""

    def __init__(self, scene: str, n: int, mode: str, steps: int, device: str) -> None:
        """Build the model and capture the iteration."""
        wp.set_device(device)
        self.scene, self.steps = scene, steps
        self.lean, bare = mode != "captured", mode == "captured-bare"
        builder = newton.ModelBuilder()
        if scene == "soft_body":
            builder.default_particle_radius = 0.0005
            builder.add_soft_grid(**self.with_types(soft_grid(n)))
            shape = newton.ModelBuilder.ShapeConfig(**MATERIAL)
            wall = wp.transform(wp.vec3(0.0, 2.0, 1.0), wp.quat_identity())
            builder.add_shape_box(body=-1, xform=wall, hx=1.0, hy=0.25, hz=1.0, cfg=shape)
            builder.add_ground_plane(cfg=shape)
        else:
            builder.default_particle_radius = 0.01
            builder.add_cloth_grid(**self.with_types(cloth_grid(n)))
        self.model = builder.finalize(requires_grad=True)
        for name, value in MATERIAL.items():
            setattr(self.model, f"soft_contact_{name}", value)
        if self.lean:
            self.model.particle_grid = None
        self.solver = newton.solvers.SolverSemiImplicit(self.model)
        self.solver.enable_tri_contact = scene == "soft_body" and not self.lean
        self.states = [self.model.state() for _ in range(steps + 1)]
        self.control = self.model.control()
        self.pipeline = None
        if scene == "soft_body":
            self.pipeline = newton.CollisionPipeline(
                self.model,
                broad_phase="explicit",
                soft_contact_gap=GAP,
                requires_grad=True,
                rigid_contact_max=0 if bare else None,
            )
            start = self.model.tet_materials.numpy()[:, :2].flatten()
            self.params = wp.array(start, dtype=wp.float32, requires_grad=True)
            self.bounds = BOUNDS
        else:
            self.params = self.states[0].particle_qd
            self.bounds = (-1.0e30, 1.0e30)
        self.centroid = wp.zeros(1, dtype=wp.vec3, requires_grad=True)
        self.loss = wp.zeros(1, dtype=wp.float32, requires_grad=True)
        with wp.ScopedCapture() as capture:
            self.forward_backward()
        self.graph = capture.graph

    @staticmethod
    def with_types(arguments: dict) -> dict:
        """Return the arguments with vectors and quaternions as types of Warp."""
        return arguments | {
            "pos": wp.vec3(*arguments["pos"]),
            "rot": wp.quat(*arguments["rot"]),
            "vel": wp.vec3(*arguments["vel"]),
        }

    def forward_backward(self) -> None:
        """Record and run the rollout and its backward pass."""
        self.tape = wp.Tape()
        self.centroid.zero_()
        with self.tape:
            if self.scene == "soft_body":
                wp.launch(
                    assign_kernel,
                    dim=self.model.tet_count,
                    inputs=[self.params],
                    outputs=[self.model.tet_materials],
                )
            for before, after in zip(self.states, self.states[1:]):
                before.clear_forces()
                contacts = None
                if self.pipeline is not None:  # new contacts in every substep, as in the example
                    contacts = self.pipeline.contacts()
                    self.pipeline.collide(before, contacts)
                self.solver.step(before, after, self.control, contacts, DT)
            last = self.states[-1].particle_q
            wp.launch(centroid_kernel, dim=len(last), inputs=[last, self.centroid])
            target = wp.vec3(*TARGET[self.scene])
            wp.launch(loss_kernel, dim=1, inputs=[self.centroid, target, self.loss])
        self.tape.backward(self.loss)

    def iterate(self) -> None:
        """Run one training iteration."""
        self.tape.zero()
        wp.capture_launch(self.graph)
        grad = self.params.grad
        x = self.params
        if self.scene == "cloth":
            x, grad = (
                wp.array(ptr=a.ptr, dtype=wp.float32, shape=3 * len(a), device=a.device)
                for a in (x, grad)
            )
        inputs = [x, grad, RATE[self.scene], *self.bounds]
        wp.launch(descend_kernel, dim=len(x), inputs=inputs)
        wp.synchronize_device()

    def prepare(self) -> None:
        """Do nothing, because no work runs beside the iterations."""

    def loss_value(self) -> float:
        """Return the loss of the last iteration, before its update."""
        return float(self.loss.numpy()[0])

    def positions(self) -> np.ndarray:
        """Return the final positions of the last iteration {n, 3} (m)."""
        return self.states[-1].particle_q.numpy()

    def elements(self) -> int:
        """Return the number of tetrahedra or triangles."""
        return self.model.tet_count if self.scene == "soft_body" else self.model.tri_count


def facts() -> dict[str, object]:
    """Return the facts about the engine for the record."""
    return {"version": version("newton"), "warp": wp.__version__, "device": str(wp.get_device())}


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    run(__doc__, "newton", MODES, Deformable, facts)
