"""diff.certify: verdicts on functions in closed form and on motions with contacts, and errors."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import novaphy

if not novaphy.has_diff():
    pytest.skip("needs NOVAPHY_WITH_DIFF", allow_module_level=True)

sys.path.insert(0, str(Path(__file__).parents[2] / "tools" / "bench"))

from thrown_balls import last_height, last_height_of_the_code

from novaphy import diff, nova


def bowl(theta: nova.Tensor) -> nova.Tensor:
    return nova.sum(theta * theta, axis=-1)


def half(theta: nova.Tensor) -> nova.Tensor:
    """A bowl whose gradient has half of its length."""
    return nova.sum(theta * theta.detach(), axis=-1)


def ripples(theta: nova.Tensor) -> nova.Tensor:
    """A slope with waves of an eighth of sigma."""
    return nova.sum(theta + nova.sin(theta * 50.0) * 0.06, axis=-1)


def logistic(theta: nova.Tensor) -> nova.Tensor:
    """Forty iterations of the logistic map, x -> 4 x (1 - x)."""
    x = nova.sum(theta, axis=-1)
    for _ in range(40):
        x = x * (1.0 - x) * 4.0
    return x


def out_of_reach(theta: nova.Tensor) -> nova.Tensor:
    return nova.sum(nova.relu(theta - 50.0), axis=-1) + 3.0


def buried(theta: nova.Tensor) -> nova.Tensor:
    """A slope of 0.3 with the gradient -0.15, beside a constant that hides both."""
    return 1e6 + nova.sum(theta.detach() * 0.45 - theta * 0.15, axis=-1)


def drowned(theta: nova.Tensor) -> nova.Tensor:
    """A slope that rounding takes away: all losses are 1."""
    return nova.sum(theta, axis=-1) * 1e-9 + 1.0


def reversed_part(theta: nova.Tensor, size: float) -> nova.Tensor:
    """The slopes 10 and `size`; the gradient says 10 and -size."""
    x, y = theta[:, 0], theta[:, 1]
    return x * 10.0 + y.detach() * (2.0 * size) - y * size


def test_a_small_component_of_wrong_sign_is_found() -> None:
    found = diff.certify(lambda theta: reversed_part(theta, 0.9), [1.0, 2.0], 1.0)
    assert found.disagreements[1] < 0.2  # all components together
    assert found.verdict == "biased" and "direction 1: there the slope is 0.9" in found.sentence
    found = diff.certify(lambda theta: reversed_part(theta, 0.05), [1.0, 2.0], 1.0)
    assert found.verdict == "of the motion"  # half a percent is not told from roughness


def test_slopes_across_the_gradient_are_no_components_of_wrong_sign() -> None:
    """Of nine parameters, seven of the eight directions are across the gradient."""

    def leaves_some_out(theta: nova.Tensor) -> nova.Tensor:
        return theta[:, 0] * 10.0 + nova.sum(theta.detach(), axis=-1) * 0.4

    found = diff.certify(leaves_some_out, np.ones(9), 1.0)
    assert found.verdict == "of the motion", str(found)
    assert np.abs(found.differences[1, 1:]).max() > 0.3


@pytest.mark.parametrize(
    ("f", "theta", "verdict", "words"),
    [
        (bowl, [1.0, -2.0, 0.5], "of the motion", "within 0 %"),
        (half, [1.0, -2.0, 0.5], "biased", "50 % from the gradient"),
        (ripples, [0.01, 0.02], "local", "tiny moves"),
        (logistic, [0.2, 0.1], "chaotic", "median lengths|do not settle"),
        (buried, [1.0], "biased", "slope of the samples"),
        (drowned, [1.0], "chaotic", "rounding of the loss hides its slope"),
        (out_of_reach, [0.1, 0.2], "zero", "reaches nothing"),
    ],
)
def test_each_verdict_has_its_function(f, theta, verdict, words) -> None:
    found = diff.certify(f, theta, 1.0 if f is not logistic else 0.05)
    assert found.verdict == verdict and re.search(words, found.sentence), str(found)
    assert found.info is None and found.margins == [] and found.trust_radius is None


def curved(theta: nova.Tensor, scale: tuple[float, float] = (1.0, 1.0)) -> nova.Tensor:
    """A cubic whose differences over 0.3 sigma are 22 % from the slopes (-1, 3), times a scale."""
    factors = nova.tensor(np.float32([scale]))
    x = theta.detach() + (theta - theta.detach()) * factors
    return nova.sum(
        x * x * x * nova.tensor([[-2.2, 10.6]]) + x * nova.tensor([[-1.0, 3.0]]), axis=-1
    )


def test_a_gradient_that_differences_approach_is_local() -> None:
    found = diff.certify(curved, np.zeros(2), 1.0)
    assert 0.2 < found.disagreements[1] < 0.3 and found.disagreements[3] < 1e-3
    assert found.verdict == "local" and "approach it as their step shrinks" in found.sentence


@pytest.mark.parametrize("scale", [(1.05, 0.95), (0.95, 0.95), (-1.0, 1.0), (1.0, -1.0)])
def test_a_wrong_gradient_of_a_curved_loss_is_biased(scale) -> None:
    found = diff.certify(lambda theta: curved(theta, scale), np.zeros(2), 1.0)
    assert found.verdict == "biased", str(found)


def test_numbers_are_per_sigma() -> None:
    theta, sigma = np.array([1.0, -2.0]), np.array([0.1, 0.4])
    found = diff.certify(bowl, theta, sigma, worlds=256)
    slope = 2 * theta * sigma
    assert np.allclose(found.gradient, slope) and found.loss == 5.0 and found.worlds == 256
    assert np.allclose(found.differences, slope, rtol=2e-3) and found.differences.shape == (4, 2)
    assert np.array_equal(found.directions, np.eye(2)) and found.code_gradient is None
    assert (np.abs(found.smoothed - slope) < 3 * found.standard_error + 1e-6).all()
    assert found.cosine > 0.95 and 0.8 < found.length < 1.25 and 1.0 <= found.tail < 2.0
    assert found.cost > 3.0 and found.seconds > 0.0
    again = diff.certify(bowl, theta, sigma, worlds=256)
    assert np.array_equal(again.smoothed, found.smoothed)
    other = diff.certify(bowl, theta, sigma, worlds=256, seed=1)
    assert not np.array_equal(other.smoothed, found.smoothed)


def test_many_parameters_have_eight_directions_the_first_downhill() -> None:
    theta = np.linspace(-1.0, 1.0, 20)
    found = diff.certify(bowl, theta, 0.1)
    assert found.directions.shape == (8, 20) and found.verdict == "of the motion"
    assert np.allclose(found.directions @ found.directions.T, np.eye(8), atol=1e-12)
    assert np.allclose(found.directions[0], -theta / np.linalg.norm(theta), atol=1e-6)


def test_a_bounce_is_biased_by_the_code_and_right_by_the_motion() -> None:
    code = diff.certify(last_height_of_the_code, [-1.0], 0.3)
    assert code.verdict == "biased" and 'try contact_gradient="motion"' in code.sentence
    assert code.info.label == "exact of the code" and code.info.events > 0
    assert abs(code.differences[1, 0] + 0.3) < 0.02 and abs(code.gradient[0] + 0.06) < 0.01
    motion = diff.certify(last_height, [-1.0], 0.3)
    assert motion.verdict == "of the motion" and motion.info.label == "exact of the motion"
    assert abs(motion.gradient[0] + 0.3) < 1e-4
    # An f with the argument contact_gradient is asked for the gradient of the code, too.
    assert np.array_equal(motion.code_gradient, code.gradient)
    # The only event vanishes when the speed does: at 1 m/s = 3.3 sigmas.
    (margin,) = motion.margins
    assert margin.what == "event vanishes" and margin.pair == "shapes 1 and 0"
    assert abs(margin.sigmas * 0.3 - 1.0) < 0.01 and motion.trust_radius == margin.sigmas
    assert "bounce of shapes 1 and 0" in motion.limited_by


def test_samples_tell_where_steps_are_coarse_for_differences() -> None:
    """0.1 sigma moves the contact by one step, so that differences show the phase of the step."""
    motion = diff.certify(last_height, [-1.0], 0.1)
    assert motion.verdict == "of the motion" and "slope of the samples" in motion.sentence
    assert abs(motion.differences[2, 0] - motion.differences[1, 0]) > 0.02
    assert motion.cosine > 0.99 and abs(motion.length - 1.0) < 0.1
    code = diff.certify(last_height_of_the_code, [-1.0], 0.1)
    assert code.verdict == "biased" and code.length < 0.3


def test_a_sigma_within_a_step_is_named() -> None:
    """The contact stays in its step, so the loss has the slope of the code at this scale."""
    found = diff.certify(last_height, [-1.0], 1e-3)
    assert found.verdict == "biased" and found.info.label == "exact of the motion"
    assert re.search("0.3 sigma moves contacts by 0.0[0-9]* steps only", found.sentence)
    assert "larger sigma" not in diff.certify(last_height_of_the_code, [-1.0], 0.3).sentence


def test_the_cause_of_a_rough_loss_is_named() -> None:
    from types import SimpleNamespace

    from novaphy.diff._verdict import Evidence, judge

    one = np.ones(1)
    info = SimpleNamespace(least_separation=2.0, steps_per_contact=6.3, events=2, event_list=[{}])
    differences = np.float64([[1], [2], [-3], [9]])
    of = Evidence(one, differences, np.zeros(4), 2.0, info, 5.0, one, one, one, one)
    verdict, sentence = judge(of)
    assert verdict == "chaotic" and "two events are 2 steps apart" in sentence
    assert "0.1 sigma moves contacts by 0.5 steps" in sentence
    assert "a penalty contact pushes for 6.3 steps only" in sentence
    springs = SimpleNamespace(**{**vars(info), "steps_per_contact": 18.0})
    springs.event_list = [{"kind": "spring"}]
    assert 'penalty_law="mean" removes' in judge(of._replace(info=springs))[1]
    assert "40 median lengths" in judge(of._replace(tail=40.0, info=None, shift=None))[1]
    assert judge(of._replace(info=None, shift=None))[1].endswith("0.3 sigma do not settle.")


def test_rough_samples_accuse_a_gradient_only_beyond_their_error() -> None:
    """The samples have another slope by 26 % of the gradient, with an error of 9 % or 2 %."""
    from novaphy.diff._verdict import Evidence, judge

    one, apart = np.ones(1), np.float64([0.74])
    differences = np.float64([[1], [2], [-3], [9]])
    of = Evidence(
        one, differences, np.zeros(4), 2.0, None, None, one, apart, np.float64([0.09]), apart
    )
    assert judge(of)[0] == "chaotic"
    assert judge(of._replace(error=np.float64([0.02])))[0] == "biased"


def test_differences_that_agree_by_chance_accuse_no_gradient_that_samples_support() -> None:
    """A cloth on the ground whose loss is rough: the numbers of its three parameters."""
    from novaphy.diff._verdict import Evidence, judge

    slopes, sampled = np.float64([[0.082, -0.048, 0.008], [0.076, -0.042, 0.017]])
    differences = np.tile([0.082, -0.048, -0.048], (4, 1))
    differences[[0, 3], 2] = 0.033, 0.362
    error = np.full(3, 0.008)
    of = Evidence(
        slopes, differences, np.zeros(4), 1.0, None, None, slopes, sampled, error, sampled
    )
    assert judge(of)[0] == "chaotic"
    other = of._replace(sampled=differences[1], smoothed=differences[1])
    assert judge(other)[0] == "biased"


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("out of reach", "zero"), ("double pendulum", "chaotic"), ("policy", "of the motion")],
)
def test_scenes_have_their_verdicts(name, verdict) -> None:
    from certify_scenes import SCENES

    scene = next(scene for scene in SCENES if scene.name == name)
    found = diff.certify(scene.losses, scene.theta, scene.sigma)
    assert found.verdict == verdict, str(found)
    if name == "policy":  # 16 weights
        assert found.directions.shape == (8, 16) and found.cosine > 0.99


@pytest.mark.parametrize("name", ["BallParticle", "BallPenalty", "BallImpulse"])
def test_a_ball_off_ground_and_wall_has_its_verdicts_with_each_solver(name) -> None:
    import event_task_machines
    from certify_tasks import function_of

    kind = getattr(event_task_machines, name)
    for mode, verdict in (("code", "biased"), ("motion", "of the motion")):
        found = diff.certify(function_of(kind, mode), kind.start, kind.sigma)
        assert found.verdict == verdict, str(found)
        assert found.trust_radius is None if mode == "code" else 5.0 < found.trust_radius < 20.0
        # Half a period of 1e4 N/m and 1 kg.
        steps = np.inf if name == "BallImpulse" else np.pi * kind.rate / 100.0
        assert found.steps_per_contact == pytest.approx(steps, rel=1e-3)


@cache
def spring_of_vbd(worlds: int):
    one = novaphy.ModelBuilder()
    held = one.add_particle((0, 0, 0), (0, 0, 0), 0.0)
    free = one.add_particle((0.3, 0, 0), (0, 0, 0), 0.1)
    one.add_spring(held, free, ke=50.0, kd=0.1, control=0.0)
    builder = novaphy.ModelBuilder()
    builder.replicate(one, worlds)
    builder.color()
    model = builder.finalize(requires_grad=True)
    return model, novaphy.solvers.DiffSolverVBD(model, iterations=10)


def swing(theta: nova.Tensor) -> nova.Tensor:
    """A particle on a spring starts with the velocity theta; the loss is of its place."""
    worlds = theta.shape[0]
    model, solver = spring_of_vbd(worlds)
    path = diff.Trajectory(model, 20)
    rates = nova.concat([nova.zeros((worlds, 3)), theta], axis=1).reshape(2 * worlds, 3)
    diff.state_particle_qd_tensor(path[0]).copy_(rates)
    solver.reset()
    solver.rollout(path, None, None, 1 / 60)
    place = diff.state_particle_q_tensor(path[20]).reshape(worlds, 6)[:, 3:6]
    return nova.sum(place * place, axis=-1)


def held_by_numpy(theta: nova.Tensor) -> nova.Tensor:
    """Hold a pendulum by a policy of another framework, which gives its own gradients."""
    from certify_scenes import _pendulum

    worlds = theta.shape[0]
    model, solver = _pendulum(worlds)
    state, tape, gains = model.state(), nova.active_tape(), theta.numpy()
    for _ in range(15):
        q, qd = diff.state_joint_q_tensor(state), diff.state_joint_qd_tensor(state)
        seen = np.stack([1.0 - q.numpy(), -qd.numpy()], axis=1)
        push = np.tanh((gains * seen).sum(axis=1))
        torque = nova.tensor(push)

        def backward(grads, seen=seen, push=push):
            by = (grads[0].numpy() * (1.0 - push**2))[:, None]
            found = (by * seen, -by[:, 0] * gains[:, 0], -by[:, 0] * gains[:, 1])
            return [nova.tensor(np.float32(x)) for x in found]

        if tape is not None:
            tape.record_custom("policy", [theta, q, qd], [torque], backward)
        control = model.control()
        diff.control_joint_f_tensor(control).copy_(torque)
        for _ in range(4):
            after = model.state()
            solver.step(state, after, control, None, 1 / 120)
            state = after
    off = diff.state_joint_q_tensor(state) - 1.0
    return off * off


@pytest.mark.parametrize(("f", "theta"), [(swing, [0.5, 0.2, -0.3]), (held_by_numpy, [2.0, 0.5])])
def test_other_solvers_and_policies_have_their_verdicts(f, theta) -> None:
    found = diff.certify(f, np.float32(theta), 0.2, worlds=32)
    assert found.verdict == "of the motion", str(found)
    assert found.disagreements[1] < 0.05 and found.cosine > 0.98
    assert found.steps_per_contact == np.inf


def test_the_order_of_two_impacts_limits_the_trust() -> None:
    """Two events 0.2 s apart; the speed of the first one moves its time by 0.04 s per sigma."""
    from novaphy.diff._events import trust

    def events(first: float) -> list[dict]:
        common = {"world": 0, "joint": -1, "particle": -1, "kind": "bounce", "phase": 0.0}
        return [
            {**common, "step": 40, "time": first, "shape0": 0, "shape1": 2, "approach": 1.0},
            {**common, "step": 60, "time": 0.6, "shape0": 1, "shape1": 2, "approach": 1.0},
        ]

    moved = [events(0.4 + 0.004), events(0.4 - 0.004)]
    found = trust(events(0.4), moved, 0.1, np.array([1.0]))
    assert abs(found.radius - 5.0) < 1e-9 and "order with the next event" in found.limited_by
    # A contact that pushes from the start on has no time.
    first = {**events(0.4)[0], "step": 0, "time": -np.inf, "approach": 0.0}
    found = trust([first, *events(0.4)], [[first, *rows] for rows in moved], 0.1, np.ones(1))
    assert abs(found.radius - 5.0) < 1e-9 and abs(found.shift - 4.0) < 1e-9
    moved[1] = moved[1][:1]
    found = trust(events(0.4), moved, 0.1, np.array([1.0]))
    assert found.radius == 0.1 and "number or order of events" in found.limited_by


def test_a_certificate_is_printed_and_drawn(tmp_path, capsys) -> None:
    found = diff.certify(last_height, [-1.0], 0.3)
    assert repr(found) == "Certificate('of the motion', n=1, worlds=64)"
    found.print()
    said = capsys.readouterr().out
    assert said.startswith("of the motion: ") and "parameter 0" in said and "code" in said
    assert "gradients of" in said and "trust radius" in said and "cosine" in said
    found.save(tmp_path / "ball.html")
    page = (tmp_path / "ball.html").read_text("utf-8")
    assert page.count("<circle") == 4 and "of the motion" in page and "<td>downhill" not in page
    with pytest.raises(ValueError, match=r"path: expected \.html or \.png, got .*ball\.pdf"):
        found.save(tmp_path / "ball.pdf")
    pytest.importorskip("matplotlib")
    found.save(tmp_path / "ball.png")
    assert (tmp_path / "ball.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theta": np.zeros(0)}, "theta: expected at least one parameter, got none"),
        ({"sigma": -1.0}, "sigma: expected positive finite numbers, got -1.0"),
        ({"sigma": np.inf}, "sigma: expected positive finite numbers, got inf"),
        ({"sigma": np.ones(2)}, r"sigma: expected a number or the shape \(3,\)"),
        ({"worlds": 7}, "worlds: expected an even number >= 4, got 7"),
        ({"f": lambda theta: theta}, r"f: expected losses \{1\}, one of each row of theta"),
        ({"f": lambda theta: nova.log(theta[:, 0])}, r"f: expected finite losses, got .* in row 0"),
        ({"f": lambda theta: bowl(theta.detach())}, "f: expected losses that the tape follows"),
    ],
)
def test_bad_arguments_are_named(change, message) -> None:
    arguments = {"f": bowl, "theta": np.zeros(3), "sigma": 0.1, **change}
    with pytest.raises(ValueError, match=f"certify, {message}"):
        diff.certify(**arguments)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"f": None}, "f: expected a function, got NoneType"),
        ({"f": lambda theta: 3.0}, "f: expected a Tensor of losses, got float"),
        ({"theta": "x"}, "theta: expected numbers, got 'x'"),
        ({"sigma": "a"}, "sigma: expected numbers, got 'a'"),
        ({"worlds": 4.0}, "worlds: expected an integer, got float"),
    ],
)
def test_arguments_of_other_types_are_named(change, message) -> None:
    arguments = {"f": bowl, "theta": np.zeros(3), "sigma": 0.1, **change}
    with pytest.raises(TypeError, match=f"certify, {message}"):
        diff.certify(**arguments)


def test_a_function_that_changes_is_refused_with_both_values() -> None:
    calls = iter(range(100))

    def drifts(theta: nova.Tensor) -> nova.Tensor:
        return bowl(theta) + float(next(calls))

    with pytest.raises(ValueError, match=r"expected the same loss .* got 3\.0 and then 6\.0"):
        diff.certify(drifts, [1.0, 1.0, 1.0], 0.1)
    later = iter(range(100))

    def turns(theta: nova.Tensor) -> nova.Tensor:
        """Change after the gradient and the differences."""
        return nova.sum(theta, axis=-1) * (1.0 if next(later) < 2 else -1.0)

    with pytest.raises(ValueError, match=r"expected the same loss .* got 2\.0 and then -2\.0"):
        diff.certify(turns, [1.0, 1.0], 0.1)
    with nova.no_grad(), pytest.raises(ValueError, match="a call outside of no_grad"):
        diff.certify(bowl, [1.0], 0.1)
