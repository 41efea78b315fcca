"""Optimisers and clipping: against NumPy, against Warp's numbers, in captures, and refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from novaphy import Error, nova
from novaphy.nova import optim
from novaphy.testing import assert_same_bits

F = np.float32
NAN, INF = float("nan"), float("inf")


def leaf(values, gradient=None):
    """A leaf, with a gradient if there is one."""
    x = nova.tensor(values, requires_grad=True)
    if gradient is not None:
        x.grad.assign(gradient)
    return x


def correction(beta, t):
    """1 - beta^t in float32: the complements of the powers for the bits of t, combined."""
    total, power = F(0), F(1) - F(beta)
    while t:
        if t & 1:
            total = total + power * (F(1) - total)
        power, t = power * (F(2) - power), t >> 1
    return total


class NumpyAdam:
    """Algorithm 1 of Kingma and Ba in float32, each operation rounded once."""

    def __init__(self, p, lr=1e-3, betas=(0.9, 0.999), eps=1e-8):
        """Start with moments of zero."""
        self.p, self.t = p, 0
        self.m, self.v = np.zeros_like(p), np.zeros_like(p)
        self.lr, self.beta1, self.beta2, self.eps = F(lr), F(betas[0]), F(betas[1]), F(eps)

    def step(self, g):
        """Move by one step."""
        self.t += 1
        self.m = self.beta1 * self.m + (F(1) - self.beta1) * g
        self.v = self.beta2 * self.v + (F(1) - self.beta2) * g * g
        m_hat = self.m / correction(self.beta1, self.t)
        v_hat = self.v / correction(self.beta2, self.t)
        self.p = self.p - self.lr * m_hat / (np.sqrt(v_hat) + self.eps)


@pytest.mark.parametrize(
    "options", [{}, {"lr": 0.1, "betas": (0.5, 0.9), "eps": 1e-3}, {"lr": 1.0, "betas": (0, 0)}]
)
def test_adam_has_the_bits_of_the_recurrence_in_numpy(options):
    random = np.random.default_rng(1)
    start = random.standard_normal((40, 3)).astype(F)
    hand = NumpyAdam(start, **options)
    x, y = leaf(start), leaf(start)
    adam = optim.Adam([x], **options)
    m, v, t = nova.zeros((40, 3)), nova.zeros((40, 3)), nova.zeros(1)
    lr = options.get("lr", 1e-3)
    rest = {"eps": options["eps"]} if "eps" in options else {}
    rest |= dict(zip(("beta1", "beta2"), options.get("betas", ())))
    for _ in range(60):
        g = random.standard_normal((40, 3)).astype(F)
        x.grad.assign(g)
        y.grad.assign(g)
        adam.step()
        nova.adam_update_f32(y, m, v, t, lr, **rest)
        hand.step(g)
    assert_same_bits(x, hand.p)
    assert_same_bits(y, hand.p)
    assert_same_bits(adam.m[0], hand.m)
    assert_same_bits(v, hand.v)
    assert adam.t.tolist() == t.tolist() == [60]


# Six steps from (1, -2, 0.5) with the gradient x * (1, 10, 100) + k in step k, by Warp 1.19.0 on
# its CPU. Its bias correction, 1 - pow(beta, t), cancels, so Adam agrees to 1e-4 only.
@pytest.mark.parametrize(
    ("cls", "options", "expected", "rtol"),
    [
        (
            optim.Adam,
            {"lr": 0.1},
            [0.41505947709083557, -1.4143555164337158, -0.05807638168334961],
            1e-4,
        ),
        (
            optim.Adam,
            {"lr": 0.01, "betas": (0.5, 0.9), "eps": 1e-3},
            [0.9331960082054138, -1.9422333240509033, 0.44000113010406494],
            1e-4,
        ),
        (
            optim.SGD,
            {"lr": 0.01, "momentum": 0.9, "dampening": 0.25, "weight_decay": 0.1},
            [0.6100184321403503, 0.00859186053276062, 0.3899778127670288],
            1e-5,
        ),
        (
            optim.SGD,
            {"lr": 0.001, "momentum": 0.9, "nesterov": True},
            [0.9346607327461243, -1.6249152421951294, -0.16042467951774597],
            1e-5,
        ),
        (
            optim.SGD,
            {"lr": 0.001},
            [0.9790350198745728, -1.8977618217468262, 0.2525763511657715],
            1e-6,
        ),
    ],
)
def test_the_classes_agree_with_warp(cls, options, expected, rtol):
    x = leaf([1.0, -2.0, 0.5])
    optimizer = cls([x], **options)
    for k in range(6):
        x.grad.assign(x.numpy() * F([1, 10, 100]) + F(k))
        optimizer.step()
    np.testing.assert_allclose(x.numpy(), expected, rtol=rtol)


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ((optim.SGD, {"lr": 0.02, "momentum": 0.9}), 400),
        ((optim.SGD, {"lr": 0.02, "momentum": 0.9, "nesterov": True}), 400),
        ((optim.Adam, {"lr": 0.05}), 800),
    ],
)
def test_a_captured_training_finds_the_minimum_of_a_quadratic(options, steps):
    cls, keywords = options
    stiffness, center = nova.tensor([1.0, 10.0]), nova.tensor([3.0, -1.0])
    x = leaf([0.0, 0.0])
    optimizer = cls([x], **keywords)

    def iteration():
        with nova.Tape() as tape:
            d = x - center
            tape.backward(nova.sum(d * d * stiffness) * 0.5)
            recorded = tape.size
            optimizer.step()
            assert tape.size == recorded
        optimizer.zero_grad()

    with nova.ScopedCapture() as capture:
        iteration()
    for _ in range(steps):
        capture.graph.launch()
    np.testing.assert_allclose(x.numpy(), center.numpy(), atol=1e-3)


def test_a_replay_has_the_bits_of_the_eager_loop():
    def make():
        start = np.random.default_rng(2).standard_normal(3000).astype(F)
        x, s = leaf(start), leaf([0.5])
        adam = optim.Adam([x], lr=0.03)
        sgd = optim.SGD([s], lr=1e-3, momentum=0.9, dampening=0.5)
        m, v, t = nova.zeros(1), nova.zeros(1), nova.zeros(1)

        def iteration():
            with nova.Tape() as tape:
                d = nova.sin(x) * s - 0.25
                tape.backward(nova.sum(d * d))
                norm = nova.clip_grad_norm_([x, s], 2.0)
                nova.clip_grad_value_([s], 0.5)
                adam.step()
                sgd.step()
                nova.adam_update_f32(s, m, v, t, 0.01)
                nova.clamp_(x, -1, 1)
                tape.zero()
            return norm

        return iteration, (x, s, m, v, t, adam.t, adam.m[0], adam.v[0], sgd.b[0], sgd.t)

    (eager, expected), (captured, actual) = make(), make()
    with nova.ScopedCapture() as capture:
        norm = captured()
    assert actual[4].tolist() == actual[5].tolist() == [0]
    for k in range(1, 9):
        norm_expected = eager()
        capture.graph.launch()
        assert_same_bits(norm, norm_expected)
        for a, b in zip(actual, expected):
            assert_same_bits(a, b)
        assert actual[4].tolist() == actual[5].tolist() == [k]


def test_the_learning_rate_can_be_changed():
    x = leaf([0.0], [1.0])
    sgd = optim.SGD([x], lr=1.0)
    with nova.ScopedCapture() as capture:
        sgd.step()
    sgd.lr = 0.25
    sgd.step()
    assert x.tolist() == [-0.25] and sgd.lr == 0.25
    capture.graph.launch()
    assert x.tolist() == [-1.25]
    with pytest.raises(ValueError, match="SGD, lr"):
        sgd.lr = -1
    assert sgd.lr == 0.25


# ---------------------------------------------------------------------------- clipping


def test_the_norm_is_clipped_over_all_gradients():
    random = np.random.default_rng(3)
    gradients = [random.standard_normal(s).astype(F) for s in ((900, 3), (7,), (2, 2, 2))]
    exact = math.sqrt(sum(float(np.sum(g.astype(np.float64) ** 2)) for g in gradients))
    params = [leaf(np.ones_like(g), g) for g in gradients]
    norm = nova.clip_grad_norm_(params, 1.5)
    assert norm.shape == (1,) and norm.item() == pytest.approx(exact, rel=1e-6)
    factor = F(1.5) / (norm.numpy()[0] + F(1e-6))
    for p, g in zip(params, gradients):
        assert_same_bits(p.grad, g * factor)
    again = nova.clip_grad_norm_((p for p in params), 1.51)
    assert again.item() == pytest.approx(1.5, rel=1e-5)
    for p, g in zip(params, gradients):
        assert_same_bits(p.grad, g * factor, "a short gradient keeps its bits")
    assert nova.clip_grad_norm_(params[1], INF).item() < 1.5  # one tensor counts as a list of one


@pytest.mark.parametrize("bad", [NAN, INF, 1e30])
def test_a_norm_that_is_not_finite_zeroes_the_gradients(bad):
    x, y = leaf([1.0, 2.0], [bad, 1.0]), leaf([1.0], [1.0])
    assert not math.isfinite(nova.clip_grad_norm_([x, y], 1.0).item())
    assert x.grad.tolist() == [0, 0] and y.grad.tolist() == [0]


def test_values_are_clipped():
    g = F([-3, -0.5, 0.25, INF])
    x = leaf([1.0, 2.0, 3.0, 4.0], g)
    nova.clip_grad_value_([x], 0.5)
    assert_same_bits(x.grad, np.clip(g, F(-0.5), F(0.5)))
    nova.clamp_(x, 1.5, 3)
    assert x.tolist() == [1.5, 2, 3, 3]
    assert_same_bits(x.grad, np.clip(g, F(-0.5), F(0.5)))


# ---------------------------------------------------------------------------- errors


def test_bad_arguments_are_refused_by_name_and_nothing_is_written():
    x, bare, ints = leaf([1.0, 2.0], [1.0, 1.0]), nova.tensor([1.0]), nova.tensor([1])
    m, v, t = nova.zeros(2), nova.zeros(2), nova.zeros(1)
    cases = [
        (TypeError, "Adam, params", lambda: optim.Adam(3)),
        (TypeError, r"params\[1\]: expected a Tensor, got NoneType", lambda: optim.SGD([x, None])),
        (TypeError, r"params\[0\]: expected float32, got int32", lambda: optim.Adam([ints])),
        (TypeError, None, lambda: optim.Adam([x], betas=0.9)),
        (TypeError, None, lambda: optim.Adam([x], lr="fast")),
        (ValueError, "Adam, params: expected at least one", lambda: optim.Adam([])),
        (ValueError, r"params\[1\].*params\[0\]", lambda: optim.SGD([x, x])),
        (ValueError, "Adam, lr.*-1", lambda: optim.Adam([x], lr=-1)),
        (ValueError, "SGD, lr.*nan", lambda: optim.SGD([x], lr=NAN)),
        (ValueError, "Adam, beta1.*got 1", lambda: optim.Adam([x], betas=(1.0, 0.9))),
        (ValueError, "Adam, beta2", lambda: optim.Adam([x], betas=(0.9, 1 - 1e-12))),
        (ValueError, "Adam, eps", lambda: optim.Adam([x], eps=0)),
        (ValueError, "SGD, momentum", lambda: optim.SGD([x], momentum=-1)),
        (ValueError, "SGD, nesterov", lambda: optim.SGD([x], nesterov=True)),
        (ValueError, r"params\[0\]: it has no gradient", lambda: optim.SGD([bare]).step()),
        (ValueError, r"params\[1\]: it has no gradient", lambda: optim.Adam([x, bare]).step()),
        (ValueError, "m: expected shape", lambda: nova.adam_update_f32(x, t, v, t, 0.1)),
        (ValueError, "v: expected memory", lambda: nova.adam_update_f32(x, m, m, t, 0.1)),
        (ValueError, "t: expected shape", lambda: nova.adam_update_f32(x, m, v, nova.zeros(2), 1)),
        (TypeError, "t: expected float32", lambda: nova.adam_update_f32(x, m, v, ints, 0.1)),
        (ValueError, "max_norm.*0", lambda: nova.clip_grad_norm_([x], 0)),
        (ValueError, "max_norm.*nan", lambda: nova.clip_grad_norm_([x], NAN)),
        (ValueError, "no gradient", lambda: nova.clip_grad_norm_([x, bare], 1)),
        (ValueError, "at least one", lambda: nova.clip_grad_value_([], 1)),
        (ValueError, "clip_grad_value_, v", lambda: nova.clip_grad_value_([x], -1)),
        (ValueError, "lower <= upper", lambda: nova.clamp_(x, 2, 1)),
        (TypeError, "clamp_, param", lambda: nova.clamp_(ints, 0, 1)),
    ]
    for error, message, call in cases:
        with pytest.raises(error, match=message):
            call()
    assert x.tolist() == [1, 2] and x.grad.tolist() == [1, 1]
    assert m.tolist() == v.tolist() == [0, 0] and t.tolist() == [0]


def test_what_an_optimiser_shows():
    x, y = leaf([1.0], [1.0]), leaf([[1.0, 2.0]], [[1.0, 1.0]])
    adam = optim.Adam([x, y])
    assert adam.params[0] is x and adam.params[1] is y and adam.lr == F(1e-3)
    assert [m.shape for m in adam.m] == [v.shape for v in adam.v] == [(1,), (1, 2)]
    plain, heavy = optim.SGD([x]), optim.SGD([x], momentum=0.5)
    assert plain.b == [] and plain.t is None
    heavy.step()
    assert heavy.b[0].tolist() == [1] and heavy.t.tolist() == [1]
    adam.zero_grad()
    assert x.grad.tolist() == [0] and y.grad.tolist() == [[0, 0]]
    assert nova.optim is optim and sorted(optim.__all__) == ["Adam", "SGD"]


def optimisers(x):
    return (
        optim.SGD([x], lr=0.1),
        optim.SGD([x], lr=0.1, momentum=0.9, weight_decay=0.1),
        optim.Adam([x], lr=0.1),
    )


def state_of(optimizer):
    """The memory of a state, read without asking the optimizer."""
    if isinstance(optimizer, optim.Adam):
        return [*optimizer.m, *optimizer.v, optimizer.t]
    return [*optimizer.b] + ([] if optimizer.t is None else [optimizer.t])


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_a_gradient_that_is_not_finite_is_refused_before_anything_is_written(which, bad):
    good, x = leaf([1.0], [0.5]), leaf([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    optimizer = optimisers(x)[which]
    optimizer.step()
    memory = [x, *state_of(optimizer)]
    before = [t.numpy() for t in memory]
    x.grad.assign([0.1, bad, bad])
    message = r"params\[0\]: expected a finite gradient, got 2 of 3 values .* at 1"
    with pytest.raises(Error, match=message):
        optimizer.step()
    for one, two in zip(before, memory, strict=True):
        assert_same_bits(one, two.numpy())
    x.grad.assign([0.1, 0.2, 0.3])
    optimizer.step()
    assert (x.numpy() != before[0]).all() and good.item() == 1.0


@pytest.mark.parametrize("which", range(3))
def test_a_replay_notes_a_gradient_that_is_not_finite_and_the_next_one_raises(which):
    results = []
    for captured in (False, True):
        x = leaf([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
        optimizer = optimisers(x)[which]
        step = optimizer.step
        if captured:
            with nova.ScopedCapture() as capture:
                optimizer.step()
            step = capture.graph.launch
        memory = [x, *state_of(optimizer)]
        step()
        step()
        results.append([t.numpy() for t in memory])
    for direct, replayed in zip(*results, strict=True):
        assert_same_bits(direct, replayed)
    x.grad.assign([0.1, NAN, 0.3])
    step()
    for one, two in zip(results[1], memory, strict=True):
        assert_same_bits(one, two.numpy())
    with pytest.raises(Error, match="wrote nothing"):
        optimizer.check()
    for read in (step, optimizer.step, optimizer.check, lambda: state_of(optimizer)):
        if which == 0 and read not in (step, optimizer.step, optimizer.check):
            continue  # there is no state
        x.grad.assign([0.1, NAN, 0.3])
        step()
        x.grad.assign([0.1, 0.2, 0.3])
        with pytest.raises(Error, match="expected finite gradients, got one that is not in 1 of"):
            read()
        optimizer.check()  # said once
    step()
    assert (x.numpy() != results[1][0]).all()
