"""nova.scan: the bits of a Python loop, structures of tensors, captures, and errors by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

import novaphy
from novaphy import nova

STEPS = 12


def random(*shape: int, seed: int, scale: float = 1.0) -> nova.Tensor:
    values = np.random.default_rng(seed).normal(size=shape) * scale
    made = nova.tensor(values.astype(np.float32))
    made.requires_grad = True
    return made


def pendulum(carry: dict[str, Any], torque: nova.Tensor) -> tuple[dict[str, Any], nova.Tensor]:
    rate = carry["rate"] + 0.05 * (torque * carry["gain"] - 9.81 * nova.sin(carry["angle"]))
    angle = carry["angle"] + 0.05 * rate
    return {"rate": rate, "angle": angle, "gain": carry["gain"]}, angle


def inputs() -> tuple[dict[str, nova.Tensor], nova.Tensor]:
    carry = {
        "angle": random(4, seed=1),
        "rate": random(4, seed=2),
        "gain": random(4, seed=3),
    }
    return carry, random(STEPS, 4, seed=4)


def test_a_scan_has_the_bits_of_a_loop() -> None:
    results = []
    for by_scan in (False, True):
        carry, torques = inputs()
        with nova.Tape() as tape:
            if by_scan:
                last, path = nova.scan(pendulum, carry, torques)
            else:
                last, ys = carry, []
                for row in torques:
                    last, y = pendulum(last, row)
                    ys.append(y + 0.0)
                path = nova.stack(ys)
            tape.backward(nova.sum(path * path) + nova.sum(last["rate"]))
        tensors = [*(last[key] for key in carry), path]
        gradients = [*(value.grad for value in carry.values()), torques.grad]
        results.append([t.numpy().tobytes() for t in tensors + gradients])
        assert (tape.op_names().count("scan"), len(tape) < 10) == (int(by_scan), by_scan)
    assert results[0] == results[1]


def test_the_body_is_called_once_for_any_number_of_steps() -> None:
    for steps in (10, 10_000):
        x = nova.tensor([1.0], requires_grad=True)
        calls = []

        def body(c: nova.Tensor, _: None, calls: list[int] = calls) -> tuple[nova.Tensor, None]:
            calls.append(1)
            return c * 0.999, None

        with nova.Tape() as tape:
            last, ys = nova.scan(body, x, length=steps)
            tape.backward(last)
        assert (len(tape), len(calls), ys) == (1, 1, None)
        assert x.grad.item() == pytest.approx(0.999**steps, rel=1e-3)


class Pair(NamedTuple):
    a: nova.Tensor
    b: nova.Tensor


def test_structures_keep_their_form() -> None:
    def body(carry: Any, x: Any) -> tuple[Any, Any]:
        pair, [c] = carry
        first, none = x
        assert none is None
        return (Pair(pair.b, pair.a + first["x"]), [c * 2.0]), {"y": (c, None)}

    start = (Pair(nova.tensor([1.0]), nova.tensor([2.0])), [nova.tensor([3.0])])
    (pair, [c]), ys = nova.scan(body, start, ({"x": nova.tensor([1.0, 2.0, 4.0])}, None))
    assert isinstance(pair, Pair)
    # (a, b) -> (b, a + x) for x = 1, 2, 4
    assert (pair.a.item(), pair.b.item(), c.item()) == (4.0, 6.0, 24.0)
    assert ys["y"][0].tolist() == [[3.0], [6.0], [12.0]] and ys["y"][1] is None


def test_a_network_over_rows_agrees_with_differences() -> None:
    def loss(h: nova.Tensor, w: nova.Tensor, xs: nova.Tensor) -> nova.Tensor:
        def body(h: nova.Tensor, x: nova.Tensor) -> tuple[nova.Tensor, nova.Tensor]:
            h = nova.tanh(nova.linear(h, w) + x[0] * x[1:])
            return h, nova.max(h)

        h, ys = nova.scan(body, h, xs)
        return nova.sum(h * h) + nova.sum(ys)

    given = [random(3, seed=1), random(3, 3, seed=2, scale=0.5), random(5, 4, seed=3)]
    result = nova.gradcheck(loss, given)
    assert result.ok, result
    assert result.has_tangent and result.dot_product_error < 1e-5


def test_random_numbers_of_each_step() -> None:
    steps = nova.tensor(np.arange(6, dtype=np.int32))

    def body(total: nova.Tensor, step: nova.Tensor) -> tuple[nova.Tensor, nova.Tensor]:
        noise = nova.random_uniform((2, 3), seed=5, step=step)
        return total + noise, noise

    total, noise = nova.scan(body, nova.zeros((2, 3)), steps)
    expected = [nova.random_uniform((2, 3), seed=5, step=k).numpy() for k in range(6)]
    assert np.array_equal(noise.numpy(), expected)
    assert np.allclose(total.numpy(), np.sum(expected, axis=0))


def test_a_captured_scan_follows_new_inputs() -> None:
    carry, torques = inputs()

    def record() -> nova.Tensor:
        with nova.Tape() as tape:
            last, path = nova.scan(pendulum, carry, torques)
            tape.zero()
            tape.backward(nova.sum(path * path))
        return last["angle"]

    with nova.ScopedCapture() as capture:
        angle = record()
    for seed in (7, 8):
        torques.assign(np.random.default_rng(seed).normal(size=(STEPS, 4)).astype(np.float32))
        capture.graph.launch()
        replayed = [t.numpy().copy() for t in (angle, torques.grad, carry["angle"].grad)]
        direct = record()
        for a, b in zip(replayed, (direct, torques.grad, carry["angle"].grad), strict=True):
            assert np.array_equal(a, b.numpy())


def test_gradient_descent_in_the_body() -> None:
    def descend(x: nova.Tensor, _: None) -> tuple[nova.Tensor, nova.Tensor]:
        x.requires_grad = True
        with nova.Tape() as tape:
            loss = nova.sum((x - 3.0) * (x - 3.0))
            tape.zero()
            tape.backward(loss)
        return (x - 0.1 * x.grad).detach(), loss

    x, losses = nova.scan(descend, nova.tensor([1.0]), length=5)
    assert x.item() == pytest.approx(3.0 - 2.0 * 0.8**5, rel=1e-6)
    assert losses.numpy()[:, 0] == pytest.approx([4.0 * 0.64**k for k in range(5)], rel=1e-5)
    with nova.Tape(), pytest.raises(novaphy.Error, match="another tape is active"):
        nova.scan(descend, nova.tensor([1.0]), length=5)


def test_an_index_that_changes_from_step_to_step_is_refused() -> None:
    rows = nova.tensor(np.arange(15, dtype=np.float32).reshape(5, 3))
    with pytest.raises(novaphy.Error, match="scan: an index table .* was modified"):
        nova.scan(
            lambda c, k: (c + nova.gather(rows, k)[0], None),
            nova.zeros(3),
            nova.tensor(np.arange(4, dtype=np.int32)),
        )


@pytest.mark.parametrize(
    ("body", "error", "message"),
    [
        (lambda c, x: (c[:1], None), ValueError, r"body, carry: expected \(2,\) .*float32 as"),
        (
            lambda c, x: ((c, c), None),
            ValueError,
            r"expected the carry \['carry'\], got \['carry\[",
        ),
        (lambda c, x: c, TypeError, r"scan, body: expected \(carry, y\), got Tensor"),
        (lambda c, x: (c, 1.0), TypeError, r"scan, y: expected a Tensor, or a tuple, .* got float"),
        (lambda c, x: (c * c[0].item(), None), RuntimeError, "inside the body of a scan"),
        (lambda c, x: (c * c.numpy()[0], None), RuntimeError, "inside the body of a scan"),
        (
            lambda c, x: ((c.copy_(c * 2.0), c)[1], None),
            ValueError,
            "carry 0: the body writes to it",
        ),
    ],
)
def test_bodies_are_refused_by_name(
    body: Callable[..., Any], error: type[Exception], message: str
) -> None:
    for taped in (False, True):
        c = nova.tensor([1.0, 2.0], requires_grad=True)
        with pytest.raises(error, match=message):
            if taped:
                with nova.Tape():
                    nova.scan(body, c, length=3)
            else:
                nova.scan(body, c, length=3)


def test_arguments_are_refused_by_name() -> None:
    c = nova.tensor([1.0, 2.0])
    body = lambda c, x: (c, None)  # noqa: E731
    with pytest.raises(ValueError, match="length: expected the number of steps"):
        nova.scan(body, c)
    with pytest.raises(ValueError, match="length: expected >= 0, got -2"):
        nova.scan(body, c, length=-2)
    with pytest.raises(ValueError, match="xs 1: expected 3 rows"):
        nova.scan(body, c, (nova.zeros(3), nova.zeros(4)))
    with pytest.raises(TypeError, match="carry 0: expected float32, got int32"):
        nova.scan(body, nova.tensor(np.arange(2, dtype=np.int32)), length=2)
    with pytest.raises(TypeError, match=r"carry\['h'\]: expected a Tensor, .* got list|got int"):
        nova.scan(body, {"h": 3}, length=2)
    with pytest.raises(TypeError, match="float"):
        nova.scan(body, c, length=2.5)


def test_a_tape_in_the_body_gives_new_gradients_in_each_step():
    def descend(c, _):
        c.requires_grad = True
        with nova.Tape() as tape:
            tape.backward(nova.sum(c * c))
        return (c - 0.1 * c.grad).detach(), None

    c = nova.tensor([1.0])
    last, _ = nova.scan(descend, c, length=3)
    for _ in range(3):
        c, _ = descend(c, None)
    assert last.numpy() == pytest.approx(0.8**3, rel=1e-6)
    np.testing.assert_array_equal(last.numpy(), c.numpy())


@pytest.mark.parametrize("call", ["reset", "backward"])
def test_the_tape_of_a_body_refuses_to_end(call):
    x = nova.tensor([1.0], requires_grad=True)

    def body(c, _):
        y = c * 2.0
        tape = nova.active_tape()
        tape.reset() if call == "reset" else tape.backward(nova.sum(y))
        return y, None

    with nova.Tape(), pytest.raises(NotImplementedError, match=f"Tape.{call}: not supported for"):
        nova.scan(body, x, length=3)
