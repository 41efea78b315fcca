"""novaphy.jax: rollouts and losses as functions of JAX."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("novaphy.diff")
jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

import novaphy.jax  # noqa: E402
from novaphy import diff, nova  # noqa: E402

NUMBERS = (0.5, 0.05, 0.02, 2e3, 5.0, 0.3, 1e-3)


def push(x: nova.Tensor, rate: nova.Tensor) -> tuple[nova.Tensor, nova.Tensor]:
    """Where a pushed box goes."""
    return diff.integrate_push_box_rollout_generated(
        nova.tensor([0.55]), nova.tensor([0.0]), x, rate, *NUMBERS
    )


def test_a_rollout_inside_of_jit_and_grad():
    steps = 80
    way = novaphy.jax.wrap(push, [(steps,), (steps,)])
    x = jnp.linspace(0.475, 0.50, steps)
    rate = jnp.full((steps,), 0.3)

    @jax.jit
    def loss(x, rate):
        box, speed = way(x, rate)
        return (box[-1] - 0.6) ** 2 + 0.01 * speed[-1] ** 2

    gradient = jax.jit(jax.grad(loss))(x, rate)
    shift = jnp.ones(steps)
    quotient = (loss(x + 1e-3 * shift, rate) - loss(x - 1e-3 * shift, rate)) / 2e-3
    assert float(gradient @ shift) == pytest.approx(float(quotient), rel=2e-2)
    # The tape's own.
    inputs = [nova.tensor(np.array(v), requires_grad=True) for v in (x, rate)]
    with nova.Tape() as tape:
        box, speed = push(*inputs)
        ends = box[steps - 1 :] - 0.6, speed[steps - 1 :]
        tape.backward(nova.sum(ends[0] * ends[0] + 0.01 * ends[1] * ends[1]))
    np.testing.assert_allclose(np.array(gradient), inputs[0].grad.numpy(), rtol=1e-4, atol=1e-8)


def test_vmap_calls_one_after_the_other():
    square = novaphy.jax.wrap(lambda x: x * x, (2,))
    x = jnp.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(jax.vmap(square)(x), np.array(x) ** 2)
    gradient = jax.vmap(jax.grad(lambda row: square(row).sum()))(x)
    np.testing.assert_array_equal(gradient, 2.0 * np.array(x))


def test_what_does_not_count_has_the_gradient_zero():
    both = novaphy.jax.wrap(lambda a, b: (a * 2.0, a * a), [(1,), (1,)])
    by_a, by_b = jax.grad(lambda a, b: both(a, b)[0][0], argnums=(0, 1))(jnp.ones(1), jnp.ones(1))
    assert (by_a.item(), by_b.item()) == (2.0, 0.0)


def test_wrong_results_and_arguments_are_named():
    with pytest.raises(Exception, match=r"expected results of shape \[\(3,\)\], got \[\(2,\)\]"):
        novaphy.jax.wrap(lambda x: x * 2.0, (3,))(jnp.zeros(2)).block_until_ready()
    with pytest.raises(Exception, match="expected a float32 array, got int32"):
        novaphy.jax.wrap(lambda x: x * 2.0, (3,))(jnp.zeros(3, jnp.int32)).block_until_ready()


def test_results_that_do_not_depend_on_the_input_and_inputs_that_are_results():
    mixed = novaphy.jax.wrap(
        lambda x: (x * x, nova.ones((3,)), x, x.reshape(3, 1)), [(3,), (3,), (3,), (3, 1)]
    )
    x = jnp.array([1.0, 2.0, 3.0])
    for results, slope in (
        ((0, 1), 2 * x),
        ((1,), 0 * x),
        ((2,), 1 + 0 * x),
        ((0, 2, 3), 2 * x + 2),
    ):
        gradient = jax.grad(lambda x, r=results: sum(mixed(x)[k].sum() for k in r))(x)
        np.testing.assert_array_equal(gradient, slope)
    np.testing.assert_array_equal(mixed(x)[2], x)
