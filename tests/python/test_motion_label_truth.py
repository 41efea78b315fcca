"""Labels of gradients of the motion: what is called exact of the code has the bits of the code."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 2e-3
PAIRS = [("sphere", "sphere"), ("box", "sphere"), ("capsule", "box"), ("box", "box")]


def turned(rng: np.random.Generator) -> tuple[float, ...]:
    q = rng.normal(size=4)
    return tuple(map(float, q / np.linalg.norm(q)))


class Pair:
    """Two free bodies that approach each other, at random poses, as articulations."""

    def __init__(self, kinds: tuple[str, str], seed: int) -> None:
        rng = np.random.default_rng(seed)
        surface = novaphy.ShapeConfig(
            mu=float(rng.choice([0.0, 0.4])),
            restitution=float(rng.choice([0.0, 0.5])),
            gap=0.1,
            density=0.0,
        )
        builder = novaphy.ModelBuilder(gravity=0.0)
        away = rng.normal(size=3)
        away /= np.linalg.norm(away)
        for kind, at in zip(kinds, (0.0 * away, 0.26 * away), strict=True):
            body = builder.add_body(
                xform=(tuple(map(float, at)), turned(rng)),
                mass=float(rng.uniform(0.5, 2.0)),
                inertia=np.diag(rng.uniform(0.004, 0.008, 3)),
            )
            if kind == "sphere":
                builder.add_shape_sphere(body, radius=0.1, cfg=surface)
            elif kind == "capsule":
                builder.add_shape_capsule(body, radius=0.06, half_height=0.1, cfg=surface)
            else:
                builder.add_shape_box(body, hx=0.1, hy=0.08, hz=0.07, cfg=surface)
        self.model = builder.finalize(requires_grad=True)
        self.qd = rng.normal(size=12) * 0.3
        self.qd[6:9] -= away
        self.weights = rng.normal(size=14).astype(np.float32), rng.normal(size=12)

    def gradient(
        self, mode: str, steps: int, slop: float
    ) -> tuple[np.ndarray, novaphy.solvers.GradientInfo]:
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffFeatherstoneSolver(
            self.model, pgs_slop=slop, pgs_erp=1.0 if slop == 0.0 else 0.2, contact_gradient=mode
        )
        path = diff.Trajectory(self.model, steps)
        path[0].joint_qd.assign(self.qd.astype(np.float32))
        novaphy.eval_fk(self.model, path[0].joint_q, path[0].joint_qd, path[0])
        pipeline = novaphy.CollisionPipeline(self.model)
        with nova.Tape() as tape:
            solver.rollout(path, None, None, DT, pipeline=pipeline)
            end = diff.state_joint_q_tensor(path[steps])
            tape.backward(nova.sum(end * nova.tensor(self.weights[0])))
        found = path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()
        assert tape.gradient_info().label == solver.gradient_info().label
        return np.concatenate(found), solver.gradient_info()


@pytest.mark.parametrize("kinds", PAIRS, ids=["-".join(kinds) for kinds in PAIRS])
def test_a_label_of_the_code_means_the_bits_of_the_code(kinds: tuple[str, str]) -> None:
    labels: dict[str, int] = {}
    for seed in range(5):
        pair = Pair(kinds, seed)
        for slop in (0.0, 0.005):  # with a slop nothing is claimed of the motion
            for steps in (1, 40, 90):
                code, _ = pair.gradient("code", steps, slop)
                motion, info = pair.gradient("motion", steps, slop)
                labels[info.label] = labels.get(info.label, 0) + 1
                same = np.array_equal(code, motion)
                if info.label == "exact of the code" or not info.event_list:
                    assert same, (seed, slop, steps, info.reason)
                if same:
                    continue
                assert info.label in ("exact of the motion", "surrogate")
                if info.label == "surrogate":
                    assert 0 < info.surrogate_steps <= len(info.event_list)
                    assert "is not that of the code" in info.reason
    assert labels.get("surrogate", 0) > 0 and labels.get("exact of the motion", 0) > 0, labels


def test_a_landing_that_the_end_cuts_says_so_after_one_step() -> None:
    """A box falls on a ball: the only step closes the gap, and the gradient has its time."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    surface = novaphy.ShapeConfig(mu=0.0, restitution=0.0, gap=0.1, density=0.0)
    inertia = np.eye(3) * 0.005
    ball = builder.add_body(mass=1.0, inertia=inertia)
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    box = builder.add_body(
        xform=((0.02, 0.01, 0.1715), (0.0, 0.0, 0.0, 1.0)), mass=1.0, inertia=inertia
    )
    builder.add_shape_box(box, hx=0.1, hy=0.08, hz=0.07, cfg=surface)
    pair = Pair(PAIRS[1], 0)
    pair.model = builder.finalize(requires_grad=True)
    pair.qd = np.float32([0.0] * 8 + [-1.0] + [0.0] * 3)
    code, of_code = pair.gradient("code", 1, 0.0)
    motion, info = pair.gradient("motion", 1, 0.0)
    assert of_code.label == "exact of the code" and not np.array_equal(code, motion)
    assert info.label == "surrogate" and info.surrogate_steps == 1 and info.exact_steps == 0
    assert "cut by the end of the steps" in info.reason
