"""Scenes and an independent test of crossings for self-contact in SolverVBD."""

from __future__ import annotations

import numpy as np

import novaphy

CLOTH = {"tri_ke": 1e3, "tri_ka": 1e3, "tri_kd": 1e-3, "edge_ke": 1e-4, "edge_kd": 1e-6}


def edges_of(triangles: np.ndarray) -> np.ndarray:
    """The edges {n, 2} of triangles, each once."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(sides, axis=1), axis=0)


def crossings(q: np.ndarray, triangles: np.ndarray, edges: np.ndarray) -> int:
    """How many edges pass through triangles without a common corner, in float64."""
    q = np.asarray(q, np.float64)
    ends, corners = q[edges], q[triangles]
    lows, highs = ends.min(1), ends.max(1)
    low, high = corners.min(1), corners.max(1)
    axis = int(np.argmax(q.max(0) - q.min(0)))
    order = np.argsort(low[:, axis])
    longest = (high - low)[:, axis].max()
    begin = np.searchsorted(low[order, axis], lows[:, axis] - longest)
    end = np.searchsorted(low[order, axis], highs[:, axis], side="right")
    count = end - begin
    e = np.repeat(np.arange(len(edges)), count)
    t = order[np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - begin, count)]
    for k in range(3):
        meet = (lows[e, k] <= high[t, k]) & (low[t, k] <= highs[e, k])
        e, t = e[meet], t[meet]
    apart = ~(edges[e][:, :, None] == triangles[t][:, None, :]).any((1, 2))
    p, s = ends[e[apart], 0], ends[e[apart], 1]
    a, b, c = (corners[t[apart], k] for k in range(3))

    def volume(o, x, y, z):
        return np.einsum("ij,ij->i", np.cross(x - o, y - o), z - o)

    sides = volume(a, b, c, p) * volume(a, b, c, s) < 0
    ring = np.stack([volume(p, s, a, b), volume(p, s, b, c), volume(p, s, c, a)])
    return int((sides & ((ring > 0).all(0) | (ring < 0).all(0))).sum())


def finalized(builder: novaphy.ModelBuilder, ke: float = 1e3, kd: float = 1e-3, mu: float = 0.3):
    builder.color()
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = ke, kd, mu
    return model


def sheet_on_edge(cells: int = 24) -> novaphy.Model:
    """A sheet of 2 cm cells that stands on its edge, a little bent, above the ground."""
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(ke=1e3, kd=1e-2, mu=0.5)
    builder.add_ground_plane()
    half = np.sqrt(0.5)
    builder.add_cloth_grid(
        pos=(0.0, 0.0, 0.03), rot=(half, 0.0, 0.0, half), dim_x=cells, dim_y=cells, cell_x=0.02,
        cell_y=0.02, mass=2e-4, particle_radius=0.004, **CLOTH,
    )  # fmt: skip
    q = np.array(builder.particle_q)
    q[:, 1] += 0.01 * np.sin(6.0 * q[:, 0] + 9.0 * q[:, 2])
    builder.particle_q = q
    return finalized(builder)


def grid(builder, *, pos, cells, cell=0.02, vel=(0.0, 0.0, 0.0), **options) -> None:
    builder.add_cloth_grid(
        pos=pos, vel=vel, dim_x=cells, dim_y=cells, cell_x=cell, cell_y=cell,
        **({"mass": 2e-4, "particle_radius": 0.003} | CLOTH | options),
    )  # fmt: skip


class Rollout:
    """Steps a model, and counts the crossings after each step."""

    def __init__(self, solver, model: novaphy.Model) -> None:
        self.solver, self.model = solver, model
        self.pipeline = novaphy.CollisionPipeline(model) if model.shape_count else None
        self.contacts = self.pipeline.contacts() if self.pipeline else None
        self.state, self.after = model.state(), model.state()
        self.triangles = model.tri_indices.numpy().reshape(-1, 3)
        self.edges = edges_of(self.triangles)
        self.crossed = 0

    def step(self, dt: float, targets=None, counts: bool = True) -> np.ndarray:
        if self.pipeline:
            self.pipeline.collide(self.state, self.contacts)
        self.solver.step(self.state, self.after, None, self.contacts, dt, targets=targets)
        self.state, self.after = self.after, self.state
        q = self.state.particle_q.numpy()
        if counts:
            self.crossed += crossings(q, self.triangles, self.edges)
        return q
