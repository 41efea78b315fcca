"""Forward derivatives of steps with contacts and dry friction: the transpose of the gradient."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contact_gradients import CASES, box, walker
from test_articulation_parameter_gradients import arm, walker_with_friction

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 0.01
STATES = ("joint_q", "joint_qd")
BODIES = ("gravity", "body_mass", "body_com", "body_inertia")
JOINTS = tuple(f"joint_{name}" for name in ("friction", "damping", "target_ke", "target_kd"))
MODEL = BODIES + JOINTS
MATERIALS = tuple(f"shape_material_{name}" for name in ("mu", "restitution", "ke", "kd"))
SPRINGS = {"target_ke": 30.0, "target_kd": 0.5, "target_q": 0.2, "damping": 0.1, "armature": 0.01}


def bouncing_box():
    """A box of which some corners bounce, and others are deep in the ground."""
    builder = box(0.3, restitution=0.7)
    builder.joint_q[2:7] = [0.085, 0.05, 0.2, 0.0, np.sqrt(1.0 - 0.0425)]
    builder.joint_qd[2:6] = [-1.0, 0.5, 1.0, 0.1]
    return builder


MORE_CASES = {
    "bouncing box": (bouncing_box, {}, None),
    "walker with drives in the ground": (lambda: walker(0.03, **SPRINGS), {}, None),
    "legs in each other": (lambda: walker(-0.05, 0.09, **SPRINGS), {}, None),
    "hips slide": (lambda: walker_with_friction(0.2), {}, None),
    "hips stick": (lambda: walker_with_friction(200.0), {}, None),
    "hinges slide and stick": (lambda: arm(0.3, 5.0), {}, None),
    "hinges slide": (lambda: arm(0.3, 0.1), {}, None),
}


@pytest.mark.parametrize("case", [*CASES, *MORE_CASES])
def test_a_tangent_is_the_gradient_along_it(case: str) -> None:
    from novaphy import diff, nova
    from novaphy.diff import (
        state_body_q_tensor,
        state_body_qd_tensor,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    build, options, _ = {**CASES, **MORE_CASES}[case]
    model = build().finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=5000, **options, contact_gradient="code"
    )
    state, after = model.state(requires_grad=True), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    contacts = None
    names = MODEL
    if model.shape_count > 0:
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        names += MATERIALS
    for name in names:
        getattr(model, name).requires_grad = True
    rng = np.random.default_rng(11)

    def weighted(tensor):
        return nova.sum(tensor * nova.tensor(rng.normal(size=tensor.shape).astype(np.float32)))

    with nova.Tape() as tape:
        solver.step(state, after, None, contacts, DT)
        loss = weighted(state_joint_q_tensor(after)) + weighted(state_joint_qd_tensor(after))
        loss = loss + weighted(state_body_q_tensor(after)) + weighted(state_body_qd_tensor(after))
        places = [(state, name) for name in STATES] + [(model, name) for name in names]
        arrays = [getattr(owner, name) for owner, name in places]
        inputs = [
            getattr(diff, f"{'state' if owner is state else 'model'}_{name}_tensor")(owner)
            for owner, name in places
        ]
        directions = [rng.normal(size=array.numpy().shape).astype(np.float32) for array in arrays]
        found = [
            tape.jvp([loss], [one], [nova.tensor(along)])[0].item()
            for one, along in zip(inputs, directions, strict=True)
        ]
        tape.backward(loss)
    for (_, name), array, along, value in zip(places, arrays, directions, found, strict=True):
        gradient = array.grad.numpy().astype(float)
        expected = float((gradient * along).sum())
        scale = np.linalg.norm(gradient) * np.linalg.norm(along)
        assert value == pytest.approx(expected, rel=1e-3, abs=2e-5 * scale + 1e-5), name
    assert max(abs(x) for x in found) > 0.1
