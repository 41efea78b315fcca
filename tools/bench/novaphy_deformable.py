#!/usr/bin/env python3
"""Time training iterations of NovaPhy on a soft body and on cloth.

deformable.py in this folder describes the scenes and records. Contacts of the soft body are
evaluated in every substep at the true distance. Modes:

* `step`: a Python loop of `clear_forces` and `DiffSemiImplicitSolver.step`, recorded on a new tape
  in every iteration.
* `rollout`: one call of `rollout`, recorded on a new tape in every iteration.
* `captured`: the `rollout` iteration, captured once with `nova.ScopedCapture` and replayed. The
  tape keeps the gradients of leaves only.

    python tools/bench/novaphy_deformable.py --scene soft_body cloth --n 16 --mode captured
"""

from __future__ import annotations

import numpy as np
from deformable import BOUNDS, DT, GAP, MATERIAL, RATE, TARGET, cloth_grid, run, soft_grid

import novaphy
from novaphy import diff, nova

MODES = ("step", "rollout", "captured")


class Deformable:
    """A scene and its training iteration."""

    def __init__(self, scene: str, n: int, mode: str, steps: int, device: str) -> None:
        """Build the model, and capture the iteration when asked to."""
        self.scene, self.mode = scene, mode
        builder = novaphy.ModelBuilder()
        soft = scene == "soft_body"
        if soft:
            builder.default_particle_radius = 0.0005
            grid = soft_grid(n)
            builder.add_soft_grid(**grid)
            # In Newton each particle has the mass of a cell.
            mass = grid["cell_x"] * grid["cell_y"] * grid["cell_z"] * grid["density"]
            builder.particle_mass = [mass] * builder.particle_count
            shape = novaphy.ShapeConfig(**MATERIAL)
            wall = ((0.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0))
            builder.add_shape_box(-1, xform=wall, hx=1.0, hy=0.25, hz=1.0, cfg=shape)
            builder.add_ground_plane(cfg=shape)
        else:
            builder.default_particle_radius = 0.01
            builder.add_cloth_grid(**cloth_grid(n))
        self.model = builder.finalize(device, requires_grad=True)
        for name, value in MATERIAL.items():
            setattr(self.model, f"soft_contact_{name}", value)
        config = novaphy.solvers.DiffSolverConfig(
            enable_tetrahedra=soft,
            enable_triangles=True,
            enable_bending=not soft,
            enable_static_contacts=soft,
            static_contact_margin=GAP,
            contact_gradient="code",  # as in captures
        )
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        if mode == "step":
            self.states = [self.model.state() for _ in range(steps + 1)]
            self.first, self.last = self.states[0], self.states[-1]
        else:
            self.trajectory = diff.Trajectory(self.model, steps)
            self.first, self.last = self.trajectory[0], self.trajectory[steps]
        self.control = self.model.control()
        if soft:
            self.materials = diff.model_tet_material_tensor(self.model)
            self.base = nova.tensor(self.materials.numpy(), device=device)
            start = self.materials.numpy()[:, :2].ravel()
            self.params = nova.tensor(start, device=device, requires_grad=True)
        else:
            self.params = diff.state_particle_qd_tensor(self.first, requires_grad=True)
        self.graph = None
        if mode == "captured":
            with nova.ScopedCapture() as capture:
                self.loss = self.record()
            self.graph = capture.graph

    def record(self) -> nova.Tensor:
        """Record one training iteration on a new tape. Return the loss before the update."""
        with nova.Tape(leaf_gradients_only=True) as tape:
            if self.scene == "soft_body":
                count = self.model.tet_count
                self.materials.copy_(
                    diff.assign_tet_materials_generated(self.params, self.base, count)
                )
            if self.mode == "step":
                for before, after in zip(self.states, self.states[1:]):
                    before.clear_forces()
                    self.solver.step(before, after, self.control, None, DT)
            else:
                self.solver.rollout(self.trajectory, self.control, None, DT)
            centroid = diff.particle_centroid_generated(diff.state_particle_q_tensor(self.last))
            loss = diff.vec3_point_loss_generated(centroid, *TARGET[self.scene])
            tape.backward(loss)
            nova.sgd_update_f32(self.params, RATE[self.scene])
            if self.scene == "soft_body":
                nova.clamp_(self.params, *BOUNDS)
            tape.zero()
        return loss

    def iterate(self) -> None:
        """Run one training iteration."""
        if self.graph is not None:
            self.graph.launch()
        else:
            self.loss = self.record()
        novaphy.synchronize(str(self.model.device))

    def prepare(self) -> None:
        """Wait until replays are as fast as they get."""
        if self.graph is not None:
            self.graph.prepare()

    def loss_value(self) -> float:
        """Return the loss of the last iteration, before its update."""
        return self.loss.item()

    def positions(self) -> np.ndarray:
        """Return the final positions of the last iteration {n, 3} (m)."""
        return self.last.particle_q.numpy()

    def elements(self) -> int:
        """Return the number of tetrahedra or triangles."""
        return self.model.tet_count if self.scene == "soft_body" else self.model.tri_count


def facts() -> dict[str, object]:
    """Return the facts about the engine for the record."""
    return {
        "version": novaphy.__version__,
        "threads": novaphy.num_threads(),
    }


if __name__ == "__main__":
    run(__doc__, "novaphy", MODES, Deformable, facts)
