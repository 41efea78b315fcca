"""tape.backward(record=True) and tape.adjoint_record(): the gradient step by step."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT, RADIUS, GAP = 1e-3, 0.1, 0.03


def balls(offset: float = 0.0, restitution: float = 0.7, mu: float = 0.0) -> novaphy.Model:
    """Two balls on the x axis, the second one moved by `offset` along y, without gravity."""
    of = novaphy.ShapeConfig(restitution=restitution, mu=mu, density=0, gap=0.05)
    builder = novaphy.ModelBuilder(gravity=0.0)
    for place, mass in (((0, 0, 0), 1.0), ((2 * RADIUS + GAP, offset, 0), 0.5)):
        body = builder.add_body(xform=(place, UPRIGHT), mass=mass, inertia=np.eye(3) * 0.004)
        builder.add_shape_sphere(body, radius=RADIUS, cfg=of)
    return builder.finalize(requires_grad=True)


def solver(model: novaphy.Model, mode: str) -> novaphy.solvers.DiffFeatherstoneSolver:
    return novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )


class Hit:
    """The first ball hits the second one, whose place at the end is the loss."""

    def __init__(self, model: novaphy.Model, mode: str = "code", by_spin: float = 0.0) -> None:
        from novaphy import diff, nova

        steps = 100
        self.model, self.steps = model, steps
        self.path = diff.Trajectory(model, steps)
        self.speed = nova.tensor(np.float32([1.0]), requires_grad=True)
        rest = nova.tensor(np.float32(np.eye(1, 12)))
        with nova.Tape() as self.tape:
            diff.state_joint_qd_tensor(self.path[0]).copy_((self.speed * rest).reshape(12))
            pipeline = novaphy.CollisionPipeline(model)
            solver(model, mode).rollout(self.path, None, None, DT, pipeline=pipeline)
            end = diff.state_joint_q_tensor(self.path[steps])
            spin = diff.state_joint_qd_tensor(self.path[steps])
            self.loss = end[7] + 0.5 * end[8] + by_spin * (spin[11] + spin[5])
            self.other = -100.0 * end[0]
            self.tape.backward(self.loss, record=True)
        self.record = self.tape.adjoint_record([self.speed])


@pytest.mark.parametrize("mode", ["code", "motion"])
def test_one_contact_carries_the_whole_derivative(mode: str) -> None:
    """Balls in line: the second one moves only because of the impulse."""
    hit = Hit(balls(), mode)
    slope = hit.speed.grad.item()
    assert slope > 0.01 and len(hit.record.contacts) == 1
    contact = hit.record.contacts[0]
    assert abs(contact["carried"] + abs(slope)) < 0.01 * abs(slope)
    # A faster ball hits earlier: 0.03 of the slope 0.113 are due to the time.
    assert contact["moved"] == pytest.approx(-0.034 if mode == "motion" else 0.0, rel=0.01)
    step = round(GAP / DT)
    assert abs(contact["step"] - step) <= 1 and contact["time"] == pytest.approx(step * DT, abs=DT)
    assert {contact["shape0"], contact["shape1"]} == {0, 1} and contact["world"] == -1
    # The impulse (1 + e) m v of the reduced mass 1/3 kg, and its arm on the second ball.
    sign = 1.0 if contact["shape1"] == 1 else -1.0
    assert np.allclose(contact["impulse"], [sign * 1.7 / 3, 0, 0], atol=1e-4)
    left = (hit.steps - contact["step"]) * DT
    assert np.allclose(
        contact["adjoint"], [sign * left / 0.5, sign * 0.5 * left / 0.5, 0], rtol=1e-3
    )
    assert np.allclose(contact["point"], [RADIUS + GAP, 0, 0], atol=2e-3)
    assert contact["begins"] and not contact["held"]


def test_a_second_backward_replaces_the_record() -> None:
    hit = Hit(balls())
    hit.tape.backward(hit.loss, record=True)
    again = hit.tape.adjoint_record([hit.speed])
    assert len(again.boundaries) == len(hit.record.boundaries)
    assert [c["step"] for c in again.contacts] == [c["step"] for c in hit.record.contacts]
    assert again.contacts[0]["carried"] == pytest.approx(hit.record.contacts[0]["carried"])


def test_a_record_is_of_one_loss() -> None:
    """Leaves accumulate the gradients of two losses, here with another sign than the first."""
    hit = Hit(balls(offset=0.05))
    slope = hit.speed.grad.item()
    hit.tape.backward(hit.other)
    assert hit.speed.grad.item() * slope < 0.0
    with pytest.raises(novaphy.Error, match="got one without a record behind it"):
        hit.tape.adjoint_record([hit.speed])
    hit.tape.backward(hit.loss, record=True)
    again = hit.tape.adjoint_record([hit.speed])
    assert again.boundaries[0]["norm"] == pytest.approx(hit.record.boundaries[0]["norm"])
    assert again.contacts[0]["carried"] == pytest.approx(
        hit.record.contacts[0]["carried"], rel=1e-4
    )


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_the_adjoint_is_the_difference_by_an_external_impulse(mu: float) -> None:
    """A hit off the line; impulses on both balls at the point, behind the solve of the step."""
    model = balls(offset=0.06, mu=mu)
    hit = Hit(model, by_spin=1e-3)
    contact = hit.record.contacts[0]
    step, point = contact["step"], np.array(contact["point"])
    after = {k: [a.numpy().copy() for a in (hit.path[k].joint_q, hit.path[k].joint_qd)]
             for k in (step, step + 1)}  # fmt: skip

    def loss(impulse: np.ndarray) -> float:
        """Shift the rates behind the step; the positions follow with these rates."""
        from novaphy import diff

        q, qd = (x.copy().astype(np.float64) for x in after[step + 1])
        for body, (sign, mass) in enumerate(((-1.0, 1.0), (1.0, 0.5))):
            if contact["shape1"] != 1:
                sign = -sign
            arm = point - q[7 * body : 7 * body + 3]
            qd[6 * body : 6 * body + 3] += sign * impulse / mass
            qd[6 * body + 3 : 6 * body + 6] += np.cross(arm, sign * impulse) / 0.004
            q[7 * body : 7 * body + 3] += DT * sign * impulse / mass
        path = diff.Trajectory(model, hit.steps - step - 1, requires_grad=False)
        path[0].joint_q.assign(q.astype(np.float32))
        path[0].joint_qd.assign(qd.astype(np.float32))
        solver(model, "code").rollout(
            path, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
        )
        end, spin = path[path.steps].joint_q.numpy(), path[path.steps].joint_qd.numpy()
        return float(end[7]) + 0.5 * float(end[8]) + 1e-3 * float(spin[11] + spin[5])

    size = 0.02
    wanted = [(loss(size * e) - loss(-size * e)) / (2 * size) for e in np.eye(3)]
    assert np.allclose(contact["adjoint"], wanted, atol=2e-3 * np.linalg.norm(wanted))
    assert np.linalg.norm(wanted) > 0.1


def test_a_missed_event_is_found_with_its_step_and_pair() -> None:
    """The gradient of the code misses that the hit moves in time: H jumps there."""
    code, motion = Hit(balls(), "code").record, Hit(balls(), "motion").record
    assert len(code.suspects) == 1 and motion.suspects == []
    found, contact = code.suspects[0], code.contacts[0]
    assert found["step"] == contact["step"] and found["drift"] > 0.3
    assert (found["shape0"], found["shape1"]) == (contact["shape0"], contact["shape1"])
    assert found["cause"].startswith("missed event") and "missed event" in str(code)
    assert max(row["drift"] for row in motion.boundaries) < 0.01


def rolling(shape: str) -> novaphy.nova.AdjointRecord:
    """A ball that rolls over a fixed ball, or a plank over a ridge, from the start on."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, density=500.0, gap=0.05)
    if shape == "plank":
        body = builder.add_body(xform=((0.05, 0.0, 0.128), (0.0, 0.1, 0.0, 0.995)))
        builder.add_shape_box(body, hx=0.4, hy=0.05, hz=0.02, cfg=surface)
        ridge = np.float32([[x, y, z] for x in (-0.02, 0.02) for y in (-1, 1) for z in (-1, 0.1)])
        builder.add_shape_convex_hull(-1, vertices=ridge, cfg=surface)
    else:
        body = builder.add_body(xform=((0.0, 0.0, 0.1499), UPRIGHT))
        builder.add_shape_sphere(body, radius=0.05, cfg=surface)
        builder.add_shape_sphere(-1, radius=1.0, xform=((0, 0, -0.9), UPRIGHT), cfg=surface)
    model = builder.finalize(requires_grad=True)
    path = diff.Trajectory(model, 200)
    path[0].joint_qd.assign(np.float32([0.6, 0.1, 0, 0, 2.0, 0]))
    with nova.Tape() as tape:
        solver(model, "motion").rollout(
            path, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
        )
        tape.backward(nova.sum(diff.state_joint_q_tensor(path[200])[:3]), record=True)
    return tape.adjoint_record()


def test_a_frozen_normal_is_found_with_its_pair() -> None:
    frozen, exact = rolling("plank"), rolling("sphere")
    assert any(c["held"] for c in frozen.contacts)
    assert not any(c["held"] for c in exact.contacts) and len(exact.contacts) > 100
    found = [s for s in frozen.suspects if s["cause"].startswith("frozen point and normal")]
    assert len(found) == 1 and {found[0]["shape0"], found[0]["shape1"]} == {0, 1}
    at = [c for c in frozen.contacts if c["step"] == found[0]["step"]]
    assert at and all(c["held"] for c in at)
    assert exact.suspects == []


def test_boundaries_have_times_norms_and_h() -> None:
    from novaphy import diff

    hit = Hit(balls(), "motion")
    rows = hit.record.boundaries
    assert len(rows) == hit.steps + 1 and [row["step"] for row in rows] == list(range(len(rows)))
    assert rows[-1]["time"] == pytest.approx(hit.steps * DT)
    assert rows[-1]["norm"] == pytest.approx(np.sqrt(1.25), rel=1e-5)
    for k in (10, 60):  # the tape's own gradients; of a ball they are tangents but for the turn
        of_q = diff.state_joint_q_tensor(hit.path[k]).grad.numpy()
        of_qd = diff.state_joint_qd_tensor(hit.path[k]).grad.numpy()
        linear = np.linalg.norm(np.concatenate([of_q[[0, 1, 2, 7, 8, 9]], of_qd]))
        assert rows[k]["norm"] == pytest.approx(linear, rel=0.02)
    known = [row["h"] for row in rows if row["h"] is not None]
    assert len(known) == len(rows) - 1 and np.ptp(known) < 0.01 * abs(known[0])


def test_the_record_changes_no_gradient_and_needs_to_be_asked_for() -> None:
    from novaphy import diff, nova

    grads = []
    for record in (False, True):
        model = balls(offset=0.05, mu=0.2)
        path = diff.Trajectory(model, 100)
        path[0].joint_qd.assign(np.float32(np.eye(1, 12).ravel()))
        with nova.Tape() as tape:
            solver(model, "motion").rollout(
                path, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
            )
            tape.backward(nova.sum(diff.state_joint_q_tensor(path[100])[7:9]), record=record)
        grads.append((path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()))
        if not record:
            with pytest.raises(novaphy.Error, match=r"expected backward\(loss, record=True\)"):
                tape.adjoint_record()
    assert all(np.array_equal(a, b) for a, b in zip(*grads, strict=True))


def test_a_tape_without_steps_is_refused() -> None:
    from novaphy import nova

    x = nova.tensor([1.0], requires_grad=True)
    with nova.Tape() as tape:
        with pytest.raises(novaphy.Error, match="expected steps of DiffFeatherstoneSolver, "):
            tape.backward(x * x, record=True)
    hit = Hit(balls())
    with pytest.raises(ValueError, match="input 0: expected a leaf"):
        hit.tape.adjoint_record([hit.loss])
