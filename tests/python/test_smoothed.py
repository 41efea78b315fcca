"""diff.smoothed: closed forms, a bouncing ball, the same bits, and its place on a tape."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

if not novaphy.has_diff():
    pytest.skip("needs NOVAPHY_WITH_DIFF", allow_module_level=True)

from thrown_balls import last_height, last_height_of_the_code

from novaphy import diff, nova

A = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.3], [0.0, -0.3, 3.0]])
B = np.array([0.3, -1.0, 0.2])
START = np.array([0.4, -0.2, 0.1])
SIGMA = np.array([0.1, 0.3, 0.2])


def quadratic(theta: nova.Tensor) -> nova.Tensor:
    """x A x / 2 + b x of each row."""
    x = theta @ nova.tensor(np.float32(A))
    return nova.sum(theta * (x * 0.5 + nova.tensor(np.float32(B))), axis=-1)


def rough(theta: nova.Tensor) -> nova.Tensor:
    """A function whose gradient has a heavy tail: the cube of a sum."""
    x = nova.sum(theta, axis=-1)
    return x * x * x


def gradient_of(f, start=START, sigma=SIGMA, **how) -> tuple[float, dict]:
    info: dict = {}
    value = diff.smoothed(f, start, sigma, info=info, **how)
    return value.item(), info


@pytest.mark.parametrize("antithetic", [True, False])
@pytest.mark.parametrize("order", [0, 1, "mixed"])
def test_a_quadratic_has_the_mean_and_the_gradient_of_the_closed_form(order, antithetic) -> None:
    value, info = gradient_of(
        quadratic, worlds=512, order=order, antithetic=antithetic, clip=None, seed=3
    )
    exact = A @ START + B
    error = info["standard_error"]
    assert (np.abs(info["gradient"] - exact) <= 3 * error + 1e-6).all(), (info, exact)
    mean = START @ (A @ START / 2 + B) + 0.5 * (np.diag(A) * SIGMA**2).sum()
    assert abs(value - mean) < 0.05
    if order == 0:
        assert 0.0 < np.linalg.norm(error) < 0.2 * np.linalg.norm(exact)
    if order == "mixed":  # gradients of a quadratic have far less noise than differences
        assert info["alpha"] > 0.8 and np.linalg.norm(error) < 0.1


def test_a_mean_of_gradients_of_the_code_stays_wrong_and_that_of_the_motion_is_right() -> None:
    """A ball that bounces with e = 1 ends d lower for a start that is d faster: slope -1."""
    start, sigma, of = [-1.0], 0.1, {"worlds": 400, "clip": None}
    motion = gradient_of(last_height, start, sigma, order=1, **of)[1]
    assert abs(motion["gradient"][0] + 1.0) < 1e-3 and motion["standard_error"][0] < 1e-3
    code = gradient_of(last_height_of_the_code, start, sigma, order=1, **of)[1]
    assert abs(code["gradient"][0] + 0.2) < 0.03 and code["standard_error"][0] < 0.01
    zeroth = gradient_of(last_height, start, sigma, order=0, **of)[1]
    assert abs(zeroth["gradient"][0] + 1.0) < 3 * zeroth["standard_error"][0] < 0.4
    mixed = gradient_of(last_height_of_the_code, start, sigma, order="mixed", **of)[1]
    assert mixed["alpha"] == 0.0 and mixed["gradient"] == zeroth["gradient"]
    mixed = gradient_of(last_height, start, sigma, order="mixed", **of)[1]
    assert mixed["alpha"] > 0.99


@pytest.mark.parametrize("order", [0, 1])
def test_the_bits_depend_on_the_seed_only(order) -> None:
    def bits(seed=0, **how) -> tuple[float, float]:
        value, info = gradient_of(last_height, [-1.0], 0.1, order=order, seed=seed, **how)
        return value, info["gradient"][0]

    assert bits() == bits() == bits(batch=8) == bits(batch=64) == bits(batch=24)
    assert bits() != bits(seed=1)
    few, many = [], []  # the first samples are the same however many there are

    def note(to):
        return lambda theta: to.append(theta.numpy()) or quadratic(theta)

    diff.smoothed(note(few), START, SIGMA, worlds=8)
    diff.smoothed(note(many), START, SIGMA, worlds=16)
    assert np.array_equal(few[0], many[0][:8])
    assert np.allclose(few[0][0] - START, START - few[0][1], atol=1e-6)


def test_a_function_may_keep_its_memory_from_call_to_call() -> None:
    """A trajectory that every batch fills again."""
    builder = novaphy.ModelBuilder()
    for _ in range(8):
        builder.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    model = builder.finalize(requires_grad=True)
    solver, path = novaphy.solvers.DiffSemiImplicitSolver(model), diff.Trajectory(model, 10)

    def last_height_of(theta: nova.Tensor) -> nova.Tensor:
        diff.state_particle_qd_tensor(path[0]).copy_(theta)
        solver.rollout(path, None, None, 0.01)
        return diff.state_particle_q_tensor(path[10])[:, 2]

    with nova.Tape() as tape:
        leaf = nova.tensor([0.0, 0.0, 1.0], requires_grad=True)
        tape.backward(diff.smoothed(last_height_of, leaf, 0.1, worlds=32, order=1, batch=8))
    assert np.allclose(leaf.grad.numpy(), [0.0, 0.0, 0.1], atol=1e-6)


@pytest.mark.parametrize("order", [0, 1, "mixed"])
def test_on_a_tape_it_is_a_value_with_its_gradient_and_tangent(order) -> None:
    """theta is a result of the tape; the samples are recorded on no tape."""
    leaf = nova.tensor([0.2, -0.1, 0.05], requires_grad=True)
    value, info = gradient_of(quadratic, order=order)
    with nova.Tape() as tape:
        theta = leaf * 2.0
        before = tape.size
        loss = diff.smoothed(quadratic, theta, SIGMA, order=order)
        assert tape.size - before < 8 and nova.active_tape() is tape
        tape.backward(loss * 3.0)
    assert loss.item() == value and loss.size == 1
    assert np.allclose(leaf.grad.numpy(), 6.0 * info["gradient"], rtol=1e-6)
    along = nova.tensor([1.0, -2.0, 0.5])
    (tangent,) = tape.jvp([loss], [leaf], [along])
    assert np.isclose(tangent.item(), 2.0 * info["gradient"] @ along.numpy(), rtol=1e-5)
    with nova.Tape(), nova.no_grad():
        assert diff.smoothed(quadratic, leaf * 2.0, SIGMA, order=order).item() == value
    with nova.no_grad():
        assert gradient_of(quadratic, order=0)[0] == value
        with pytest.raises(ValueError, match="smoothed, info: expected order 0 inside of no_grad"):
            gradient_of(quadratic, order=1)


def test_a_dict_is_its_entries_in_order() -> None:
    def split(theta: dict) -> nova.Tensor:
        wide = theta["weight"].reshape(theta["weight"].shape[0], 2)
        return quadratic(nova.concat([theta["bias"], wide], axis=1))

    leaves = {
        "bias": nova.tensor(np.float32(START[:1]), requires_grad=True),
        "weight": nova.tensor(np.float32(START[1:].reshape(1, 2)), requires_grad=True),
    }
    sigma = {"bias": SIGMA[0], "weight": SIGMA[1:].reshape(1, 2)}
    with nova.Tape() as tape:
        info: dict = {}
        loss = diff.smoothed(split, leaves, sigma, order=1, info=info)
        tape.backward(loss)
    value, flat = gradient_of(quadratic, order=1)
    assert loss.item() == value and info["gradient"]["weight"].shape == (1, 2)
    ours = [*leaves["bias"].grad.numpy(), *leaves["weight"].grad.numpy().ravel()]
    assert np.allclose(ours, flat["gradient"], rtol=1e-6)


def test_long_gradients_are_clipped_to_the_median() -> None:
    plain = gradient_of(rough, np.zeros(3), 1.0, order=1, clip=None)[1]
    short = gradient_of(rough, np.zeros(3), 1.0, order=1)[1]
    assert plain["clipped"] == 0.0 and 0.3 < short["clipped"] <= 0.5
    assert plain["tail"] == short["tail"] > 3.0
    assert np.linalg.norm(short["gradient"]) < 0.5 * np.linalg.norm(plain["gradient"])
    zeroth = gradient_of(rough, np.zeros(3), 1.0, order=0)[1]
    assert zeroth["clipped"] == 0.0 and zeroth["alpha"] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theta": np.zeros(0)}, "theta: expected at least one parameter, got none"),
        ({"theta": {}}, "theta: expected at least one parameter, got none"),
        ({"theta": np.zeros((2, 3))}, r"theta: expected \{n\} or \{1, n\}, got \(2, 3\)"),
        ({"theta": np.array([0.0, np.inf, 0.0])}, "theta: expected finite numbers"),
        ({"sigma": 0.0}, "sigma: expected positive finite numbers, got 0.0"),
        ({"sigma": np.nan}, "sigma: expected positive finite numbers, got nan"),
        ({"sigma": np.ones(2)}, r"sigma: expected a number or the shape \(3,\)"),
        ({"sigma": {"a": 1.0}}, r"sigma: expected the entries \[''\]"),
        ({"sigma": 1e-9}, "sigma: expected deviations of at least 1e-5 of the parameter"),
        ({"worlds": 63}, "worlds: expected an even number >= 4, got 63"),
        ({"worlds": 1, "antithetic": False}, "worlds: expected a number >= 2, got 1"),
        ({"order": 2}, 'order: expected 0, 1 or "mixed", got 2'),
        ({"clip": 1.0}, 'clip: expected "median" or None, got 1.0'),
        ({"batch": 0}, "batch: expected a number >= 1, got 0"),
    ],
)
def test_bad_arguments_are_named(change, message) -> None:
    arguments = {"f": quadratic, "theta": START, "sigma": SIGMA, **change}
    with pytest.raises(ValueError, match=f"smoothed, {message}"):
        diff.smoothed(**arguments)


def test_bad_functions_are_named() -> None:
    with pytest.raises(ValueError, match=r"f: expected losses \{64\}, one of each row"):
        diff.smoothed(lambda theta: theta, START, SIGMA)
    with pytest.raises(TypeError, match="f: expected a Tensor of losses, got float"):
        diff.smoothed(lambda theta: 1.0, START, SIGMA)
    with pytest.raises(ValueError, match=r"finite losses, got nan in row \d+, theta = "):
        diff.smoothed(lambda theta: nova.log(theta[:, 0] - 0.3), START, SIGMA, batch=8)
    with pytest.raises(ValueError, match="got losses without a gradient path"):
        info: dict = {}
        diff.smoothed(lambda t: nova.zeros((t.shape[0],)), START, SIGMA, order=1, info=info)
    with nova.Tape() as tape:  # the tape goes on behind an error
        with pytest.raises(ValueError):
            diff.smoothed(lambda theta: theta, nova.tensor(START, requires_grad=False), SIGMA)
        assert nova.active_tape() is tape
    assert nova.active_tape() is None
